use std::collections::BTreeMap;
use std::path::Path;

use lsfb_geometry::Rig;
use lsfb_types::{Image, ImuSample, LidarScan, Packet, Progress, ProgressFn, Stamped, Timestamp};

use crate::cdr::CdrError;
use crate::error::{Damage, Error};
use crate::index::Index;
use crate::layout::TopicSummary;
use crate::message::{self, FrameMeta};
use crate::record::{self, HEAD_BYTES, MessageRecord, NamedRecord, opcode};
use crate::source::Source;
use crate::walk::{Role, Waiting, Walk, stamped, timestamp, with_ticks};
use crate::{chunk, index, topic};

/// A recording, read chunk by chunk: memory holds one chunk per iterator.
///
/// A file that was cut, or damaged in the middle, opens; [`Recording::damage`] says what is missing. Damage inside a
/// chunk shows when the chunk is read: the iterator gives one [`Error::Damaged`] and goes on behind it.
pub struct Recording {
    source: Source,
    index: Index,
    topics: Vec<TopicSummary>,
}

/// First and last arrival in a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArrivalRange {
    /// The first.
    pub start: Timestamp,
    /// The last.
    pub end: Timestamp,
}

/// An image and which camera took it.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraImage {
    /// Index into the names that were asked for.
    pub camera: usize,
    /// The image.
    pub image: Stamped<Image>,
}

/// Bytes as a device sent them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordedPacket {
    /// Synchronized time, the arrival where it was not known. For LiDAR data packets that of their revolution's first.
    pub time: Timestamp,
    /// Kind of traffic, by the driver's numbering.
    pub kind: u16,
    /// Counts what the source sent; for LiDAR data packets what was recorded.
    pub sequence: u64,
    /// Bytes and arrival.
    pub packet: Packet,
}

/// A message as it lies in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CdrMessage {
    /// Synchronized time.
    pub time: Timestamp,
    /// Host receive time.
    pub arrival: Timestamp,
    /// The serialised message.
    pub bytes: Vec<u8>,
}

impl Recording {
    /// Opens a file. Its end may be missing and parts of it broken; see [`Recording::damage`].
    pub fn open(path: &Path) -> Result<Self, Error> {
        let source = Source::open(path)?;
        let path = path.to_owned();
        if source.bytes == 0 {
            return Err(Error::Empty { path });
        }
        let magic_bytes = mcap::MAGIC.len() as u64;
        let start = source.read(0, 4096)?;
        let Some(mut records) = start.strip_prefix(mcap::MAGIC) else {
            return Err(Error::NotMcap { path });
        };
        let header = match record::next_record(&mut records) {
            Some((opcode::HEADER, body)) => record::Fields(body)
                .string()
                .map(|profile| (profile, body.len() as u64)),
            _ => None,
        };
        let Some((profile, header_bytes)) = header else {
            return Err(Error::NotMcap { path });
        };
        if profile != "ros2" {
            let found = profile.to_owned();
            return Err(Error::Profile { path, found });
        }
        let index = index::read(&source, magic_bytes + HEAD_BYTES + header_bytes)?;
        let topics = topics(&index);
        Ok(Self {
            source,
            index,
            topics,
        })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.source.path
    }

    /// The topics, by name.
    pub fn topics(&self) -> &[TopicSummary] {
        &self.topics
    }

    /// What was found missing when the recording was opened; empty where it is whole as far as its index tells.
    /// [`Recording::verify`] looks at everything.
    pub fn damage(&self) -> &[Damage] {
        &self.index.damage
    }

    /// First and last arrival; `None` without messages.
    pub fn arrival_range(&self) -> Option<ArrivalRange> {
        Some(ArrivalRange {
            start: timestamp(self.index.chunks.iter().map(|c| c.start_time).min()?),
            end: timestamp(self.index.chunks.iter().map(|c| c.end_time).max()?),
        })
    }

    /// Reads every chunk and says everything that is missing, in the order of the file.
    pub fn verify(&self, progress: ProgressFn<'_>) -> Result<Vec<Damage>, Error> {
        let mut found = self.index.damage.clone();
        let mut records = Vec::new();
        for (done, entry) in self.index.chunks.iter().enumerate() {
            progress(Progress {
                stage: "verify recording",
                done: done as u64,
                total: self.index.chunks.len() as u64,
            });
            match chunk::read(&self.source, entry, &mut records) {
                Ok(()) => {}
                Err(Error::Damaged { damage, .. }) => found.push(damage),
                Err(error) => return Err(error),
            }
        }
        found.sort_by_key(|d| d.offset);
        Ok(found)
    }

