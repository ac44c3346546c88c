//! `SHA256SUMS`: the hash of every file of a folder, as `sha256sum --check` reads it.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Component, Path, PathBuf};

use lsfb_recording::sha256_of;
use lsfb_types::{Progress, ProgressFn};
use serde::Serialize;

use crate::Error;

/// Name of the file.
pub const SUMS: &str = "SHA256SUMS";
/// Larger files are no list of hashes.
const MAX_BYTES: u64 = 64 << 20;
/// Hexadecimal digits of a hash.
const DIGITS: usize = 64;

/// How a file differs from the list.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Difference {
    /// It is listed, and is not there.
    Missing(String),
    /// It is listed with another hash.
    Changed(String),
    /// It is there, and not listed.
    Added(String),
}

/// Lists the hashes of all files below a folder, but of those in the folder `but` in it; gives the hash of the list.
pub fn write_sums(
    folder: &Path,
    but: Option<&str>,
    progress: ProgressFn<'_>,
) -> Result<String, Error> {
    let mut text = String::new();
    for (name, sum) in hashes(folder, &files(folder, but)?, progress)? {
        // Writing into a string cannot fail.
        let _ = writeln!(text, "{sum}  {name}");
    }
    let path = folder.join(SUMS);
    fs::write(&path, text).map_err(|source| Error::Io {
        path: path.clone(),
        source,
    })?;
    Ok(sha256_of(&path)?)
}

/// What is not as it was listed, in order; nothing where all is.
pub fn check_sums(
    folder: &Path,
    but: Option<&str>,
    progress: ProgressFn<'_>,
) -> Result<Vec<Difference>, Error> {
    let listed = read(&folder.join(SUMS))?;
    let there = files(folder, but)?;
    let mut differences = Vec::new();
    for name in listed.keys().filter(|name| !there.contains(name)) {
        differences.push(Difference::Missing(name.clone()));
    }
    for (name, sum) in hashes(folder, &there, progress)? {
        match listed.get(&name) {
            None => differences.push(Difference::Added(name)),
            Some(own) if *own != sum => differences.push(Difference::Changed(name)),
            Some(_) => {}
        }
    }
    differences.sort();
    Ok(differences)
}

fn hashes(
    folder: &Path,
    names: &[String],
    progress: ProgressFn<'_>,
) -> Result<Vec<(String, String)>, Error> {
    let mut found = Vec::with_capacity(names.len());
    for (done, name) in names.iter().enumerate() {
        progress(Progress {
            stage: "hashing files",
            done: done as u64,
            total: names.len() as u64,
        })?;
        found.push((name.clone(), sha256_of(&folder.join(name))?));
    }
    Ok(found)
}

fn read(path: &Path) -> Result<BTreeMap<String, String>, Error> {
    let io = |source| Error::Io {
        path: path.to_owned(),
        source,
    };
    let bad = |what: String| Error::BadDataset {
        path: path.to_owned(),
        what,
    };
    if fs::metadata(path).map_err(io)?.len() > MAX_BYTES {
        return Err(bad("too large for a list of hashes".to_owned()));
    }
    let text = fs::read_to_string(path).map_err(io)?;
    let mut listed = BTreeMap::new();
    for (number, line) in (1..).zip(text.lines()) {
        // Programs that read files as binary mark them by a star.
        let parts = line.split_once("  ").or_else(|| line.split_once(" *"));
        let is_hash = |sum: &str| sum.len() == DIGITS && sum.bytes().all(|c| c.is_ascii_hexdigit());
        let is_below = |name: &str| {
            Path::new(name)
                .components()
                .all(|c| matches!(c, Component::Normal(_)))
        };
        let Some((sum, name)) = parts.filter(|(sum, name)| is_hash(sum) && is_below(name)) else {
            return Err(bad(format!("line {number} is not a hash and a file")));
        };
        if listed.insert(name.to_owned(), sum.to_lowercase()).is_some() {
            return Err(bad(format!("line {number}: {name} is listed twice")));
        }
    }
    Ok(listed)
}

