//! Images and samples of an IMU out of ROS bags: `.bag` of ROS 1, and `.mcap`, `.db3` or the folder of rosbag2.
//!
//! A message's time is that of its header, when it was measured, not that of the bag, when it arrived.

mod message;
mod ros1;
mod sqlite;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_recording::Recording;
use lsfb_types::{Image, ImuSample, Timestamp};

use crate::Error;
use message::Layout;

/// Message types by their names in ROS 1; those of ROS 2 have `msg` between.
const IMAGE: &str = "sensor_msgs/Image";
const COMPRESSED_IMAGE: &str = "sensor_msgs/CompressedImage";
const IMU: &str = "sensor_msgs/Imu";

/// A bag, in one file or several.
pub struct RosBag {
    path: PathBuf,
    parts: Vec<Part>,
    /// Type of the messages of each topic.
    topics: BTreeMap<String, String>,
}

/// One file of a bag.
enum Part {
    Ros1(ros1::Bag),
    Mcap(Recording),
    Sqlite(sqlite::Database),
}

/// What a bag gives its messages to.
type Visit<'a> = &'a mut dyn FnMut(&[u8]) -> Result<(), String>;

impl RosBag {
    /// Whether a file or folder is a bag by its name. An `.mcap` may be one of ours as well as one of rosbag2.
    pub fn is_one(path: &Path) -> bool {
        let extension = path.extension().and_then(|e| e.to_str());
        path.is_dir() || matches!(extension, Some("bag" | "db3"))
    }

    /// Opens a bag: a file, or the folder of rosbag2 with all its parts.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let parts = if path.is_dir() {
            parts_of(path)?
        } else {
            vec![path.to_owned()]
        };
        let mut bag = Self {
            path: path.to_owned(),
            parts: Vec::with_capacity(parts.len()),
            topics: BTreeMap::new(),
        };
        for part in parts {
            let extension = part.extension().and_then(|e| e.to_str());
            let file = match extension {
                Some("bag") => Part::Ros1(ros1::Bag::open(&part)?),
                Some("db3") => Part::Sqlite(sqlite::Database::open(&part)?),
                _ => Part::Mcap(Recording::open(&part).map_err(|e| unreadable(&part, e))?),
            };
            bag.topics.extend(file.topics());
            bag.parts.push(file);
        }
        Ok(bag)
    }

    /// Whether it has messages of that topic.
    pub fn has_topic(&self, topic: &str) -> bool {
        self.topics.contains_key(topic)
    }

    /// Gives each image of a topic, with its stamp in nanoseconds, in the order of the bag, until all are given or one is
    /// answered with an error.
    pub fn images(
        &self,
        topic: &str,
        each: &mut dyn FnMut(i64, Image) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let decode = match self.type_of(topic)? {
            IMAGE => message::image,
            COMPRESSED_IMAGE => message::compressed_image,
            other => {
                return Err(self.wrong(format!(
                    "{topic} has messages {other}, {IMAGE} or {COMPRESSED_IMAGE} are needed; images are on {}",
                    self.listed(&[IMAGE, COMPRESSED_IMAGE])
                )));
            }
        };
        let mut ended = None;
        let visited = self.visit(topic, |layout, bytes| {
            let (stamp, image) = decode(layout, bytes)?;
            each(stamp, image).map_err(|error| ended.insert(error).to_string())
        });
        ended.map_or(visited, Err)
    }

    /// The samples of an IMU: of `topic`, or of the only one there is.
    pub fn imu(&self, topic: Option<&str>) -> Result<Vec<(Timestamp, ImuSample)>, Error> {
        let all: Vec<&String> = self
            .topics
            .iter()
            .filter(|(_, kind)| *kind == IMU)
            .map(|(name, _)| name)
            .collect();
        let topic = match (topic, &all[..]) {
            (Some(topic), _) => topic,
            (None, [only]) => only,
            (None, []) => return Err(self.wrong(format!("no topic with messages {IMU}"))),
            (None, _) => {
                return Err(self.wrong(format!(
                    "several IMUs: name the topic of one with --imu: {}",
                    self.listed(&[IMU])
                )));
            }
        };
        if self.type_of(topic)? != IMU {
            return Err(self.wrong(format!(
                "{topic} has no messages {IMU}; these have: {}",
                self.listed(&[IMU])
            )));
        }
        let mut samples = Vec::new();
        self.visit(topic, |layout, bytes| {
            let (stamp, sample) = message::imu(layout, bytes)?;
            samples.push((Timestamp::from_nanos(stamp), sample));
            Ok(())
        })?;
        Ok(samples)
    }

    fn visit(
        &self,
        topic: &str,
        mut each: impl FnMut(Layout, &[u8]) -> Result<(), String>,
    ) -> Result<(), Error> {
        let mut number = 0;
        for file in &self.parts {
            let layout = file.layout();
            let mut counted = |bytes: &[u8]| {
                number += 1;
                each(layout, bytes)
                    .map_err(|problem| format!("message {number} of {topic}: {problem}"))
            };
            file.visit(topic, &mut counted)?;
        }
        Ok(())
    }

    fn type_of(&self, topic: &str) -> Result<&str, Error> {
        self.topics.get(topic).map(String::as_str).ok_or_else(|| {
            self.wrong(format!(
                "no topic {topic}; images are on {}, IMUs on {}",
                self.listed(&[IMAGE, COMPRESSED_IMAGE]),
                self.listed(&[IMU])
            ))
        })
    }

    /// Topics of some types in a sentence.
    fn listed(&self, kinds: &[&str]) -> String {
        let of_kinds = self
            .topics
            .iter()
            .filter(|(_, kind)| kinds.contains(&kind.as_str()));
        let names: Vec<&str> = of_kinds.map(|(name, _)| name.as_str()).collect();
        match names.is_empty() {
            true => "none".to_owned(),
            false => names.join(", "),
        }
    }

    fn wrong(&self, problem: String) -> Error {
        unreadable(&self.path, problem)
    }
}

impl Part {
    /// Topics and the types of their messages, in the words of ROS 1.
    fn topics(&self) -> Vec<(String, String)> {
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

    fn layout(&self) -> Layout {
        match self {
            Self::Ros1(_) => Layout::Ros1,
            Self::Mcap(_) | Self::Sqlite(_) => Layout::Cdr,
        }
    }

    fn visit(&self, topic: &str, each: Visit<'_>) -> Result<(), Error> {
        match self {
            Self::Ros1(bag) => bag.visit(topic, each),
            Self::Sqlite(database) => database.visit(topic, each),
            Self::Mcap(recording) => {
                let wrong = |e: &dyn std::fmt::Display| unreadable(recording.path(), e);
                if !recording.topics().iter().any(|t| t.topic == topic) {
                    return Ok(());
                }
                for message in recording.messages(topic).map_err(|e| wrong(&e))? {
                    let message = message.map_err(|e| wrong(&e))?;
                    each(&message.bytes).map_err(|e| wrong(&e))?;
                }
                Ok(())
            }
        }
    }
}

/// The parts of a rosbag2 folder, in the order of their numbers.
fn parts_of(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let io = |source| Error::Io {
        path: folder.display().to_string(),
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
                "a bag that was compressed as a whole: unpack it with `zstd -d` first",
            ));
        }
        if name.ends_with(".db3") || name.ends_with(".mcap") {
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

fn unreadable(path: &Path, problem: impl std::fmt::Display) -> Error {
    Error::Parse {
        path: path.display().to_string(),
        problem: problem.to_string(),
    }
}

#[cfg(test)]
mod tests;
