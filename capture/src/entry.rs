//! What the devices hand to the thread that writes.

use lsfb_geometry::Rig;
use lsfb_recording::message::{self, Schema};
use lsfb_recording::{Attachment, LAST_STAMP};
use lsfb_types::{Image, ImuSample, LidarScan, Packet, Stamped, Timestamp};

use crate::device_note::DeviceNote;
use crate::receipt::Receipt;
use crate::report::StreamReport;
use crate::sync::Group;

/// What a queued entry takes beside its payload.
const ENTRY_BYTES: u64 = 256;
/// Bytes of a point in memory.
const POINT_BYTES: u64 = 24;

/// One thing to be recorded.
pub(crate) enum Entry {
    /// An image and the trailer it came with.
    Image {
        camera: String,
        image: Stamped<Image>,
        trailer: Vec<u8>,
    },
    /// An inertial sample.
    Imu {
        imu: String,
        sample: Stamped<ImuSample>,
    },
    /// A revolution: its packets as received, and the points.
    Scan {
        lidar: String,
        scan: Stamped<LidarScan>,
        packets: Vec<Packet>,
    },
    /// Packets that completed no scan.
    Packets {
        lidar: String,
        time: Timestamp,
        packets: Vec<Packet>,
    },
    /// Bytes as received.
    Raw {
        source: String,
        /// The driver's numbering of its traffic.
        kind: u16,
        sequence: u64,
        packet: Packet,
        time: Timestamp,
    },
    /// A ready-made message of a sidecar.
    Cdr {
        topic: String,
        schema_name: String,
        schema_text: String,
        time: Timestamp,
        arrival: Timestamp,
        bytes: Vec<u8>,
        /// Given back when the message is in the file.
        receipt: Option<Receipt>,
    },
    /// A file for this part and all that follow.
    Attachment(Attachment),
    /// The rig's poses follow in this part and all that come after it.
    OdometryFollows,
    /// What a device turned out to be, for this part and all that follow.
    Device(DeviceNote),
    /// The rig of a device that brings its own.
    Rig { owner: String, rig: Box<Rig> },
    /// What the recorder says itself.
    Own(OwnMessage),
    /// How a device's clock is read; repeated at the start of each part.
    ClockModel { device: String, message: OwnMessage },
    /// What became of the devices: the last entry.
    Ended(Vec<StreamReport>),
}

impl Entry {
    /// Memory it holds, about.
    pub(crate) fn bytes(&self) -> u64 {
        let payload = match self {
            Self::Image { image, trailer, .. } => image.sample.pixels.len() + trailer.len(),
            Self::Scan { scan, packets, .. } => {
                return ENTRY_BYTES
                    + packets.iter().map(packet_bytes).sum::<u64>()
                    + scan.sample.points.len() as u64 * POINT_BYTES;
            }
            Self::Packets { packets, .. } => {
                return ENTRY_BYTES + packets.iter().map(packet_bytes).sum::<u64>();
            }
            Self::Raw { packet, .. } => packet.bytes.len(),
            Self::Cdr { bytes, .. } => bytes.len(),
            Self::Attachment(attachment) => attachment.bytes.len(),
            Self::Own(message) | Self::ClockModel { message, .. } => message.bytes.len(),
            Self::Imu { .. }
            | Self::OdometryFollows
            | Self::Device(_)
            | Self::Rig { .. }
            | Self::Ended(_) => 0,
        };
        payload as u64 + ENTRY_BYTES
    }
}

/// Stamps of an entry that may be those of a device.
struct Stamps<'a> {
    time: &'a mut Timestamp,
    arrival: Timestamp,
}

impl Entry {
    fn stamps(&mut self) -> Option<Stamps<'_>> {
        let (time, arrival) = match self {
            Self::Image { image, .. } => (&mut image.time, image.arrival),
            Self::Imu { sample, .. } => (&mut sample.time, sample.arrival),
            Self::Scan { scan, .. } => (&mut scan.time, scan.arrival),
            Self::Raw { time, packet, .. } => (time, packet.arrival),
            Self::Cdr { time, arrival, .. } => (time, *arrival),
            Self::Own(message) | Self::ClockModel { message, .. } => {
                (&mut message.time, message.arrival)
            }
            Self::Packets { .. }
            | Self::Attachment(_)
            | Self::OdometryFollows
            | Self::Device(_)
            | Self::Rig { .. }
            | Self::Ended(_) => return None,
        };
        Some(Stamps { time, arrival })
    }

    /// Gives a time that no recording can hold up for that of arrival: one device that names an impossible year must not
    /// end the recording of all. The time that was given up.
    pub(crate) fn give_up_impossible_time(&mut self) -> Option<Timestamp> {
        let can_be_written = |time: Timestamp| (Timestamp::default()..=LAST_STAMP).contains(&time);
        let Stamps { time, arrival } = self.stamps()?;
        if can_be_written(*time) || !can_be_written(arrival) {
            return None;
        }
        Some(std::mem::replace(time, arrival))
    }
}

fn packet_bytes(packet: &Packet) -> u64 {
    packet.bytes.len() as u64 + 32
}

/// A message of the recorder's own.
#[derive(Clone, Debug)]
pub(crate) struct OwnMessage {
    pub(crate) topic: String,
    pub(crate) schema: Schema,
    pub(crate) time: Timestamp,
    pub(crate) arrival: Timestamp,
    pub(crate) bytes: Vec<u8>,
}

impl OwnMessage {
    pub(crate) fn camera_group(group: &Group) -> Self {
        let content = message::CameraGroup {
            trigger: group.trigger,
            expected: group.expected,
            present: group.present,
            missing: group.missing.join(" "),
        };
        Self {
            topic: lsfb_recording::CAMERA_GROUPS.to_owned(),
            schema: message::CAMERA_GROUP,
            time: group.time,
            arrival: group.arrival,
            bytes: message::encode_camera_group(group.time, "rig", &content),
        }
    }
}