    /// The rig that was attached.
    pub fn rig(&self) -> Result<Rig, Error> {
        let text = self.attachment("rig.toml")?;
        let origin = format!("{} (attachment rig.toml)", self.path().display());
        Ok(Rig::from_toml(&String::from_utf8_lossy(&text), &origin)?)
    }

    /// Content of an attachment.
    pub fn attachment(&self, name: &str) -> Result<Vec<u8>, Error> {
        let missing = || Error::MissingAttachment {
            path: self.path().to_owned(),
            name: name.to_owned(),
        };
        let entry = self
            .index
            .attachments
            .iter()
            .rfind(|a| a.name == name)
            .ok_or_else(missing)?;
        let bytes = self.source.read(entry.offset, entry.record_bytes)?;
        match record::next_record(&mut bytes.as_slice()) {
            Some((opcode::ATTACHMENT, body)) => {
                record::attachment(body).map(|(_, data)| data.to_vec())
            }
            _ => None,
        }
        .ok_or_else(|| self.broken("attachment", entry))
    }

    /// Entries of a metadata record, `lsfb.session` among them; empty where there is none of that name.
    pub fn metadata(&self, name: &str) -> Result<BTreeMap<String, String>, Error> {
        let Some(entry) = self.index.metadata.iter().rfind(|m| m.name == name) else {
            return Ok(BTreeMap::new());
        };
        let bytes = self.source.read(entry.offset, entry.record_bytes)?;
        match record::next_record(&mut bytes.as_slice()) {
            Some((opcode::METADATA, body)) => record::metadata(body).map(|(_, entries)| entries),
            _ => None,
        }
        .ok_or_else(|| self.broken("metadata", entry))
    }

