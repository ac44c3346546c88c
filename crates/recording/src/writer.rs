use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use lsfb_geometry::{Rig, Se3};
use lsfb_types::{Image, ImuSample, LidarScan, Packet, Stamped, Timestamp};
use mcap::records::{MessageHeader, Metadata};
use serde::{Deserialize, Serialize};

use crate::error::Error;
use crate::message::{self, FrameMeta, RawPacket, StaticTransform, TimeReference};
use crate::sink::{SharedState, Sink};
use crate::{summary, topic};

/// Compression of the chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compression {
    /// As they are.
    None,
    /// Fast; keeps up with four cameras on one core.
    #[default]
    Lz4,
    /// Smaller and slower.
    Zstd,
}

/// What a recording in progress survives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Durability {
    /// The end of the process: every closed chunk is with the operating system.
    #[default]
    Process,
    /// The end of the machine: every closed chunk is on the disk.
    Power,
}

/// How a recording is laid out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WriterConfig {
    /// Largest size of a chunk before compression, bytes. A larger message has a chunk of its own.
    pub chunk_bytes: u64,
    /// Longest time in one chunk, seconds: what a crash may cost.
    pub chunk_secs: f64,
    /// Compression of the chunks.
    pub compression: Compression,
    /// What the recording survives while it is being written.
    pub durability: Durability,
    /// Entries of the metadata record `lsfb.session`: `uuid`, `seed`, `operator`, `site` … The software's version is added.
    pub session: BTreeMap<String, String>,
}

impl Default for WriterConfig {
    fn default() -> Self {
        Self {
            chunk_bytes: 4 << 20,
            chunk_secs: 1.0,
            compression: Compression::default(),
            durability: Durability::default(),
            session: BTreeMap::new(),
        }
    }
}

/// What a topic carries.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicSummary {
    /// Its name.
    pub topic: String,
    /// Name of the message type, `package/msg/Type`.
    pub schema: String,
    /// Messages on it; 0 where a recording without summary does not tell.
    pub messages: u64,
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Summary {
    /// The file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Messages on all topics.
    pub messages: u64,
    /// The topics, by name.
    pub topics: Vec<TopicSummary>,
}

/// A topic whose messages arrive ready-made.
#[derive(Clone, Copy, Debug)]
pub struct Channel<'a> {
    /// Its name.
    pub topic: &'a str,
    /// Name of the message type, `package/msg/Type`.
    pub schema_name: &'a str,
    /// Its `ros2msg` definition.
    pub schema_text: &'a str,
}

struct OpenChannel {
    id: u16,
    schema: String,
    messages: u64,
}

/// A message on its way into the file.
struct Outgoing<'a> {
    topic: &'a str,
    schema_name: &'a str,
    schema_text: &'a str,
    bytes: &'a [u8],
}

impl<'a> Outgoing<'a> {
    fn new(topic: &'a str, schema: message::Schema, bytes: &'a [u8]) -> Self {
        Self {
            topic,
            schema_name: schema.name,
            schema_text: schema.text,
            bytes,
        }
    }
}

struct OpenChunk {
    first_arrival: Timestamp,
    bytes: u64,
}

/// Opcode, length and header of a message record.
const MESSAGE_RECORD_BYTES: u64 = 31;
/// Schema and channel record without the schema's text, generously.
const DEFINITION_RECORDS_BYTES: u64 = 256;
/// Spacing of the intrinsics beside the images.
const CAMERA_INFO_SECS: f64 = 1.0;
/// Stamps of ROS messages are `int32` seconds.
const MAX_STAMP_NANOS: i64 = (i32::MAX as i64) * 1_000_000_000;

/// Writes a recording. Chunks are closed after [`WriterConfig::chunk_secs`], so that a file without its end still opens
/// up to the last of them.
///
/// After a failed write the writer stays failed: each further call returns [`Error::WriterFailed`] with the first cause,
/// and nothing more reaches the file, which is cut back to its last whole chunk.
pub struct Writer {
    path: PathBuf,
    config: WriterConfig,
    encoder: mcap::Writer<Sink>,
    state: SharedState,
    channels: BTreeMap<String, OpenChannel>,
    chunk: Option<OpenChunk>,
    rig: Option<Rig>,
    static_transforms: Vec<StaticTransform>,
    camera_info_times: BTreeMap<String, Timestamp>,
}

