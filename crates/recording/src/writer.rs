use std::collections::BTreeMap;
use std::path::Path;

use lsfb_geometry::{Rig, Se3};
use lsfb_types::{Image, ImuSample, LidarScan, Packet, Stamped, Timestamp};

use crate::calibration::{RIG_ATTACHMENT, rig_metadata};
use crate::container::encoder::Encoder;
use crate::container::open_chunk::Outgoing;
use crate::error::Error;
use crate::interval::SampleInterval;
use crate::layout::{Channel, Summary, WriterConfig};
use crate::message::{self, FrameMeta, ImuVariance, RawPacket, StaticTransform, TimeReference};
use crate::topic;

/// Writes a recording. Chunks are closed after [`WriterConfig::chunk_secs`], so that a file without its end still opens
/// up to the last of them.
///
/// After a failed write the writer stays failed: each further call returns [`Error::WriterFailed`] with the first cause,
/// and nothing more reaches the file, which is cut back to its last whole chunk.
pub struct Writer {
    encoder: Encoder,
    rig: Option<Rig>,
    /// Rigs of sidecars by the device in their topics.
    sidecars: BTreeMap<String, Rig>,
    static_transforms: Vec<StaticTransform>,
    /// The frame that hangs on the root of Rerun's.
    outermost_frame: &'static str,
    imu_intervals: BTreeMap<String, SampleInterval>,
}