    /// Images of a camera in the order of the file. `cam0` is `/cam0/image` or `/sidecar/<id>/cam0/image`; a full topic
    /// name works as well.
    pub fn images(
        &self,
        camera: &str,
    ) -> Result<impl Iterator<Item = Result<Stamped<Image>, Error>> + use<'_>, Error> {
        Ok(self.images_of(&[camera])?.map(|item| item.map(|i| i.image)))
    }

    /// Images of several cameras in the order of the file, in one pass.
    pub fn images_of(
        &self,
        cameras: &[&str],
    ) -> Result<impl Iterator<Item = Result<CameraImage, Error>> + use<'_>, Error> {
        let mut roles = BTreeMap::new();
        for (camera, name) in cameras.iter().enumerate() {
            let topic = self.camera_topic(name)?;
            roles.extend(
                self.channels_of(&topic)
                    .map(|id| (id, Role::Sample(camera))),
            );
            roles.extend(
                self.channels_of(&topic::frame_meta(&topic))
                    .map(|id| (id, Role::Companion(camera))),
            );
        }
        let mut metas = Waiting::default();
        Ok(self.samples(roles, move |role, message| match role {
            Role::Companion(camera) => {
                metas.put(
                    camera,
                    message.publish_time,
                    message::decode_frame_meta(message.data)?,
                );
                Ok(None)
            }
            Role::Sample(camera) => {
                let meta = metas.take(camera, message.publish_time).unwrap_or_default();
                let mut image = stamped(
                    message,
                    meta.device_ticks,
                    message::decode_image(message.data)?,
                );
                image.sample.exposure_ns = meta.exposure_ns;
                image.sample.frame_id = meta.frame_id;
                Ok(Some(CameraImage { camera, image }))
            }
        }))
    }

    /// What a camera said about its frames, trailers included.
    pub fn frame_meta(
        &self,
        camera: &str,
    ) -> Result<impl Iterator<Item = Result<Stamped<FrameMeta>, Error>> + use<'_>, Error> {
        let topic = topic::frame_meta(&self.camera_topic(camera)?);
        let roles = self.sample_role(&topic, message::FRAME_META.name)?;
        Ok(self.samples(roles, |_, message| {
            let meta = message::decode_frame_meta(message.data)?;
            Ok(Some(stamped(message, meta.device_ticks, meta)))
        }))
    }

    /// Inertial samples of the only IMU.
    pub fn imu(
        &self,
    ) -> Result<impl Iterator<Item = Result<Stamped<ImuSample>, Error>> + use<'_>, Error> {
        let topic = self.only_topic("IMU", |t| t.schema == message::IMU.name)?;
        let mut roles = self.sample_role(&topic, message::IMU.name)?;
        roles.extend(
            self.channels_of(&topic::imu_time_ref(&topic))
                .map(|id| (id, Role::Companion(0))),
        );
        Ok(self.samples(roles, with_ticks(message::decode_imu)))
    }

    /// LiDAR scans.
    pub fn scans(
        &self,
    ) -> Result<impl Iterator<Item = Result<Stamped<LidarScan>, Error>> + use<'_>, Error> {
        let mut roles = self.sample_role(topic::LIDAR_POINTS, message::POINT_CLOUD.name)?;
        roles.extend(
            self.channels_of(topic::LIDAR_TIME_REF)
                .map(|id| (id, Role::Companion(0))),
        );
        Ok(self.samples(roles, with_ticks(message::decode_points)))
    }

    /// Packets of a source as received: `lidar/packets`, `lidar/position`, or a device on `/raw/<device>`.
    pub fn packets(
        &self,
        source: &str,
    ) -> Result<impl Iterator<Item = Result<RecordedPacket, Error>> + use<'_>, Error> {
        let is_lidar =
            source.trim_start_matches('/') == topic::LIDAR_PACKETS.trim_start_matches('/');
        let (topic, schema) = if is_lidar {
            (topic::LIDAR_PACKETS.to_owned(), message::VELODYNE_SCAN.name)
        } else {
            (topic::raw(source), message::RAW_PACKET.name)
        };
        let roles = self.sample_role(&topic, schema)?;
        let mut recorded = 0;
        let batches = self.samples(roles, move |_, message| {
            let time = timestamp(message.publish_time);
            if !is_lidar {
                let raw = message::decode_raw_packet(message.data)?;
                return Ok(Some(vec![RecordedPacket {
                    time,
                    kind: raw.kind,
                    sequence: raw.sequence,
                    packet: Packet {
                        arrival: timestamp(message.log_time),
                        bytes: raw.bytes,
                    },
                }]));
            }
            let packets = message::decode_velodyne_scan(message.data)?
                .into_iter()
                .map(|packet| {
                    recorded += 1;
                    RecordedPacket {
                        time,
                        kind: 0,
                        sequence: recorded - 1,
                        packet,
                    }
                });
            Ok(Some(packets.collect()))
        });
        Ok(batches.flat_map(|batch| match batch {
            Ok(packets) => packets.into_iter().map(Ok).collect::<Vec<_>>(),
            Err(error) => vec![Err(error)],
        }))
    }

    /// The schema of a topic as it lies in the file: the `ros2msg` text. `None` where there is no such topic.
    pub fn schema_text(&self, topic: &str) -> Option<&str> {
        let id = self.channels_of(topic).next()?;
        let channel = self.index.channels.get(&id)?;
        let schema = self.index.schemas.get(&channel.schema_id)?;
        Some(&schema.text)
    }

    /// Messages of a topic as they lie in the file.
    pub fn messages(
        &self,
        topic: &str,
    ) -> Result<impl Iterator<Item = Result<CdrMessage, Error>> + use<'_>, Error> {
        let roles: BTreeMap<_, _> = self
            .channels_of(topic)
            .map(|id| (id, Role::Sample(0)))
            .collect();
        if roles.is_empty() {
            return Err(self.no_such_topic(topic));
        }
        Ok(self.samples(roles, |_, message| {
            Ok(Some(CdrMessage {
                time: timestamp(message.publish_time),
                arrival: timestamp(message.log_time),
                bytes: message.data.to_vec(),
            }))
        }))
    }

    /// Walks over the messages of some channels in the order of the file, decoding what `decode` wants to give.
    fn samples<T>(
        &self,
        roles: BTreeMap<u16, Role>,
        mut decode: impl FnMut(Role, &MessageRecord<'_>) -> Result<Option<T>, CdrError>,
    ) -> impl Iterator<Item = Result<T, Error>> {
        let mut walk = Walk::new(&self.source, &self.index, roles);
        std::iter::from_fn(move || {
            loop {
                let found = match walk.next_message()? {
                    Ok(found) => found,
                    Err(error) => return Some(Err(error)),
                };
                match decode(found.role, &found.message) {
                    Ok(None) => {}
                    Ok(Some(sample)) => return Some(Ok(sample)),
                    Err(source) => {
                        let channel = self.index.channels.get(&found.message.channel_id);
                        return Some(Err(Error::Message {
                            path: self.path().to_owned(),
                            topic: channel.map_or_else(String::new, |c| c.topic.clone()),
                            time_nanos: timestamp(found.message.publish_time).nanos(),
                            source,
                        }));
                    }
                }
            }
        })
    }

    fn sample_role(&self, topic: &str, schema: &str) -> Result<BTreeMap<u16, Role>, Error> {
        self.check_type(topic, schema)?;
        Ok(self
            .channels_of(topic)
            .map(|id| (id, Role::Sample(0)))
            .collect())
    }

    fn camera_topic(&self, camera: &str) -> Result<String, Error> {
        let topic = if camera.starts_with('/') {
            camera.to_owned()
        } else {
            let own = topic::image(camera);
            let is_sidecar = |t: &TopicSummary| {
                t.topic.starts_with("/sidecar/") && topic::camera_of(&t.topic) == Some(camera)
            };
            if self.topics.iter().any(|t| t.topic == own) {
                own
            } else {
                self.only_topic(camera, is_sidecar)?
            }
        };
        self.check_type(&topic, message::IMAGE.name)?;
        Ok(topic)
    }

    fn only_topic(
        &self,
        wanted: &str,
        matches: impl Fn(&TopicSummary) -> bool,
    ) -> Result<String, Error> {
        let found: Vec<&str> = self
            .topics
            .iter()
            .filter(|t| matches(t))
            .map(|t| t.topic.as_str())
            .collect();
        match found.as_slice() {
            [] => Err(self.no_such_topic(wanted)),
            [topic] => Ok((*topic).to_owned()),
            several => Err(Error::AmbiguousTopic {
                path: self.path().to_owned(),
                wanted: wanted.to_owned(),
                candidates: several.join(", "),
            }),
        }
    }

    fn channels_of(&self, topic: &str) -> impl Iterator<Item = u16> {
        let matching = self
            .index
            .channels
            .values()
            .filter(move |c| c.topic == topic);
        matching.map(|c| c.id).collect::<Vec<_>>().into_iter()
    }

    fn check_type(&self, topic: &str, schema: &str) -> Result<(), Error> {
        let mut known = false;
        for channel in self.index.channels.values().filter(|c| c.topic == topic) {
            known = true;
            let found = self
                .index
                .schemas
                .get(&channel.schema_id)
                .map_or("no schema", |s| s.name.as_str());
            if found != schema || channel.message_encoding != "cdr" {
                return Err(Error::TopicType {
                    path: self.path().to_owned(),
                    topic: topic.to_owned(),
                    found: format!("{} {found}", channel.message_encoding),
                    expected: format!("cdr {schema}"),
                });
            }
        }
        if known {
            Ok(())
        } else {
            Err(self.no_such_topic(topic))
        }
    }

    fn no_such_topic(&self, wanted: &str) -> Error {
        let available: Vec<&str> = self.topics.iter().map(|t| t.topic.as_str()).collect();
        Error::NoSuchTopic {
            path: self.path().to_owned(),
            wanted: wanted.to_owned(),
            available: if available.is_empty() {
                "no topics".to_owned()
            } else {
                available.join(", ")
            },
        }
    }

    fn broken(&self, what: &str, entry: &NamedRecord) -> Error {
        let reason = format!("{what} `{}` is broken", entry.name);
        self.source
            .damaged(entry.offset, entry.record_bytes, None, reason)
    }
}

fn topics(index: &Index) -> Vec<TopicSummary> {
    let mut topics: BTreeMap<&str, TopicSummary> = BTreeMap::new();
    for channel in index.channels.values() {
        let schema = index.schemas.get(&channel.schema_id);
        let entry = topics
            .entry(&channel.topic)
            .or_insert_with(|| TopicSummary {
                topic: channel.topic.clone(),
                schema: schema.map_or_else(String::new, |s| s.name.clone()),
                messages: 0,
            });
        entry.messages += index
            .messages_by_channel
            .get(&channel.id)
            .copied()
            .unwrap_or(0);
    }
    topics.into_values().collect()
}
