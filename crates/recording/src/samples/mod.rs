//! What a recording holds, decoded: one walk over the chunks per iterator.

mod poses;
mod surroundings;

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use lsfb_geometry::MAIN_LIDAR;
use lsfb_types::{Image, ImuSample, LidarScan, Packet, Stamped, Timestamp};

use crate::cdr::CdrError;
use crate::container::chunk_cache::ChunkCache;
use crate::container::record::MessageRecord;
use crate::container::record::timestamp;
use crate::error::Error;
use crate::layout::TopicSummary;
use crate::message::{self, FrameMeta};
use crate::message_iter::{MessageIter, Role, Waiting, stamped, with_ticks};
use crate::reader::{CdrMessage, Recording};
use crate::topic;

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

/// How the messages of a topic hold packets.
#[derive(Clone, Copy, PartialEq, Eq)]
enum PacketsAre {
    Single,
    /// All of a revolution.
    InScans,
}

impl Recording {
    /// Images of a camera in the order of the file. `cam0` is `/cam0/image` or `/sidecar/<id>/cam0/image`; a full topic
    /// name works as well.
    pub fn images(
        &self,
        camera: &str,
    ) -> Result<impl Iterator<Item = Result<Stamped<Image>, Error>> + use<'_>, Error> {
        Ok(self.images_of(&[camera])?.map(|item| item.map(|i| i.image)))
    }

    /// Images of several cameras in the order of their synchronized time, cameras in the order of the names where that is
    /// equal; how far apart their links ran does not matter. Within a camera the order of the file is kept.
    pub fn images_of(
        &self,
        cameras: &[&str],
    ) -> Result<impl Iterator<Item = Result<CameraImage, Error>> + use<'_>, Error> {
        let cache = Rc::new(RefCell::new(ChunkCache::new(cameras.len() + 1)));
        let mut streams = Vec::new();
        for name in cameras {
            let topic = self.camera_topic(name)?;
            let mut roles: BTreeMap<u16, Role> = BTreeMap::new();
            roles.extend(self.channels_of(&topic).map(|id| (id, Role::Sample(0))));
            roles.extend(
                self.channels_of(&topic::frame_meta(&topic))
                    .map(|id| (id, Role::Companion(0))),
            );
            let mut metas = Waiting::default();
            let walk = MessageIter::through(&self.source, &self.index, roles, Rc::clone(&cache));
            streams.push(self.decoded(walk, move |role, message| match role {
                Role::Companion(of) => {
                    let meta = message::decode_frame_meta(message.data)?;
                    metas.put(of, message.publish_time, meta);
                    Ok(None)
                }
                Role::Sample(of) => {
                    let meta = metas.take(of, message.publish_time).unwrap_or_default();
                    let sample = message::decode_image(message.data)?;
                    let mut image = stamped(message, meta.device_ticks, sample);
                    image.sample.exposure_ns = meta.exposure_ns;
                    image.sample.frame_id = meta.frame_id;
                    Ok(Some(image))
                }
            }));
        }
        Ok(merge_by_time(streams))
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

    /// Inertial samples of the rig's IMU: `imu0` where there are several, else the only one.
    pub fn imu(
        &self,
    ) -> Result<impl Iterator<Item = Result<Stamped<ImuSample>, Error>> + use<'_>, Error> {
        let own = topic::imu("imu0");
        let topic = if self.topics().iter().any(|t| t.topic == own) {
            own
        } else {
            self.only_topic("IMU", |t| t.schema == message::IMU.name)?
        };
        let mut roles = self.sample_role(&topic, message::IMU.name)?;
        roles.extend(
            self.channels_of(&topic::imu_time_ref(&topic))
                .map(|id| (id, Role::Companion(0))),
        );
        Ok(self.samples(roles, with_ticks(message::decode_imu)))
    }

    /// Scans of the main LiDAR: of [`MAIN_LIDAR`], or of the first by name where there is none of that name.
    pub fn scans(
        &self,
    ) -> Result<impl Iterator<Item = Result<Stamped<LidarScan>, Error>> + use<'_>, Error> {
        self.scans_of(&self.main_lidar())
    }

    /// Name of the LiDAR whose scans [`Recording::scans`] gives.
    pub fn main_lidar(&self) -> String {
        let clouds = self.topics().iter().filter_map(|t| {
            let name = t.topic.strip_prefix('/')?.strip_suffix("/points")?;
            (t.schema == message::POINT_CLOUD.name && !name.contains('/')).then_some(name)
        });
        // As a rig chooses its own.
        let first = clouds.min_by_key(|name| (*name != MAIN_LIDAR, *name));
        first.unwrap_or(MAIN_LIDAR).to_owned()
    }

    /// Scans of the LiDAR named `lidar`.
    pub fn scans_of(
        &self,
        lidar: &str,
    ) -> Result<impl Iterator<Item = Result<Stamped<LidarScan>, Error>> + use<'_>, Error> {
        let mut roles = self.sample_role(&topic::lidar_points(lidar), message::POINT_CLOUD.name)?;
        roles.extend(
            self.channels_of(&topic::lidar_time_ref(lidar))
                .map(|id| (id, Role::Companion(0))),
        );
        let mut decode = with_ticks(|bytes| message::decode_cloud(message::Layout::Cdr, bytes));
        Ok(self.samples(roles, move |role, message| {
            let cloud = decode(role, message)?;
            Ok(cloud.map(|stamped| {
                let late_ns = stamped.sample.begins() - stamped.sample.stamp;
                Stamped {
                    time: stamped.time.plus_nanos(late_ns),
                    arrival: stamped.arrival,
                    device_ticks: stamped.device_ticks,
                    sample: stamped.sample.cloud.scan,
                }
            }))
        }))
    }

    /// Packets of a source as received: `<lidar>/packets`, `<lidar>/position`, or a device on `/raw/<device>`.
    pub fn packets(
        &self,
        source: &str,
    ) -> Result<impl Iterator<Item = Result<RecordedPacket, Error>> + use<'_>, Error> {
        let source = source.trim_start_matches('/');
        let topic = match source.strip_suffix("/packets") {
            Some(lidar) => topic::lidar_packets(lidar),
            None => topic::raw(source),
        };
        self.packets_on(&topic)
    }

    /// Topics with LiDAR data packets, whatever their names: recordings of `rosbag2` have them too.
    pub fn lidar_packet_topics(&self) -> impl Iterator<Item = &str> {
        self.topics()
            .iter()
            .filter(|t| message::holds_lidar_packets(&t.schema))
            .map(|t| t.topic.as_str())
    }

    /// LiDAR data packets from the one topic that carries them.
    pub fn lidar_packets(
        &self,
    ) -> Result<impl Iterator<Item = Result<RecordedPacket, Error>> + use<'_>, Error> {
        let carries = |t: &TopicSummary| message::holds_lidar_packets(&t.schema);
        self.packets_on(&self.only_topic("LiDAR packets", carries)?)
    }

    /// Packets of the topic `topic`.
    pub fn packets_on(
        &self,
        topic: &str,
    ) -> Result<impl Iterator<Item = Result<RecordedPacket, Error>> + use<'_>, Error> {
        let there = self.topics().iter().find(|t| t.topic == topic);
        let (schema, packets_are) = match there {
            Some(t) if message::holds_lidar_packets(&t.schema) => {
                (t.schema.clone(), PacketsAre::InScans)
            }
            _ => (message::RAW_PACKET.name.to_owned(), PacketsAre::Single),
        };
        let roles = self.sample_role(topic, &schema)?;
        let mut recorded = 0;
        let batches = self.samples(roles, move |_, message| {
            let time = timestamp(message.publish_time);
            if packets_are == PacketsAre::Single {
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
            let packets = message::decode_lidar_packets(&schema, message.data)?
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
    fn samples<'a, T>(
        &'a self,
        roles: BTreeMap<u16, Role>,
        decode: impl FnMut(Role, &MessageRecord<'_>) -> Result<Option<T>, CdrError> + 'a,
    ) -> impl Iterator<Item = Result<T, Error>> + 'a {
        self.decoded(MessageIter::new(&self.source, &self.index, roles), decode)
    }

    fn decoded<'a, T>(
        &'a self,
        mut walk: MessageIter<'a>,
        mut decode: impl FnMut(Role, &MessageRecord<'_>) -> Result<Option<T>, CdrError> + 'a,
    ) -> impl Iterator<Item = Result<T, Error>> + 'a {
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
            if self.topics().iter().any(|t| t.topic == own) {
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
            .topics()
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
}

/// Merges streams by synchronized time. An error is given as soon as it is met: it belongs before what follows it.
fn merge_by_time<'a>(
    mut streams: Vec<impl Iterator<Item = Result<Stamped<Image>, Error>> + 'a>,
) -> impl Iterator<Item = Result<CameraImage, Error>> + 'a {
    let mut heads: Vec<Option<Stamped<Image>>> = streams.iter().map(|_| None).collect();
    std::iter::from_fn(move || {
        for (head, stream) in heads.iter_mut().zip(&mut streams) {
            if head.is_none() {
                match stream.next() {
                    Some(Ok(image)) => *head = Some(image),
                    Some(Err(error)) => return Some(Err(error)),
                    None => {}
                }
            }
        }
        let earliest = heads
            .iter()
            .enumerate()
            .filter_map(|(camera, head)| head.as_ref().map(|image| (image.time, camera)))
            .min()?;
        let camera = earliest.1;
        let image = heads.get_mut(camera)?.take()?;
        Some(Ok(CameraImage { camera, image }))
    })
}
