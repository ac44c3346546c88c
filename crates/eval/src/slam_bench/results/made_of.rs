//! What a run was made of beside its input: the program, and the files that its command and its plan name. A program that was built anew
//! under its old name, or settings that were edited, make another run.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::{Component, Path, PathBuf};

use lsfb_recording::sha256_of;

use crate::Error;

/// Digits of a hash that tell files apart.
const DIGITS: usize = 12;

/// The beginning of a hash.
pub(super) fn short(sha256: &str) -> &str {
    sha256.get(..DIGITS).unwrap_or(sha256)
}

/// Files by their place, hashed once.
#[derive(Debug, Default)]
pub(super) struct Files(BTreeMap<PathBuf, String>);

impl Files {
    /// The program and the files among the words of a command that is started in `folder`, with their hashes. What lies in that folder is
    /// its result, and what lies in `input` is hashed with the input.
    pub fn of_words(
        &mut self,
        words: &[String],
        folder: &Path,
        input: Option<&PathBuf>,
    ) -> Result<String, Error> {
        let mut text = String::new();
        let mut seen = BTreeSet::new();
        for (i, word) in words.iter().enumerate() {
            let path = match i {
                0 => program(word, folder),
                // Also of `--settings=FILE`.
                _ => [Some(word.as_str()), word.split_once('=').map(|(_, v)| v)]
                    .into_iter()
                    .flatten()
                    .filter(|word| !word.is_empty())
                    .map(|word| plain(&folder.join(word)))
                    .find(|path| path.is_file()),
            };
            let Some(path) = path else { continue };
            let is_of_run = path.starts_with(folder);
            let is_of_input = input.is_some_and(|input| path.starts_with(input));
            if !is_of_run && !is_of_input && seen.insert(path.clone()) {
                let hash = self.hash(&path)?;
                text += &format!("{} {}, ", path.display(), short(&hash));
            }
        }
        Ok(text)
    }

    /// Files and folders that a plan lists.
    pub fn listed(&mut self, files: &[PathBuf]) -> Result<String, Error> {
        let mut text = String::new();
        for file in files {
            text += &match file.is_dir() {
                true => format!("{}, ", contents_of(file, None)?),
                false => format!("{} {}, ", file.display(), short(&self.hash(file)?)),
            };
        }
        Ok(text)
    }

    fn hash(&mut self, path: &Path) -> Result<String, Error> {
        if let Some(hash) = self.0.get(path) {
            return Ok(hash.clone());
        }
        let hash = sha256_of(path)?;
        self.0.insert(path.to_owned(), hash.clone());
        Ok(hash)
    }
}

/// The file of a program, as it is looked for when it is started: with a slash in its name as it is, without one in the folders of PATH.
fn program(word: &str, folder: &Path) -> Option<PathBuf> {
    if word.contains('/') {
        return Some(plain(&folder.join(word))).filter(|path| path.is_file());
    }
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path)
        .map(|place| folder.join(place).join(word))
        .find(|path| path.is_file())
}

/// A path without `.` and `..`: the folder of a run need not be there yet.
pub(super) fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => {
                plain.pop();
            }
            part => plain.push(part),
        }
    }
    plain
}

/// A folder that systems read: another file, or another size or time of one, makes another run. What is below `without` is none of
/// it.
pub(super) fn contents_of(folder: &Path, without: Option<&Path>) -> Result<String, Error> {
    let io = |path: &Path| {
        let path = path.to_owned();
        move |source| Error::Io { path, source }
    };
    let out = without.and_then(|out| out.canonicalize().ok());
    let mut files = BTreeSet::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).map_err(io(&folder))? {
            let path = entry.map_err(io(&folder))?.path();
            let about = fs::symlink_metadata(&path).map_err(io(&path))?;
            if about.is_dir() {
                let is_out = out.is_some() && path.canonicalize().ok() == out;
                folders.extend((!is_out).then_some(path));
            } else {
                let changed = about.modified().map_err(io(&path))?;
                files.insert((path, about.len(), changed));
            }
        }
    }
    let mut hasher = DefaultHasher::new();
    files.hash(&mut hasher);
    let (place, count, hash) = (folder.display(), files.len(), hasher.finish());
    Ok(format!("{place} ({count} files, {hash:016x})"))
}
