//! Where a result comes from: written beside it, so that it can be made again.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_geometry::Rig;
use serde::{Deserialize, Serialize};

use crate::calibration::rig_sha256;
use crate::error::Error;
use crate::hash::sha256_of;

/// What made a result: program, effective configuration and inputs. Times and host names are left out on purpose: equal
/// inputs give equal bytes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Name and version of the program, and of formats where they have one: `lsfb` → `0.1.0`.
    pub versions: BTreeMap<String, String>,
    /// The configuration with every default filled in.
    pub config: serde_json::Value,
    /// SHA-256 of each input by the name of its file, in hexadecimal.
    pub inputs: BTreeMap<String, String>,
    /// [`rig_sha256`] of each rig that was used by the name of its device: which calibration the result rests on.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub rigs: BTreeMap<String, String>,
    /// What was found wrong with the result when it was made, a sentence each: what is made of it would be wrong too. Empty where nothing was.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failures: Vec<String>,
}

/// Stands for the hash of an input that is no file.
pub const READ_ONCE: &str = "no file";

impl Provenance {
    /// What is beside a result; `None` where there is nothing, or what another program wrote under that name.
    pub fn beside(result: &Path) -> Option<Self> {
        let text = std::fs::read_to_string(provenance_path(result)).ok()?;
        serde_json::from_str(&text).ok()
    }

    /// Of a result of this version of the program with this effective configuration.
    pub fn new(config: &impl Serialize) -> Self {
        Self {
            versions: BTreeMap::from([("lsfb".to_owned(), env!("CARGO_PKG_VERSION").to_owned())]),
            // A configuration that is no JSON (a map with odd keys) is noted as missing rather than failing the stage.
            config: serde_json::to_value(config).unwrap_or_default(),
            inputs: BTreeMap::new(),
            rigs: BTreeMap::new(),
            failures: Vec::new(),
        }
    }

    /// Adds the hash of an input file by the file's name; a second file of that name is `NAME#2`. What can be read once only, such as a pipe,
    /// has [`READ_ONCE`] in place of a hash.
    pub fn add_input(&mut self, path: &Path) -> Result<(), Error> {
        let name = path
            .file_name()
            .unwrap_or(path.as_os_str())
            .to_string_lossy()
            .into_owned();
        let is_read_once = path
            .metadata()
            .is_ok_and(|found| !found.is_file() && !found.is_dir());
        let sha256 = match is_read_once {
            true => READ_ONCE.to_owned(),
            false => sha256_of(path)?,
        };
        let numbers = (2..).map(|n| format!("{name}#{n}"));
        let names = std::iter::once(name.clone()).chain(numbers);
        let is_free = |name: &String| self.inputs.get(name).is_none_or(|own| *own == sha256);
        if let Some(name) = names.into_iter().find(is_free) {
            self.inputs.insert(name, sha256);
        }
        Ok(())
    }

    /// Names the calibration that was used.
    pub fn add_rig(&mut self, rig: &Rig) {
        self.rigs.insert(rig.name.clone(), rig_sha256(rig));
    }

    /// The same of a result with which something was found wrong.
    pub fn with_failures(&self, failures: Vec<String>) -> Self {
        Self {
            failures,
            ..self.clone()
        }
    }

    /// Writes `<result>.provenance.json` beside `result` and gives its path.
    pub fn write(&self, result: &Path) -> Result<PathBuf, Error> {
        let path = provenance_path(result);
        let mut text = serde_json::to_vec_pretty(self).map_err(|source| Error::Io {
            path: path.clone(),
            action: "write the provenance",
            source: source.into(),
        })?;
        text.push(b'\n');
        replace_file(&path, &text)?;
        Ok(path)
    }
}

/// Where [`Provenance::write`] tells what a result was made from.
pub fn provenance_path(result: &Path) -> PathBuf {
    let mut name = result.file_name().unwrap_or_default().to_os_string();
    name.push(".provenance.json");
    result.with_file_name(name)
}

/// Writes a file under a temporary name first, so that an interruption leaves the old one or the new one.
pub(crate) fn replace_file(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".part");
    let part = path.with_file_name(name);
    std::fs::write(&part, bytes)
        .and_then(|()| std::fs::rename(&part, path))
        .map_err(|source| {
            // Half a file is of no use to anyone; the reason to report is the one above.
            let _ = std::fs::remove_file(&part);
            Error::Io {
                path: path.to_owned(),
                action: "write",
                source,
            }
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hash_of_the_standard_and_provenance_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let input = dir.path().join("abc.txt");
        std::fs::write(&input, "abc").unwrap();
        // FIPS 180-2, appendix B.1
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256_of(&input).unwrap(), expected);

        let mut provenance = Provenance::new(&BTreeMap::from([("voxel_size_m", 0.25)]));
        provenance.add_input(&input).unwrap();
        let path = provenance.write(&dir.path().join("walk.tum")).unwrap();
        assert_eq!(path.file_name().unwrap(), "walk.tum.provenance.json");
        let text = std::fs::read_to_string(&path).unwrap();
        let back: Provenance = serde_json::from_str(&text).unwrap();
        assert_eq!(back, provenance);
        assert_eq!(back.inputs["abc.txt"], expected);
        assert_eq!(back.config["voxel_size_m"], 0.25);

        let folder = dir.path().join("folder");
        std::fs::create_dir(&folder).unwrap();
        assert!(replace_file(&folder, b"text").is_err());
        assert!(!dir.path().join("folder.part").exists());

        let missing = sha256_of(&dir.path().join("gone.mcap"))
            .unwrap_err()
            .to_string();
        assert!(missing.contains("gone.mcap"), "{missing}");
    }
}
