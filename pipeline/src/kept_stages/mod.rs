//! Stages of a long computation that are finished, kept in a folder until its result is there: stopped or killed, the same
//! computation goes on behind them, to the same result bit for bit.
//!
//! A file a stage, `NAME.stage`: the SHA-256 of what follows, then the values as `keep` writes them. `made_from` beside them says of
//! what; of something else they are removed. A stage that cannot be read back whole is computed again.

mod keep;

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::Error;
pub(crate) use keep::{ByteReader, Keep, keep_fields, put_told, take_told};

/// Length of a SHA-256, bytes.
const HASH_LEN: usize = 32;
/// Name of the file that says what the stages were made from.
const MADE_FROM: &str = "made_from";

/// Where the finished stages of one computation are kept.
#[derive(Debug)]
pub struct KeptStages {
    folder: Option<PathBuf>,
    made_from: String,
}

impl KeptStages {
    /// Keeps nothing: for computations that take seconds.
    pub fn none() -> Self {
        Self {
            folder: None,
            made_from: String::new(),
        }
    }

    /// In `folder`, which is made with the first stage that is kept. `made_from` names the program, the settings and the inputs by their
    /// hashes: stages of something else are removed.
    pub fn in_folder(folder: &Path, made_from: &str) -> Result<Self, Error> {
        let kept = Self {
            folder: Some(folder.to_owned()),
            made_from: made_from.to_owned(),
        };
        let of_the_same = fs::read_to_string(folder.join(MADE_FROM)).is_ok_and(|m| m == made_from);
        if !of_the_same {
            kept.remove()?;
        }
        Ok(kept)
    }

    /// Whether a stage of this computation is kept already.
    pub fn has_any(&self) -> bool {
        self.folder
            .as_deref()
            .is_some_and(|folder| folder.join(MADE_FROM).exists())
    }

    /// What the stage gave, kept or computed now and kept.
    pub(crate) fn once<T: Keep>(
        &self,
        name: &str,
        compute: impl FnOnce() -> Result<T, Error>,
    ) -> Result<T, Error> {
        if let Some(kept) = self.get(name) {
            return Ok(kept);
        }
        let value = compute()?;
        self.keep(name, &value)?;
        Ok(value)
    }

    /// What was kept under a name; `None` where nothing was, or not all of it.
    pub(crate) fn get<T: Keep>(&self, name: &str) -> Option<T> {
        let bytes = fs::read(stage_file(self.folder.as_deref()?, name)).ok()?;
        let (hash, values) = bytes.split_at_checked(HASH_LEN)?;
        if hash != Sha256::digest(values).as_slice() {
            return None;
        }
        let mut reader = ByteReader::new(values);
        let value = T::take(&mut reader)?;
        reader.is_empty().then_some(value)
    }

    /// Keeps a value under a name, in the place of what was kept before.
    pub(crate) fn keep<T: Keep>(&self, name: &str, value: &T) -> Result<(), Error> {
        let Some(folder) = &self.folder else {
            return Ok(());
        };
        fs::create_dir_all(folder).map_err(Error::io(folder))?;
        let mut values = Vec::new();
        value.put(&mut values);
        let mut bytes = Sha256::digest(&values).to_vec();
        bytes.append(&mut values);
        write_whole(&stage_file(folder, name), &bytes)?;
        let made_from = folder.join(MADE_FROM);
        match made_from.exists() {
            true => Ok(()),
            false => write_whole(&made_from, self.made_from.as_bytes()),
        }
    }

    /// Passes a result on, and takes away what was kept where the computation failed by itself: it would fail again.
    pub fn kept_if_stopped<T>(&self, result: Result<T, Error>) -> Result<T, Error> {
        if matches!(&result, Err(error) if !matches!(error, Error::Stopped(_))) {
            self.remove()?;
        }
        result
    }