impl Writer {
    /// Creates the file, replacing one of the same name.
    pub fn create(path: &Path, config: &WriterConfig) -> Result<Self, Error> {
        let io = |source| Error::Io {
            path: path.to_owned(),
            action: "create the recording",
            source,
        };
        let sink = Sink::new(File::create(path).map_err(io)?, config.durability);
        let state = sink.state();
        let encoder = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("lsfb-recording ", env!("CARGO_PKG_VERSION")))
            .compression(match config.compression {
                Compression::None => None,
                Compression::Lz4 => Some(mcap::Compression::Lz4),
                Compression::Zstd => Some(mcap::Compression::Zstd),
            })
            // Bytes must not depend on the number of cores.
            .compression_threads(0)
            // Chunks are closed here, by size and by time.
            .chunk_size(None)
            // A chunk is written in one piece: no header on the disk ever waits for its length.
            .disable_seeking(true)
            .create(sink)
            .map_err(|e| io(std::io::Error::other(e)))?;
        let mut writer = Self {
            path: path.to_owned(),
            config: config.clone(),
            encoder,
            state,
            channels: BTreeMap::new(),
            chunk: None,
            rig: None,
            static_transforms: Vec::new(),
            camera_info_times: BTreeMap::new(),
        };
        let mut session = config.session.clone();
        session.insert(
            "software".into(),
            concat!("lsfb ", env!("CARGO_PKG_VERSION")).into(),
        );
        writer.write_metadata("lsfb.session", session)?;
        Ok(writer)
    }

    /// Writes a grey image on `/<camera>/image` and what the device says about it on `/<camera>/frame_meta`.
    pub fn write_image(&mut self, camera: &str, image: &Stamped<Image>) -> Result<(), Error> {
        self.write_image_with_trailer(camera, image, &[])
    }

    /// [`Writer::write_image`] of a device that appends bytes of its own to each frame; they are kept as received.
    pub fn write_image_with_trailer(
        &mut self,
        camera: &str,
        image: &Stamped<Image>,
        trailer: &[u8],
    ) -> Result<(), Error> {
        let topic = topic::image(camera);
        let Image {
            width,
            height,
            ref pixels,
            exposure_ns,
            frame_id,
        } = image.sample;
        if u64::from(width) * u64::from(height) != pixels.len() as u64 {
            return Err(self.unwritable(
                &topic,
                format!("{} pixels in a {width}×{height} image", pixels.len()),
            ));
        }
        let meta = FrameMeta {
            frame_id,
            device_ticks: image.device_ticks,
            exposure_ns,
            trailer: trailer.to_owned(),
        };
        let meta = message::encode_frame_meta(image.time, camera, &meta);
        let meta_topic = topic::frame_meta(&topic);
        let bytes = message::encode_image(image.time, camera, &image.sample);
        // Readers meet the meta before its image, in the same chunk.
        self.write_together(
            image.time,
            image.arrival,
            &[
                Outgoing::new(&meta_topic, message::FRAME_META, &meta),
                Outgoing::new(&topic, message::IMAGE, &bytes),
            ],
        )
    }

    /// Writes an inertial sample on `/<imu>/data_raw`, and the device's counter, where there is one, on `/<imu>/time_ref`.
    pub fn write_imu(&mut self, imu: &str, sample: &Stamped<ImuSample>) -> Result<(), Error> {
        let topic = topic::imu(imu);
        let bytes = message::encode_imu(sample.time, imu, &sample.sample);
        self.write_with_ticks(
            &topic,
            &topic::imu_time_ref(&topic),
            imu,
            sample,
            message::IMU,
            &bytes,
        )
    }

    /// Writes a scan on `/lidar/points`.
    pub fn write_scan(&mut self, scan: &Stamped<LidarScan>) -> Result<(), Error> {
        let bytes = message::encode_points(scan.time, topic::LIDAR_FRAME, &scan.sample);
        self.write_with_ticks(
            topic::LIDAR_POINTS,
            topic::LIDAR_TIME_REF,
            topic::LIDAR_FRAME,
            scan,
            message::POINT_CLOUD,
            &bytes,
        )
    }

    /// Writes the data packets of one revolution on `/lidar/packets`; `time` is the synchronized time of the first.
    /// Nothing is written for an empty slice.
    pub fn write_velodyne_packets(
        &mut self,
        time: Timestamp,
        packets: &[Packet],
    ) -> Result<(), Error> {
        let Some(last) = packets.last() else {
            return Ok(());
        };
        let Some(bytes) = message::encode_velodyne_scan(time, topic::LIDAR_FRAME, packets) else {
            let reason = format!(
                "a data packet has not {} bytes",
                message::VELODYNE_PACKET_BYTES
            );
            return Err(self.unwritable(topic::LIDAR_PACKETS, reason));
        };
        let message = Outgoing::new(topic::LIDAR_PACKETS, message::VELODYNE_SCAN, &bytes);
        self.write_together(time, last.arrival, &[message])
    }

    /// Writes bytes exactly as received on `/raw/<source>` (`/lidar/position` for [`LIDAR_POSITION`](crate::LIDAR_POSITION)).
    /// `sequence` counts what the source sent, gaps included; `time` is the synchronized time, the arrival where unknown.
    pub fn write_raw(
        &mut self,
        source: &str,
        kind: u16,
        sequence: u64,
        packet: &Packet,
        time: Timestamp,
    ) -> Result<(), Error> {
        let raw = RawPacket {
            source: source.to_owned(),
            kind,
            sequence,
            bytes: packet.bytes.clone(),
        };
        let bytes = message::encode_raw_packet(time, source, &raw);
        let topic = topic::raw(source);
        self.write_together(
            time,
            packet.arrival,
            &[Outgoing::new(&topic, message::RAW_PACKET, &bytes)],
        )
    }

    /// Writes a message that is CDR already: what a sidecar sends goes into the recording as it came.
    pub fn write_cdr(
        &mut self,
        channel: &Channel<'_>,
        time: Timestamp,
        arrival: Timestamp,
        bytes: &[u8],
    ) -> Result<(), Error> {
        let message = Outgoing {
            topic: channel.topic,
            schema_name: channel.schema_name,
            schema_text: channel.schema_text,
            bytes,
        };
        self.write_together(time, arrival, &[message])
    }

    /// Attaches a file.
    pub fn attach(&mut self, name: &str, media_type: &str, bytes: &[u8]) -> Result<(), Error> {
        self.check()?;
        self.close_chunk()?;
        let attachment = mcap::Attachment {
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(bytes),
        };
        let result = self.encoder.attach(&attachment);
        self.encoded(name, result)?;
        self.flush()
    }

    /// Attaches the rig as `rig.toml`. Its frames follow on `/tf_static` with the first message, and its intrinsics on
    /// `camera_info` beside the images, once a second, so that viewers place everything.
    pub fn attach_rig(&mut self, rig: &Rig) -> Result<(), Error> {
        self.attach("rig.toml", "application/toml", rig.to_toml().as_bytes())?;
        let edge = |child: &str, rig_from_child: Se3| StaticTransform {
            parent: topic::RIG_FRAME.to_owned(),
            child: child.to_owned(),
            parent_from_child: rig_from_child,
        };
        self.static_transforms = rig
            .cameras
            .iter()
            .map(|(name, camera)| edge(name, camera.rig_from_camera))
            .collect();
        self.static_transforms.extend(
            rig.lidar
                .iter()
                .map(|l| edge(topic::LIDAR_FRAME, l.rig_from_lidar)),
        );
        self.static_transforms
            .extend(rig.imu.iter().map(|_| edge("imu0", Se3::identity())));
        self.rig = Some(rig.clone());
        Ok(())
    }

    /// Adds a metadata record: names and values that belong to the whole recording.
    pub fn write_metadata(
        &mut self,
        name: &str,
        entries: BTreeMap<String, String>,
    ) -> Result<(), Error> {
        self.check()?;
        self.close_chunk()?;
        let result = self.encoder.write_metadata(&Metadata {
            name: name.to_owned(),
            metadata: entries,
        });
        self.encoded(name, result)?;
        self.flush()
    }

    /// Closes the current chunk, so that everything up to here survives. The writer does so by itself once a second of
    /// recording; call this when the devices fall silent.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.check()?;
        self.chunk = None;
        let result = self.encoder.flush();
        self.encoded("chunk", result)
    }

    /// Writes index and end, and closes the file.
    pub fn finish(mut self) -> Result<Summary, Error> {
        self.flush()?;
        self.state.lock().held = Some(Vec::new());
        let result = self.encoder.finish();
        self.encoded("summary", result)?;
        let messages = self.channels.values().map(|c| c.messages).sum();
        let topics = self
            .channels
            .iter()
            .map(|(topic, channel)| TopicSummary {
                topic: topic.clone(),
                schema: channel.schema.clone(),
                messages: channel.messages,
            })
            .collect();
        let mut sink = self.encoder.into_inner();
        let end = summary::in_fixed_order(&sink.release());
        let written = sink.write_all(&end).and_then(|()| sink.flush());
        let state = self.state.lock();
        if let Some(cause) = state
            .failure
            .clone()
            .or(written.err().map(|e| e.to_string()))
        {
            return Err(Error::WriterFailed {
                path: self.path,
                intact_bytes: state.intact_bytes,
                cause,
            });
        }
        Ok(Summary {
            bytes: state.intact_bytes,
            path: self.path.clone(),
            messages,
            topics,
        })
    }

    fn write_with_ticks<T>(
        &mut self,
        topic: &str,
        time_ref_topic: &str,
        frame: &str,
        sample: &Stamped<T>,
        schema: message::Schema,
        bytes: &[u8],
    ) -> Result<(), Error> {
        let message = Outgoing::new(topic, schema, bytes);
        if sample.device_ticks == 0 {
            return self.write_together(sample.time, sample.arrival, &[message]);
        }
        let reference = TimeReference {
            device_ticks: sample.device_ticks,
            source: frame.to_owned(),
        };
        let Some(ticks) = message::encode_time_reference(sample.time, frame, &reference) else {
            return Err(self.unwritable(
                topic,
                format!("device ticks {} are out of range", sample.device_ticks),
            ));
        };
        let ticks = Outgoing::new(time_ref_topic, message::TIME_REFERENCE, &ticks);
        self.write_together(sample.time, sample.arrival, &[ticks, message])
    }

    /// Writes messages of one instant into one chunk, preceded by what the rig says about them.
    fn write_together(
        &mut self,
        time: Timestamp,
        arrival: Timestamp,
        messages: &[Outgoing<'_>],
    ) -> Result<(), Error> {
        self.check()?;
        for stamp in [time, arrival] {
            if !(0..=MAX_STAMP_NANOS).contains(&stamp.nanos()) {
                let topic = messages.first().map_or("", |m| m.topic);
                let reason =
                    format!("time {stamp} s is outside 1970 … 2038; check the device's clock");
                return Err(self.unwritable(topic, reason));
            }
        }
        let bytes = messages.iter().map(|m| self.bytes_in_chunk(m)).sum();
        self.make_room(arrival, bytes)?;
        if !self.static_transforms.is_empty() {
            let transforms = std::mem::take(&mut self.static_transforms);
            let bytes = message::encode_static_transforms(time, &transforms);
            self.put(
                time,
                arrival,
                &Outgoing::new(topic::TF_STATIC, message::TF_MESSAGE, &bytes),
            )?;
        }
        for message in messages {
            if message.schema_name == message::IMAGE.name {
                self.put_camera_info(time, arrival, message.topic)?;
            }
            self.put(time, arrival, message)?;
        }
        Ok(())
    }

    fn put_camera_info(
        &mut self,
        time: Timestamp,
        arrival: Timestamp,
        image_topic: &str,
    ) -> Result<(), Error> {
        let rig_camera = || {
            let name = topic::camera_of(image_topic)?;
            Some((name, self.rig.as_ref()?.cameras.get(name)?))
        };
        let Some((name, rig_camera)) = rig_camera() else {
            return Ok(());
        };
        let info_topic = topic::camera_info(image_topic);
        let last = self.camera_info_times.get(&info_topic);
        if last.is_some_and(|last| time.secs_since(*last).abs() < CAMERA_INFO_SECS) {
            return Ok(());
        }
        let bytes = message::encode_camera_info(time, name, &rig_camera.camera);
        self.put(
            time,
            arrival,
            &Outgoing::new(&info_topic, message::CAMERA_INFO, &bytes),
        )?;
        self.camera_info_times.insert(info_topic, time);
        Ok(())
    }

    /// Closes the chunk where `bytes` more at `arrival` would make it too large or too long.
    fn make_room(&mut self, arrival: Timestamp, bytes: u64) -> Result<(), Error> {
        let full = self.chunk.as_ref().is_some_and(|chunk| {
            chunk.bytes + bytes > self.config.chunk_bytes
                || arrival.secs_since(chunk.first_arrival).abs() >= self.config.chunk_secs
        });
        if full {
            self.flush()?;
        }
        let chunk = self.chunk.get_or_insert(OpenChunk {
            first_arrival: arrival,
            bytes: 0,
        });
        chunk.bytes += bytes;
        Ok(())
    }

    /// What a message adds to its chunk, with the definition of its topic where it is the first.
    fn bytes_in_chunk(&self, message: &Outgoing<'_>) -> u64 {
        let definition = match self.channels.contains_key(message.topic) {
            true => 0,
            false => message.schema_text.len() as u64 + DEFINITION_RECORDS_BYTES,
        };
        message.bytes.len() as u64 + MESSAGE_RECORD_BYTES + definition
    }

    fn put(
        &mut self,
        time: Timestamp,
        arrival: Timestamp,
        message: &Outgoing<'_>,
    ) -> Result<(), Error> {
        let id = self.channel_id(message)?;
        let channel = self.channels.get_mut(message.topic);
        let sequence = channel.map_or(0, |c| {
            c.messages += 1;
            c.messages as u32
        });
        let header = MessageHeader {
            channel_id: id,
            sequence,
            log_time: arrival.nanos() as u64,
            publish_time: time.nanos() as u64,
        };
        let result = self.encoder.write_to_known_channel(&header, message.bytes);
        self.encoded(message.topic, result)
    }

    fn channel_id(&mut self, message: &Outgoing<'_>) -> Result<u16, Error> {
        if let Some(channel) = self.channels.get(message.topic) {
            if channel.schema != message.schema_name {
                let reason = format!(
                    "carries {} and cannot take {}",
                    channel.schema, message.schema_name
                );
                return Err(self.unwritable(message.topic, reason));
            }
            return Ok(channel.id);
        }
        let mut metadata = BTreeMap::new();
        if message.topic == topic::TF_STATIC {
            metadata.insert(
                "offered_qos_profiles".to_owned(),
                summary::TRANSIENT_LOCAL.to_owned(),
            );
        }
        let result = self
            .encoder
            .add_schema(
                message.schema_name,
                "ros2msg",
                message.schema_text.as_bytes(),
            )
            .and_then(|schema| {
                self.encoder
                    .add_channel(schema, message.topic, "cdr", &metadata)
            });
        let id = match result {
            Ok(id) => id,
            Err(error) => return Err(self.unwritable(message.topic, error.to_string())),
        };
        self.channels.insert(
            message.topic.to_owned(),
            OpenChannel {
                id,
                schema: message.schema_name.to_owned(),
                messages: 0,
            },
        );
        Ok(id)
    }

    fn close_chunk(&mut self) -> Result<(), Error> {
        match self.chunk {
            Some(_) => self.flush(),
            None => Ok(()),
        }
    }

    /// Turns what the encoder says, and what the file said meanwhile, into our error.
    fn encoded<T>(&mut self, what: &str, result: mcap::McapResult<T>) -> Result<(), Error> {
        if let Err(error) = result {
            let mut state = self.state.lock();
            state
                .failure
                .get_or_insert_with(|| format!("cannot encode {what}: {error}"));
        }
        self.check()
    }

    fn check(&self) -> Result<(), Error> {
        let state = self.state.lock();
        match &state.failure {
            None => Ok(()),
            Some(cause) => Err(Error::WriterFailed {
                path: self.path.clone(),
                intact_bytes: state.intact_bytes,
                cause: cause.clone(),
            }),
        }
    }

    fn unwritable(&self, topic: &str, reason: String) -> Error {
        Error::Unwritable {
            path: self.path.clone(),
            topic: topic.to_owned(),
            reason,
        }
    }
}
