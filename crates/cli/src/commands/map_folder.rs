//! The folder of a map: its size, where it comes from, and whether the map failed.

use std::path::Path;

use anyhow::Context as _;
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::Provenance;
use serde::Serialize;

use crate::context::Context;
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

/// How a command ends that makes something else of a map: one that failed when it was made is as wrong in any other form.
pub fn outcome_of(map: &HdMap, context: &Context) -> Outcome {
    for what in map.failures() {
        context.say(&format!(
            "the map failed its checks when it was made: {what}"
        ));
    }
    match map.failures().is_empty() {
        true => Outcome::Done,
        false => Outcome::JudgementFailed,
    }
}