impl Writer {
    /// Creates the file; [`WriterConfig::existing`] says what happens to one of the same name.
    pub fn create(path: &Path, config: &WriterConfig) -> Result<Self, Error> {
        let mut encoder = Encoder::create(path, config)?;
        let mut session = config.session.clone();
        session.insert(
            "software".into(),
            concat!("lsfb ", env!("CARGO_PKG_VERSION")).into(),
        );
        encoder.write_metadata("lsfb.session", &session)?;
        Ok(Self {
            encoder,
            rig: None,
            sidecars: BTreeMap::new(),
            static_transforms: Vec::new(),
            outermost_frame: topic::RIG_FRAME,
            imu_intervals: BTreeMap::new(),
        })
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
            return Err(self.encoder.unwritable(
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
        let head = message::encode_image_head(image.time, camera, &image.sample);
        // Readers meet the meta before its image, in the same chunk.
        self.write_together(
            image.time,
            image.arrival,
            &[
                Outgoing::new(&meta_topic, message::FRAME_META, &meta),
                Outgoing {
                    tail: pixels,
                    ..Outgoing::new(&topic, message::IMAGE, &head)
                },
            ],
        )
    }

    /// Writes an inertial sample on `/<imu>/data_raw`, and the device's counter, where there is one, on `/<imu>/time_ref`. Its
    /// covariances are those of the rig's noise densities at the rate of the samples; zeros, which mean unknown, without a rig
    /// and for the first sample.
    pub fn write_imu(&mut self, imu: &str, sample: &Stamped<ImuSample>) -> Result<(), Error> {
        let topic = topic::imu(imu);
        let variance = self.imu_variance(imu, sample.time);
        let bytes = message::encode_imu(sample.time, imu, &sample.sample, variance);
        self.write_with_ticks(
            &topic,
            &topic::imu_time_ref(&topic),
            imu,
            sample,
            message::IMU,
            &bytes,
        )
    }

    fn imu_variance(&mut self, imu: &str, time: Timestamp) -> ImuVariance {
        let noise = self.rig.as_ref().and_then(|rig| rig.imus.get(imu));
        let interval = self.imu_intervals.entry(imu.to_owned()).or_default();
        match (noise, interval.secs(time)) {
            (Some(imu), Some(interval_s)) => ImuVariance {
                angular_velocity_rad2_s2: imu.noise.gyro_noise_density.powi(2) / interval_s,
                specific_force_m2_s4: imu.noise.accel_noise_density.powi(2) / interval_s,
            },
            _ => ImuVariance::UNKNOWN,
        }
    }

    /// Writes a scan on `/<lidar>/points`.
    pub fn write_scan(&mut self, lidar: &str, scan: &Stamped<LidarScan>) -> Result<(), Error> {
        let bytes = message::encode_points(scan.time, lidar, &scan.sample);
        self.write_with_ticks(
            &topic::lidar_points(lidar),
            &topic::lidar_time_ref(lidar),
            lidar,
            scan,
            message::POINT_CLOUD,
            &bytes,
        )
    }

    /// Writes the data packets of one revolution on `/<lidar>/packets`; `time` is the synchronized time of the first.
    /// Nothing is written for an empty slice.
    pub fn write_lidar_packets(
        &mut self,
        lidar: &str,
        time: Timestamp,
        packets: &[Packet],
    ) -> Result<(), Error> {
        let Some(last) = packets.last() else {
            return Ok(());
        };
        let bytes = message::encode_lidar_packets(time, lidar, packets);
        let topic = topic::lidar_packets(lidar);
        let message = Outgoing::new(&topic, message::LIDAR_PACKETS, &bytes);
        self.write_together(time, last.arrival, &[message])
    }

    /// Writes bytes exactly as received on `/raw/<source>` (`/<lidar>/position` for [`lidar_position`](crate::lidar_position)).
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

    /// Writes a message that is CDR already. What a sidecar sends goes into the recording as it came but for the name of its frame:
    /// `imu` of the device `glasses` becomes `glasses/imu`, as other devices have an `imu` too.
    pub fn write_cdr(
        &mut self,
        channel: &Channel<'_>,
        time: Timestamp,
        arrival: Timestamp,
        bytes: &[u8],
    ) -> Result<(), Error> {
        let reframed = topic::sidecar_of(channel.topic)
            .and_then(|device| message::in_frame_of(device, channel.schema_name, bytes));
        let (bytes, tail) = match &reframed {
            Some(message) => (message.head.as_slice(), message.rest),
            None => (bytes, [].as_slice()),
        };
        let message = Outgoing {
            topic: channel.topic,
            schema_name: channel.schema_name,
            schema_text: channel.schema_text,
            bytes,
            tail,
        };
        self.write_together(time, arrival, &[message])
    }

    /// Attaches a file.
    pub fn attach(&mut self, name: &str, media_type: &str, bytes: &[u8]) -> Result<(), Error> {
        self.encoder.attach(name, media_type, bytes)
    }

    /// Attaches the rig as `rig.toml`, and says its hash and age in metadata. Its frames follow on `/tf_static` with the first
    /// message, and its intrinsics on `camera_info` with every image, so that viewers place everything and ROS's
    /// synchronizers pair the two.
    pub fn attach_rig(&mut self, rig: &Rig) -> Result<(), Error> {
        let text = rig.to_toml();
        self.attach(RIG_ATTACHMENT, "application/toml", text.as_bytes())?;
        let (name, entries) = rig_metadata(rig);
        self.encoder.write_metadata(name, &entries)?;
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
        let lidars = rig.lidars.iter();
        self.static_transforms
            .extend(lidars.map(|(name, lidar)| edge(name, lidar.rig_from_lidar)));
        let imus = rig.imus.iter();
        self.static_transforms
            .extend(imus.map(|(name, imu)| edge(name, imu.rig_from_imu)));
        self.rig = Some(rig.clone());
        Ok(())
    }

    /// Says that the rig's poses in the odometry's frame follow on `/tf`: a frame has one parent, so that viewers are to begin at that
    /// frame. To be called before the first message.
    pub fn expect_odometry(&mut self) {
        self.outermost_frame = topic::ODOM_FRAME;
    }

    /// Says where the sensors of a sidecar are and what its lenses do: frames and intrinsics of the messages on `/sidecar/<device>/…`.
    /// Its frames hang on `<device>/rig`, which nobody places, or on the recording's own where the two are one.
    pub fn place_sidecar(&mut self, device: &str, rig: &Rig) {
        let parent = match &self.rig {
            Some(own) if own == rig => topic::RIG_FRAME.to_owned(),
            _ => message::frame_of(device, topic::RIG_FRAME),
        };
        let edge = |child: &str, parent_from_child: Se3| StaticTransform {
            parent: parent.clone(),
            child: message::frame_of(device, child),
            parent_from_child,
        };
        let cameras = rig.cameras.iter();
        let cameras = cameras.map(|(name, camera)| edge(name, camera.rig_from_camera));
        let imus = rig.imus.iter();
        let imus = imus.map(|(name, imu)| edge(name, imu.rig_from_imu));
        self.static_transforms.extend(cameras.chain(imus));
        self.sidecars.insert(device.to_owned(), rig.clone());
    }

    /// Adds a metadata record: names and values that belong to the whole recording.
    pub fn write_metadata(
        &mut self,
        name: &str,
        entries: BTreeMap<String, String>,
    ) -> Result<(), Error> {
        self.encoder.write_metadata(name, &entries)
    }

    /// Closes the current chunk, so that everything up to here survives. The writer does so by itself once a second of
    /// recording; call this when the devices fall silent.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.encoder.flush()
    }

    /// Size of what is in the file; the open chunk is not.
    pub fn bytes(&self) -> u64 {
        self.encoder.bytes()
    }

    /// Messages in the open chunk: what is lost if the next write fails.
    pub fn open_messages(&self) -> u64 {
        self.encoder.open_messages()
    }

    /// Another handle on the file, for a thread of the caller that brings to the disk what the operating system holds.
    pub fn file(&self) -> std::io::Result<std::fs::File> {
        self.encoder.file()
    }

    /// Closes a recording whose disk took nothing more: index and end behind the last whole chunk.
    pub fn salvage(self) -> Result<Summary, Error> {
        self.encoder.salvage()
    }

    /// Writes index and end, and closes the file.
    pub fn finish(self) -> Result<Summary, Error> {
        self.encoder.finish()
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
            return Err(self.encoder.unwritable(
                topic,
                format!("device ticks {} are out of range", sample.device_ticks),
            ));
        };
        let ticks = Outgoing::new(time_ref_topic, message::TIME_REFERENCE, &ticks);
        self.write_together(sample.time, sample.arrival, &[ticks, message])
    }

