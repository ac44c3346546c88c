//! The folder of a map: its size, where it comes from, and whether the map failed.

use std::path::Path;

use anyhow::Context as _;
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::Provenance;
use serde::Serialize;

use crate::context::Context;
use crate::files::name_of;
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;

/// Bytes of all files in it.
pub fn bytes_in(folder: &Path) -> anyhow::Result<u64> {
    let named = || folder.display().to_string();
    let mut sum = 0;
    for entry in std::fs::read_dir(folder).with_context(named)? {
        sum += entry.and_then(|e| e.metadata()).with_context(named)?.len();
    }
    Ok(sum)
}

/// Writes where a result comes from beside it.
pub fn written(
    map: &HdMap,
    out: &Path,
    read: &[&Path],
    settings: &impl Serialize,
) -> anyhow::Result<()> {
    let mut provenance = Provenance::new(settings);
    for folder in read {
        provenance.add_input(&folder.join(HdMap::HEADER))?;
    }
    provenance.add_rig(map.rig());
    provenance.write(out)?;
    Ok(())
}

/// Prints what was made of a map, with whether the map failed when it was made: one that did is as wrong in any other form. How the command
/// ends.
pub fn print_made(
    map: &HdMap,
    out: &Path,
    made: &impl Serialize,
    text: impl FnOnce() -> String,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let judgement = map.checks();
    context.print(&Judged::new(&judgement, &name_of(out), made), || {
        let text = format!("{}\n{}", text(), problem_lines(&judgement));
        text.trim_end().to_owned()
    })?;
    Ok(Outcome::of(judgement.verdict()))
}
