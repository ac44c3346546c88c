//! What the runs of a sequence read.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_recording::{Recording, sha256_of};

use super::made_of::{contents_of, short};
use crate::Error;
use crate::slam_bench::export::{Layout, export};
use crate::slam_bench::plan::{Plan, Sequence};

/// The folders and hashes that all runs of a sequence share.
#[derive(Clone)]
pub(super) struct Prepared {
    pub inputs: BTreeMap<Layout, PathBuf>,
    pub made_of: String,
}

/// Exports the input in the layouts that systems read, where that is not done, and hashes it.
pub(super) fn prepare(
    plan: &Plan,
    sequence: &Sequence,
    out: &Path,
    program_sha256: &str,
) -> Result<Prepared, Error> {
    let is_file = sequence.input.is_file();
    let input = match is_file {
        true => sha256_of(&sequence.input)?,
        false => contents_of(&sequence.input, Some(out))?,
    };
    let mut inputs = BTreeMap::new();
    for layout in plan.systems.iter().map(|system| system.layout) {
        let place = match layout {
            Layout::AsIs => sequence.input.clone(),
            _ if !is_file => {
                return Err(Error::NotExported {
                    path: sequence.input.clone(),
                    layout: layout.name(),
                });
            }
            layout => {
                let [input, program] = [input.as_str(), program_sha256].map(short);
                let name = format!("input-{}-{input}-{program}", layout.name());
                let folder = out.join(&sequence.name).join(name);
                if !folder.exists() {
                    export(&Recording::open(&sequence.input)?, layout, &folder)?;
                }
                folder
            }
        };
        let place = place.canonicalize().map_err(|source| Error::Io {
            path: place.clone(),
            source,
        })?;
        inputs.insert(layout, place);
    }
    Ok(Prepared {
        inputs,
        made_of: format!("input {input}"),
    })
}