    /// Writes messages of one instant into one chunk, an image preceded by its camera's intrinsics.
    fn write_together(
        &mut self,
        time: Timestamp,
        arrival: Timestamp,
        messages: &[Outgoing<'_>],
    ) -> Result<(), Error> {
        let image = messages
            .iter()
            .find(|message| message.schema_name == message::IMAGE.name);
        let Some((topic, info)) = image.and_then(|image| self.camera_info(time, image.topic))
        else {
            return self.write_in_one_chunk(time, arrival, messages);
        };
        let mut all = vec![Outgoing::new(&topic, message::CAMERA_INFO, &info)];
        all.extend_from_slice(messages);
        self.write_in_one_chunk(time, arrival, &all)
    }

    fn write_in_one_chunk(
        &mut self,
        time: Timestamp,
        arrival: Timestamp,
        messages: &[Outgoing<'_>],
    ) -> Result<(), Error> {
        self.encoder.begin(time, arrival, messages)?;
        if !self.static_transforms.is_empty() {
            let transforms = std::mem::take(&mut self.static_transforms);
            let root = StaticTransform {
                parent: topic::RERUN_ROOT_FRAME.to_owned(),
                child: self.outermost_frame.to_owned(),
                parent_from_child: Se3::identity(),
            };
            let bytes = message::encode_static_transforms(time, &[root]);
            self.encoder.put(
                time,
                arrival,
                &Outgoing::new(topic::RERUN_TF_STATIC, message::TF_MESSAGE, &bytes),
            )?;
            let bytes = message::encode_static_transforms(time, &transforms);
            self.encoder.put(
                time,
                arrival,
                &Outgoing::new(topic::TF_STATIC, message::TF_MESSAGE, &bytes),
            )?;
        }
        for message in messages {
            self.encoder.put(time, arrival, message)?;
        }
        Ok(())
    }

    /// Topic and bytes of the intrinsics of the camera of an image topic, where the rig has it.
    fn camera_info(&self, time: Timestamp, image_topic: &str) -> Option<(String, Vec<u8>)> {
        let name = topic::camera_of(image_topic)?;
        let (rig, frame) = match topic::sidecar_of(image_topic) {
            Some(device) => (self.sidecars.get(device)?, message::frame_of(device, name)),
            None => (self.rig.as_ref()?, name.to_owned()),
        };
        let mounted = rig.cameras.get(name)?;
        let bytes = message::encode_camera_info(time, &frame, &mounted.camera);
        Some((topic::camera_info(image_topic), bytes))
    }
}
