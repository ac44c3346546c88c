//! Results that stand: beside each result of a long command lies a record of what made it, so that the same command on the
//! same input has nothing to do, and one that was interrupted goes on after the last result that is finished.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, READ_ONCE, sha256_of};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Written last, as `<result>.finished.json`.
#[derive(Serialize, Deserialize)]
struct Record {
    /// SHA-256 of the program: another build may give another result.
    program_sha256: String,
    /// Settings and hashes of the inputs.
    made_from: Provenance,
    /// SHA-256 of what was written by name; of a map that of its header, which has those of its tables.
    outputs: BTreeMap<String, String>,
    /// SHA-256 of what lies beside the first output and belongs to it, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    beside: BTreeMap<String, String>,
    /// What the stage said about its result.
    report: serde_json::Value,
}

/// Notes that results are finished. The first of them gives the record its name; what lies `beside` it belongs to it.
pub fn finish(
    outputs: &[&Path],
    beside: &[PathBuf],
    made_from: &Provenance,
    report: &impl Serialize,
) -> anyhow::Result<()> {
    let Some(path) = record_path(outputs) else {
        return Ok(());
    };
    let record = Record {
        program_sha256: program_sha256()?,
        made_from: made_from.clone(),
        outputs: hashes(outputs)?,
        beside: hashes(&beside.iter().map(PathBuf::as_path).collect::<Vec<_>>())?,
        report: serde_json::to_value(report)?,
    };
    crate::files::write(&path, serde_json::to_vec_pretty(&record)?)
}

/// Whether it can be told that the inputs are the same once more: of what came through a pipe it cannot.
pub fn can_stand(made_from: &Provenance) -> bool {
    made_from.inputs.values().all(|hash| hash != READ_ONCE)
}

/// What was said about results that stand as this program would make them of this input; `None` where they do not.
pub fn report<R: DeserializeOwned>(outputs: &[&Path], made_from: &Provenance) -> Option<R> {
    if !can_stand(made_from) {
        return None;
    }
    let text = std::fs::read(record_path(outputs)?).ok()?;
    // A record of another version, or half of one, is none.
    let record: Record = serde_json::from_slice(&text).ok()?;
    // Read back as the record was: the last digits of numbers may change on the way.
    let asked: Provenance = serde_json::from_slice(&serde_json::to_vec(made_from).ok()?).ok()?;
    let first = outputs.first()?;
    let is_same = |(name, hash): (&String, &String)| {
        sha256_of(&first.with_file_name(name)).is_ok_and(|own| own == *hash)
    };
    let stands = record.made_from == asked
        && record.program_sha256 == program_sha256().ok()?
        && record.outputs == hashes(outputs).ok()?
        && record.beside.iter().all(is_same);
    serde_json::from_value(record.report)
        .ok()
        .filter(|_| stands)
}

/// Forgets that results are finished, before they are made again.
pub fn forget(outputs: &[&Path]) -> anyhow::Result<()> {
    match record_path(outputs) {
        Some(path) if path.exists() => {
            std::fs::remove_file(&path).with_context(|| path.display().to_string())
        }
        _ => Ok(()),
    }
}

/// Takes a result away that is needed no more, and what says that it stands.
pub fn remove(result: &Path) -> anyhow::Result<()> {
    forget(&[result])?;
    match result.exists() {
        true => std::fs::remove_file(result).with_context(|| result.display().to_string()),
        false => Ok(()),
    }
}

fn record_path(outputs: &[&Path]) -> Option<PathBuf> {
    let first = outputs.first()?;
    let mut name = first.file_name()?.to_os_string();
    name.push(".finished.json");
    Some(first.with_file_name(name))
}

fn hashes(outputs: &[&Path]) -> anyhow::Result<BTreeMap<String, String>> {
    let mut found = BTreeMap::new();
    for output in outputs {
        let file = match output.is_dir() {
            true => output.join(HdMap::HEADER),
            false => output.to_path_buf(),
        };
        found.insert(crate::files::name_of(output), sha256_of(&file)?);
    }
    Ok(found)
}

/// SHA-256 of this program.
pub fn program_sha256() -> anyhow::Result<String> {
    let program = std::env::current_exe().context("cannot find the file of this program")?;
    Ok(sha256_of(&program)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Another trajectory through the pipe was answered with the map of the one before: "up to date", exit code 0.
    #[test]
    fn what_came_through_a_pipe_is_made_again() {
        let folder = tempfile::tempdir().expect("folder");
        let out = folder.path().join("walk.tum");
        std::fs::write(&out, "0 0 0 0 0 0 0 1\n").expect("result");
        let pipe = folder.path().join("pipe");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).expect("a pipe");
        let mut made_from = Provenance::new(&());
        made_from.add_input(&out).expect("a file");
        assert!(can_stand(&made_from));
        made_from.add_input(&pipe).expect("a pipe");
        finish(&[&out], &[], &made_from, &7).expect("record");
        assert_eq!(report::<u32>(&[&out], &made_from), None);
    }

    #[test]
    fn a_result_stands_until_it_its_input_or_its_settings_change() {
        let folder = tempfile::tempdir().expect("folder");
        let out = folder.path().join("walk.tum");
        let made_from = Provenance::new(&BTreeMap::from([("voxel_size_m", 0.25)]));
        let other = Provenance::new(&BTreeMap::from([("voxel_size_m", 0.5)]));
        std::fs::write(&out, "0 0 0 0 0 0 0 1\n").expect("result");
        assert_eq!(report::<u32>(&[&out], &made_from), None, "no record");
        let beside = folder.path().join("walk.png");
        std::fs::write(&beside, "a picture").expect("picture");
        finish(&[&out], std::slice::from_ref(&beside), &made_from, &7).expect("record");
        assert_eq!(report::<u32>(&[&out], &made_from), Some(7));
        assert_eq!(report::<u32>(&[&out], &other), None, "other settings");
        std::fs::write(&out, "0 0 0").expect("half a result");
        assert_eq!(report::<u32>(&[&out], &made_from), None, "half a result");
        std::fs::write(&out, "0 0 0 0 0 0 0 1\n").expect("result");
        assert_eq!(report::<u32>(&[&out], &made_from), Some(7));
        std::fs::write(&beside, "another").expect("picture");
        assert_eq!(report::<u32>(&[&out], &made_from), None, "another picture");
        std::fs::write(&beside, "a picture").expect("picture");
        assert_eq!(report::<u32>(&[&out], &made_from), Some(7));
        forget(&[&out]).expect("forgotten");
        assert_eq!(report::<u32>(&[&out], &made_from), None, "forgotten");
        finish(&[&out], &[], &made_from, &7).expect("record");
        remove(&out).expect("removed");
        assert!(!out.exists() && report::<u32>(&[&out], &made_from).is_none());
        remove(&out).expect("nothing to remove");
    }
}
