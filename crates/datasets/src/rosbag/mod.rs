//! Images, clouds, LiDAR packets and samples of an IMU out of ROS bags: `.bag` of ROS 1, and `.mcap`, `.db3` or the folder of rosbag2.
//!
//! A message's time is that of its header, when it was measured, not that of the bag, when it arrived.

mod file;
mod frames;
mod message;
mod part;
mod ros1;
mod sqlite;
mod taken;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_recording::message::{
    CdrReader, CloudMessage, Layout, StaticTransform, decode_cloud, decode_packets_of,
    lidar_packet_types,
};
use lsfb_types::{Image, Packet};

use crate::Error;
use file::unreadable;
pub use frames::pose_in;
use part::{Part, missing_parts, parts_of};
use taken::lidar_messages;
pub use taken::{BagImu, LidarMessages, LidarTopic, Unread};

/// Message types by their names in ROS 1; those of ROS 2 have `msg` between.
const IMAGE: &str = "sensor_msgs/Image";
const COMPRESSED_IMAGE: &str = "sensor_msgs/CompressedImage";
const IMU: &str = "sensor_msgs/Imu";
const CLOUD: &str = "sensor_msgs/PointCloud2";
const TF: &str = "tf2_msgs/TFMessage";
/// Where the poses of sensors on their carrier are told.
const TF_STATIC: &str = "/tf_static";

/// A bag, in one file or several.
pub struct RosBag {
    path: PathBuf,
    parts: Vec<Part>,
    /// What the folder says of parts that are not there.
    missing: Vec<String>,
    /// Type of the messages of each topic.
    topics: BTreeMap<String, String>,
}

impl RosBag {
    /// Whether a file or folder is a bag by its name. An `.mcap` may be one of ours as well as one of rosbag2.
    pub fn is_one(path: &Path) -> bool {
        let extension = path.extension().and_then(|e| e.to_str());
        path.is_dir() || matches!(extension, Some("bag" | "db3"))
    }