    /// Takes away what was kept: the result is there.
    pub fn remove(&self) -> Result<(), Error> {
        let Some(folder) = &self.folder else {
            return Ok(());
        };
        let entries = match fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(source) if source.kind() == ErrorKind::NotFound => return Ok(()),
            Err(source) => return Err(Error::io(folder)(source)),
        };
        // Its own files alone: somebody may have named another folder so.
        for entry in entries {
            let path = entry.map_err(Error::io(folder))?.path();
            let extension = path.extension().and_then(|e| e.to_str());
            if matches!(extension, Some("stage" | "part")) || path.ends_with(MADE_FROM) {
                fs::remove_file(&path).map_err(Error::io(&path))?;
            }
        }
        match fs::remove_dir(folder) {
            Err(source) if source.kind() != ErrorKind::DirectoryNotEmpty => {
                Err(Error::io(folder)(source))
            }
            _ => Ok(()),
        }
    }
}

fn stage_file(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.stage"))
}

/// Whoever ends the process leaves the file whole or not at all.
fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let part = path.with_extension("part");
    fs::write(&part, bytes).map_err(Error::io(&part))?;
    fs::rename(&part, path).map_err(Error::io(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn computed(kept: &KeptStages, value: u64) -> (u64, bool) {
        let mut ran = false;
        let found = kept.once("sum", || {
            ran = true;
            Ok(value)
        });
        (found.expect("a value"), ran)
    }

    #[test]
    fn a_stage_is_computed_once_for_the_same_inputs() {
        let scratch = tempfile::tempdir().expect("folder");
        let folder = scratch.path().join("map.unfinished");
        let kept = KeptStages::in_folder(&folder, "scan a").expect("folder");
        assert!(!folder.exists() && !kept.has_any());
        assert_eq!(computed(&kept, 7), (7, true));
        assert_eq!(computed(&kept, 8), (7, false));
        let again = KeptStages::in_folder(&folder, "scan a").expect("folder");
        assert!(again.has_any());
        assert_eq!(computed(&again, 9), (7, false));
        let other = KeptStages::in_folder(&folder, "scan b").expect("folder");
        assert!(!other.has_any(), "stages of another scan are gone");
        assert_eq!(computed(&other, 9), (9, true));
        other.remove().expect("removed");
        assert!(!folder.exists());
        other.remove().expect("nothing to remove");
    }

    #[test]
    fn a_stage_that_was_cut_or_changed_is_computed_again() {
        let scratch = tempfile::tempdir().expect("folder");
        let kept = KeptStages::in_folder(scratch.path(), "scan").expect("folder");
        let file = scratch.path().join("sum.stage");
        for spoil in [
            (|bytes: &mut Vec<u8>| bytes.truncate(bytes.len() - 1)) as fn(&mut Vec<u8>),
            |bytes| bytes.push(0),
            |bytes| bytes.clear(),
            |bytes| bytes[HASH_LEN] ^= 1,
        ] {
            kept.keep("sum", &7_u64).expect("kept");
            let mut bytes = fs::read(&file).expect("a stage");
            spoil(&mut bytes);
            fs::write(&file, bytes).expect("spoilt");
            assert_eq!(kept.get::<u64>("sum"), None);
        }
    }

    #[test]
    fn what_fails_by_itself_keeps_nothing() {
        let scratch = tempfile::tempdir().expect("folder");
        let folder = scratch.path().join("walk.tum.unfinished");
        let kept = KeptStages::in_folder(&folder, "walk").expect("folder");
        kept.keep("sum", &7_u64).expect("kept");
        let ends = |result: Result<u64, Error>| kept.kept_if_stopped(result).is_ok();
        assert!(ends(Ok(1)) && !ends(Err(lsfb_types::Stopped.into())) && kept.has_any());
        let failed = || Error::io(&folder)(ErrorKind::NotFound.into());
        assert!(!ends(Err(failed())) && !folder.exists());
    }

    #[test]
    fn files_of_others_stay() {
        let scratch = tempfile::tempdir().expect("folder");
        let theirs = scratch.path().join("notes.txt");
        fs::write(&theirs, "mine").expect("a file");
        let kept = KeptStages::in_folder(scratch.path(), "scan").expect("folder");
        kept.keep("sum", &7_u64).expect("kept");
        kept.remove().expect("removed");
        assert!(theirs.exists() && !scratch.path().join("sum.stage").exists());
    }
}
