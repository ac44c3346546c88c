//! A unit of cameras: where it is, what it must be, how it exposes.

use std::path::PathBuf;

use lsfb_drivers::mynt_s::{self, CameraConfig, Exposure, StampInstant};
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

/// One Mynt unit: a stereo unit, or one of any number of cameras whose images lie side by side in its frames.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraUnitConfig {
    /// Its capture node, or the socket of a mock unit.
    pub path: PathBuf,
    /// Serial number it must have; empty accepts any.
    #[serde(default)]
    pub serial: String,
    /// Names of its cameras in the rig, left to right.
    pub names: Vec<String>,
    /// Size of a frame with all images, pixels: of a stereo unit `[1280, 400]` or `[2560, 800]`.
    #[serde(default = "CameraUnitConfig::default_frame")]
    pub frame_px: [u32; 2],
    /// Frames per second.
    #[serde(default = "CameraUnitConfig::default_rate")]
    pub rate_hz: u32,
    /// Name of the unit's own IMU in the recording, as `imu1`; without a name it is not asked.
    #[serde(default)]
    pub imu: Option<String>,
    /// Which instant of the exposure its stamps mark.
    #[serde(default)]
    pub stamp: StampInstant,
    /// Exposure time and gain; what is set is read back.
    #[serde(default)]
    pub exposure: Exposure,
}

lsfb_types::bounds! {
    CameraUnitConfig {
        path: any,
        serial: any,
        names: any,
        frame_px: each(Bounds::AT_LEAST_ONE),
        rate_hz: number(Bounds::AT_LEAST_ONE),
        imu: any,
        stamp: any,
        exposure: any,
    }
}

impl CameraUnitConfig {
    /// A stereo unit of 640×400 at 10 Hz with the factory's settings.
    pub fn stereo(path: PathBuf, names: [String; 2]) -> Self {
        Self {
            path,
            serial: String::new(),
            names: names.to_vec(),
            frame_px: Self::default_frame(),
            rate_hz: Self::default_rate(),
            imu: None,
            stamp: StampInstant::default(),
            exposure: Exposure::default(),
        }
    }

    fn default_frame() -> [u32; 2] {
        [1280, 400]
    }

    fn default_rate() -> u32 {
        10
    }

    pub(crate) fn format(&self) -> FrameFormat {
        FrameFormat {
            width: self.frame_px[0],
            height: self.frame_px[1],
        }
    }

    /// What the driver opens.
    pub(crate) fn open(&self) -> CameraConfig {
        CameraConfig {
            path: self.path.clone(),
            serial: self.serial.clone(),
            format: self.format(),
            rate_hz: self.rate_hz,
            options: Vec::new(),
            exposure: self.exposure,
        }
    }

    /// How its frames are read.
    pub(crate) fn decoder(&self) -> mynt_s::DecoderConfig {
        mynt_s::DecoderConfig {
            format: self.format(),
            cameras: self.names.len() as u32,
            stamp: self.stamp,
            ..mynt_s::DecoderConfig::default()
        }
    }
}
