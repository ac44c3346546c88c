//! What a record says, and how it lies in the recording.

use std::path::PathBuf;

use lsfb_geometry::Se3;
use lsfb_recording::message::{
    self, BleAdvert, GnssReading, ImuVariance, MagneticSample, Remark, Schema, WifiReading,
    WifiScan,
};
use lsfb_types::{ImuSample, Timestamp};

use super::vrs::ImageAt;

/// What a stream is filled with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Imu,
    Vector,
    Magnetic,
    Orientation,
    Image,
    Cloud,
    Pose,
    Gnss,
    Wifi,
    WifiScan,
    Ble,
    Waypoint,
}

impl Kind {
    /// Longest time between two records that such a sensor has, and the shortest, seconds; `None` for what comes when there is
    /// something to hear.
    pub(super) fn periods_s(self) -> Option<[f64; 2]> {
        match self {
            Self::Imu | Self::Vector | Self::Magnetic | Self::Orientation => Some([2.0, 2e-5]),
            Self::Image | Self::Cloud | Self::Pose => Some([60.0, 5e-4]),
            Self::Gnss | Self::Wifi | Self::WifiScan | Self::Ble | Self::Waypoint => None,
        }
    }

    /// The message type it becomes.
    pub(super) fn schema(self) -> Schema {
        match self {
            Self::Imu => message::IMU,
            Self::Vector => message::VECTOR,
            Self::Magnetic => message::MAGNETIC_FIELD,
            Self::Orientation => message::ORIENTATION,
            Self::Image => message::IMAGE,
            Self::Cloud => message::POINT_CLOUD,
            Self::Pose => message::POSE,
            Self::Gnss => message::NAV_SAT_FIX,
            Self::Wifi => message::WIFI_READING,
            Self::WifiScan => message::WIFI_SCAN,
            Self::Ble => message::BLE_ADVERT,
            Self::Waypoint => message::REMARK,
        }
    }
}

/// One record.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Payload {
    Imu(ImuSample),
    /// rad/s, m/s².
    Vector([f64; 3]),
    /// Tesla.
    Magnetic([f64; 3]),
    /// x y z w.
    Orientation([f64; 4]),
    Image(Box<ImageRecord>),
    Cloud(PathBuf),
    Pose(Box<Se3>),
    Gnss(Box<GnssReading>),
    Wifi(Box<WifiReading>),
    WifiScan(WifiScan),
    Ble(Box<BleAdvert>),
    Waypoint(Box<Remark>),
}

/// An image that is decoded when it is written.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ImageRecord {
    pub(super) pixels: Pixels,
    /// 0 where unknown.
    pub(super) exposure_ns: u32,
    /// The device's own stamp of it, nanoseconds, where another instant of the exposure is recorded; 0 where not.
    pub(super) device_ns: u64,
    pub(super) frame_id: u32,
}

/// Where the pixels of an image are.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Pixels {
    File(PathBuf),
    /// The frame of a video: which one, and the frame's number from 0.
    Frame {
        video: usize,
        number: u32,
    },
    /// Within a record of a VRS file.
    Record(Box<ImageAt>),
}

impl Payload {
    /// Its bytes in the recording, in a frame of reference; `None` for what is read when it is written.
    pub(super) fn encode(&self, time: Timestamp, frame: &str) -> Option<Vec<u8>> {
        Some(match self {
            Self::Imu(sample) => message::encode_imu(time, frame, sample, ImuVariance::UNKNOWN),
            Self::Vector(vector) => message::encode_vector(time, frame, vector),
            Self::Magnetic(field_t) => {
                let sample = MagneticSample {
                    field_t: *field_t,
                    variance_t2: [0.0; 3],
                };
                message::encode_magnetic(time, frame, &sample)
            }
            Self::Orientation(xyzw) => message::encode_orientation(time, frame, xyzw),
            Self::Pose(pose) => message::encode_pose(time, frame, pose),
            Self::Gnss(reading) => message::encode_gnss(time, frame, reading),
            Self::Wifi(reading) => message::encode_wifi(time, frame, reading),
            Self::WifiScan(scan) => message::encode_wifi_scan(time, frame, scan),
            Self::Ble(advert) => message::encode_ble(time, frame, advert),
            Self::Waypoint(remark) => message::encode_remark(time, remark),
            Self::Image(_) | Self::Cloud(_) => return None,
        })
    }
}