    /// Whether a file is a part of a bag of ROS 2 by its name.
    pub fn is_file_of_one(path: &Path) -> bool {
        part::is_file_of_one(path)
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
            missing: match path.is_dir() {
                true => missing_parts(path, &parts),
                false => Vec::new(),
            },
            parts: Vec::with_capacity(parts.len()),
            topics: BTreeMap::new(),
        };
        for part in parts {
            let file = Part::open(&part)?;
            bag.topics.extend(file.topics());
            bag.parts.push(file);
        }
        Ok(bag)
    }

    /// What is missing from files that end early or are torn, and which files are not there; other damage is noted beside the messages
    /// that it costs.
    pub fn damage(&self) -> Vec<String> {
        let missing = self.missing.iter().cloned();
        missing
            .chain(self.parts.iter().flat_map(Part::damage))
            .collect()
    }

    /// Whether it has messages of that topic.
    pub fn has_topic(&self, topic: &str) -> bool {
        self.topics.contains_key(topic)
    }

    /// Gives each image of a topic, with its stamp in nanoseconds, in the order of the bag, until all are given or one is
    /// answered with an error.
    pub fn images<E: From<Error>>(
        &self,
        topic: &str,
        each: &mut dyn FnMut(i64, Image) -> Result<(), E>,
    ) -> Result<(), E> {
        let decode = match self.type_of(topic)? {
            IMAGE => message::image,
            COMPRESSED_IMAGE => message::compressed_image,
            other => {
                let problem = format!(
                    "{topic} has messages {other}, but {IMAGE} or {COMPRESSED_IMAGE} are needed; images are on {}",
                    self.listed(&[IMAGE, COMPRESSED_IMAGE])
                );
                return Err(self.wrong(problem).into());
            }
        };
        let mut unread = Unread::default();
        let all = |(stamp, image)| each(stamp, image);
        self.visit_until(topic, decode, &mut unread, all)?;
        // Who asked for images misses one that is gone.
        match unread.first {
            Some(problem) => Err(self.wrong(problem).into()),
            None => Ok(()),
        }
    }

    /// The topic of a LiDAR: `topic`, or the only one there is; clouds go before packets.
    pub fn lidar(&self, topic: Option<&str>) -> Result<LidarTopic, Error> {
        let all: Vec<LidarTopic> = self
            .topics
            .iter()
            .filter_map(|(topic, kind)| {
                Some(LidarTopic {
                    topic: topic.clone(),
                    messages: lidar_messages(kind)?,
                })
            })
            .collect();
        let names = || {
            let names: Vec<&str> = all.iter().map(|t| t.topic.as_str()).collect();
            names.join(", ")
        };
        if let Some(topic) = topic {
            let found = all.iter().find(|t| t.topic == topic).cloned();
            return found.ok_or_else(|| {
                self.wrong(match all.is_empty() {
                    true => format!("{topic} has no scans, and no other topic has"),
                    false => format!("{topic} has no scans; these have: {}", names()),
                })
            });
        }
        let clouds = || all.iter().filter(|t| t.messages == LidarMessages::Clouds);
        let chosen: Vec<&LidarTopic> = match clouds().count() {
            0 => all.iter().collect(),
            _ => clouds().collect(),
        };
        match chosen.as_slice() {
            [only] => Ok((*only).clone()),
            [] => {
                let kinds = self.topics.iter().map(|(t, kind)| format!("{t} ({kind})"));
                let kinds = kinds.collect::<Vec<_>>().join(", ");
                let read: Vec<&str> = lidar_packet_types().collect();
                let read = read.join(", ");
                Err(self.wrong(format!(
                    "no topic with scans: {CLOUD}, {read} are supported; it has {kinds}"
                )))
            }
            _ => Err(self.wrong(format!(
                "several LiDARs: choose a topic with --lidar-topic: {}",
                names()
            ))),
        }
    }

    /// Gives each cloud of a topic in the order of the bag, until all are given or one is answered with an error. Those that cannot be
    /// read are passed over and counted.
    pub fn clouds<E: From<Error>>(
        &self,
        topic: &str,
        each: &mut dyn FnMut(CloudMessage) -> Result<(), E>,
    ) -> Result<Unread, E> {
        let decode = |layout, bytes: &[u8]| decode_cloud(layout, bytes).map_err(|e| e.to_string());
        let mut unread = Unread::default();
        self.visit_until(topic, decode, &mut unread, each)?;
        Ok(unread)
    }

    /// Gives the LiDAR packets of each message of a topic in the order of the bag, until all are given or some are answered with
    /// an error. Messages that cannot be read are passed over and counted.
    pub fn packets<E: From<Error>>(
        &self,
        topic: &str,
        each: &mut dyn FnMut(Vec<Packet>) -> Result<(), E>,
    ) -> Result<Unread, E> {
        let schema = self.type_of(topic)?.replacen('/', "/msg/", 1);
        let decode = |layout, bytes: &[u8]| {
            decode_packets_of(layout, &schema, bytes).map_err(|e| e.to_string())
        };
        let mut unread = Unread::default();
        self.visit_until(topic, decode, &mut unread, each)?;
        Ok(unread)
    }

    /// The frame of the first message of a topic that can be read.
    pub fn frame(&self, topic: &str) -> Result<String, Error> {
        let mut frame = None;
        let visited = self.visit(topic, |layout, bytes| {
            let header = bytes.ok().and_then(|bytes| {
                let mut r = CdrReader::with_layout(layout, bytes).ok()?;
                r.header().ok().map(|h| h.frame_id.to_owned())
            });
            frame = header;
            // One is enough.
            match frame {
                Some(_) => Err(String::new()),
                None => Ok(()),
            }
        });
        match frame {
            Some(frame) => Ok(frame),
            None => {
                visited.and_then(|()| Err(self.wrong(format!("no message on {topic} can be read"))))
            }
        }
    }

    /// The edges of `/tf_static`; none where the bag has no such topic.
    pub fn static_transforms(&self) -> Result<Vec<StaticTransform>, Error> {
        let mut all = Vec::new();
        if self.topics.get(TF_STATIC).is_some_and(|kind| kind == TF) {
            self.visit(TF_STATIC, |layout, bytes| {
                all.extend(message::transforms(layout, bytes?)?);
                Ok(())
            })?;
        }
        Ok(all)
    }

    /// Whether it has samples of an IMU.
    pub fn has_imu(&self) -> bool {
        self.topics.values().any(|kind| kind == IMU)
    }

    /// The samples of an IMU: of `topic`, or of the only one there is.
    pub fn imu(&self, topic: Option<&str>) -> Result<BagImu, Error> {
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
                    "several IMUs: choose a topic with --imu: {}",
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
        let mut imu = BagImu {
            topic: topic.to_owned(),
            frame: String::new(),
            samples: Vec::new(),
            unread: Unread::default(),
        };
        let mut unread = Unread::default();
        self.visit_until(
            topic,
            message::imu,
            &mut unread,
            |(stamp, frame, sample)| {
                if imu.samples.is_empty() {
                    imu.frame = frame;
                }
                imu.samples.push((stamp, sample));
                Ok::<_, Error>(())
            },
        )?;
        Ok(BagImu { unread, ..imu })
    }

    /// Gives each message of a topic, decoded, until one is answered with an error; notes those that cannot be read.
    fn visit_until<T, E: From<Error>>(
        &self,
        topic: &str,
        decode: impl Fn(Layout, &[u8]) -> Result<T, String>,
        unread: &mut Unread,
        mut each: impl FnMut(T) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut ended = None;
        let mut number = 0;
        let visited = self.visit(topic, |layout, bytes| {
            number += 1;
            match bytes.and_then(|bytes| decode(layout, bytes)) {
                Ok(message) => each(message).map_err(|error| {
                    ended = Some(error);
                    String::new()
                }),
                Err(problem) => {
                    unread.note(format!("message {number} of {topic}: {problem}"));
                    Ok(())
                }
            }
        });
        ended.map_or(visited.map_err(E::from), Err)
    }

    fn visit(
        &self,
        topic: &str,
        mut each: impl FnMut(Layout, Result<&[u8], String>) -> Result<(), String>,
    ) -> Result<(), Error> {
        let mut number = 0;
        for file in &self.parts {
            let layout = file.layout();
            let mut counted = |bytes: Result<&[u8], String>| {
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
                "no topic {topic}; images are on {}, IMUs on {}, clouds on {}",
                self.listed(&[IMAGE, COMPRESSED_IMAGE]),
                self.listed(&[IMU]),
                self.listed(&[CLOUD])
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

#[cfg(test)]
mod tests;
