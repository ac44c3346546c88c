//! One file of a bag, in whichever format, and which files a bag consists of.

use std::path::{Path, PathBuf};

use lsfb_recording::Recording;
use lsfb_recording::message::Layout;

use super::file::{Visit, unreadable};
use super::{ros1, sqlite};
use crate::Error;

/// One file of a bag.
pub(super) enum Part {
    Ros1(ros1::Bag),
    Mcap(Recording),
    Sqlite(sqlite::Database),
}

impl Part {
    /// Opens a file as what its ending says.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let extension = path.extension().and_then(|e| e.to_str());
        Ok(match extension {
            Some("bag") => Self::Ros1(ros1::Bag::open(path)?),
            Some("db3") => Self::Sqlite(sqlite::Database::open(path)?),
            _ => Self::Mcap(Recording::open(path).map_err(|e| unreadable(path, e))?),
        })
    }

    /// What is missing from a file that ends early or is torn, where that can be told before it is read.
    pub fn damage(&self) -> Vec<String> {
        match self {
            Self::Mcap(recording) => {
                let name = recording.path().display();
                let damage = recording.damage().iter();
                damage.map(|d| format!("{name}: {d}")).collect()
            }
            Self::Ros1(bag) => bag.damage().map(str::to_owned).into_iter().collect(),
            Self::Sqlite(_) => Vec::new(),
        }
    }

    /// Topics and the types of their messages, in the words of ROS 1.
    pub fn topics(&self) -> Vec<(String, String)> {
        let named = |(topic, kind): (&str, &str)| (topic.to_owned(), kind.replace("/msg/", "/"));
        match self {
            Self::Ros1(bag) => bag.topics().map(named).collect(),
            Self::Sqlite(database) => database.topics().map(named).collect(),
            Self::Mcap(recording) => {
                let topics = recording.topics().iter();
                topics.map(|t| named((&t.topic, &t.schema))).collect()
            }
        }
    }

    pub fn layout(&self) -> Layout {
        match self {
            Self::Ros1(_) => Layout::Ros1,
            Self::Mcap(_) | Self::Sqlite(_) => Layout::Cdr,
        }
    }

    pub fn visit(&self, topic: &str, each: Visit<'_>) -> Result<(), Error> {
        match self {
            Self::Ros1(bag) => bag.visit(topic, each),
            Self::Sqlite(database) => database.visit(topic, each),
            Self::Mcap(recording) => {
                let wrong = |e: &dyn std::fmt::Display| unreadable(recording.path(), e);
                if !recording.topics().iter().any(|t| t.topic == topic) {
                    return Ok(());
                }
                for message in recording.messages(topic).map_err(|e| wrong(&e))? {
                    let message = message.map_err(|e| e.to_string());
                    let bytes = message.as_ref().map(|m| m.bytes.as_ref());
                    each(bytes.map_err(String::clone)).map_err(|e| wrong(&e))?;
                }
                Ok(())
            }
        }
    }
}

/// The parts of a rosbag2 folder, in the order of their numbers.
pub(super) fn parts_of(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let io = |source| Error::Io {
        path: folder.to_owned(),
        source,
    };
    let mut parts = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if name.ends_with(".zstd") {
            return Err(unreadable(
                &path,
                "a bag that was compressed as a whole: decompress it with `zstd -d` first",
            ));
        }
        if is_file_of_one(&path) {
            // rosbag2 numbers parts without leading zeros: the shorter name comes first.
            parts.push((name.len(), path));
        }
    }
    parts.sort();
    if parts.is_empty() {
        return Err(unreadable(folder, "no .mcap or .db3 in this folder"));
    }
    Ok(parts.into_iter().map(|(_, path)| path).collect())
}

/// Parts that the `metadata.yaml` of a rosbag2 folder names and that are not among `parts`. Without that file nobody named any.
pub(super) fn missing_parts(folder: &Path, parts: &[PathBuf]) -> Vec<String> {
    let described = folder.join("metadata.yaml");
    let Ok(text) = std::fs::read_to_string(&described) else {
        return Vec::new();
    };
    let lines = text.lines().map(str::trim);
    let listed = lines
        .skip_while(|line| *line != "relative_file_paths:")
        .skip(1)
        .map_while(|line| line.strip_prefix("- "));
    let name_of = |path: &str| {
        let path = path.trim().trim_matches(['"', '\'']);
        // Older versions wrote the folder before it, and those that pack files name them packed.
        let name = path.rsplit('/').next().unwrap_or(path);
        name.strip_suffix(".zstd").unwrap_or(name).to_owned()
    };
    let is_there = |name: &String| {
        let mut names = parts.iter().filter_map(|part| part.file_name());
        names.any(|part| part.to_str() == Some(name.as_str()))
    };
    let missing = listed.map(name_of).filter(|name| !is_there(name));
    let said = |name| format!("{} names {name}, which is missing", described.display());
    missing.map(said).collect()
}

/// Whether a file is a part of a bag of ROS 2 by its name.
pub(super) fn is_file_of_one(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str());
    matches!(extension, Some("mcap" | "db3"))
}