/// Files below a folder by their paths in it, in order, without the list itself and the folder `but`. Links are refused: what they lead to
/// is no part of the dataset.
fn files(folder: &Path, but: Option<&str>) -> Result<Vec<String>, Error> {
    let mut found = Vec::new();
    let mut waiting = vec![PathBuf::new()];
    while let Some(below) = waiting.pop() {
        let here = folder.join(&below);
        let io = |source| Error::Io {
            path: here.clone(),
            source,
        };
        for entry in fs::read_dir(&here).map_err(io)? {
            let entry = entry.map_err(io)?;
            let kind = entry.file_type().map_err(io)?;
            let path = below.join(entry.file_name());
            let bad = |what: &str| Error::BadDataset {
                path: folder.join(&path),
                what: what.to_owned(),
            };
            let name = path
                .to_str()
                .filter(|name| !name.contains(['\n', '\r', '\\']));
            let name = name.ok_or_else(|| bad("its name cannot be in a list of hashes"))?;
            if kind.is_dir() {
                if but != Some(name) {
                    waiting.push(path);
                }
            } else if !kind.is_file() {
                return Err(bad(
                    "neither a file nor a folder: a dataset must contain its files",
                ));
            } else if name != SUMS {
                found.push(name.to_owned());
            }
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use lsfb_types::no_progress;

    use super::*;

    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("folder");
        for (name, text) in [("a.txt", "a"), ("b/c.txt", "c"), ("truth/d.tum", "d")] {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().expect("folder")).expect("folder");
            fs::write(path, text).expect("file");
        }
        write_sums(folder.path(), Some("truth"), &no_progress).expect("written");
        folder
    }

    fn differences(folder: &Path) -> Vec<Difference> {
        check_sums(folder, Some("truth"), &no_progress).expect("checked")
    }

    #[test]
    fn what_is_missing_changed_or_added_is_named() {
        let folder = folder();
        let at = |name: &str| folder.path().join(name);
        assert_eq!(differences(folder.path()), []);
        fs::write(at("truth/e.tum"), "held back").expect("file");
        assert_eq!(differences(folder.path()), [], "not of this list");
        fs::remove_file(at("a.txt")).expect("removed");
        // As long as before.
        fs::write(at("b/c.txt"), "x").expect("file");
        fs::write(at("b/new.txt"), "").expect("file");
        assert_eq!(
            differences(folder.path()),
            [
                Difference::Missing("a.txt".to_owned()),
                Difference::Changed("b/c.txt".to_owned()),
                Difference::Added("b/new.txt".to_owned()),
            ]
        );
    }

    /// The list is the common format: the hash of "a" is known.
    #[test]
    fn the_list_is_what_other_programs_read() {
        let folder = folder();
        let text = fs::read_to_string(folder.path().join(SUMS)).expect("list");
        let first = "ca978112ca1bbdcafac231b39a23dc4da786eff8147c4e72b9807785afee48bb  a.txt";
        assert_eq!(text.lines().next(), Some(first));
        assert_eq!(text.lines().count(), 2);
    }

    #[test]
    fn a_list_leads_nowhere_else() {
        let folder = folder();
        let sum = "0".repeat(DIGITS);
        for line in [
            format!("{sum}  ../secret"),
            format!("{sum}  /etc/passwd"),
            "123  a.txt".to_owned(),
            format!("{sum}  a.txt\n{sum}  a.txt"),
        ] {
            fs::write(folder.path().join(SUMS), line).expect("file");
            let refused = check_sums(folder.path(), Some("truth"), &no_progress);
            assert!(matches!(refused, Err(Error::BadDataset { .. })));
        }
        std::os::unix::fs::symlink("/etc", folder.path().join("link")).expect("link");
        let refused = write_sums(folder.path(), Some("truth"), &no_progress);
        assert!(matches!(refused, Err(Error::BadDataset { .. })));
    }
}
