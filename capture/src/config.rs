//! Which devices are recorded: `devices.toml`.

use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};

use lsfb_drivers::velodyne::model::Model;
use lsfb_drivers::velodyne::{DecoderConfig, ModelChoice, VelodyneConfig};
use lsfb_recording::{Compression, Durability, Existing};
use serde::{Deserialize, Serialize};

use crate::Error;

/// What happens to a message when the writer's queue is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overflow {
    /// It is dropped and counted: no device ever waits for the disk.
    #[default]
    Drop,
    /// Its device waits: for sources that can (simulated devices, capture files).
    Wait,
}

/// The devices of one recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DevicesConfig {
    /// Rig file, attached to the recording; relative to the file that names it.
    pub rig: Option<PathBuf>,
    /// What happens when the disk cannot keep up.
    pub overflow: Overflow,
    /// Files, disks, queue.
    pub recorder: RecorderConfig,
    /// Velodyne sensor.
    pub lidar: Option<LidarNetConfig>,
    /// Mynt stereo units.
    #[serde(rename = "camera")]
    pub cameras: Vec<CameraUnitConfig>,
    /// Xsens IMU.
    pub imu: Option<ImuLineConfig>,
    /// Phones and glasses.
    pub sidecar: Option<SidecarConfig>,
}

/// How recordings are kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecorderConfig {
    /// Compression of the chunks.
    pub compression: Compression,
    /// What the recording survives while it is being written; the disk is at most a second or two behind in any case.
    pub durability: Durability,
    /// What happens to a recording of the same name.
    pub existing: Existing,
    /// Largest size of a chunk before compression, bytes.
    pub chunk_bytes: u64,
    /// A new file after this many bytes; 0 never.
    pub split_bytes: u64,
    /// A new file after this many seconds; 0 never.
    pub split_secs: f64,
    /// Folder on another disk, to go on with when the first is nearly full; relative to the file that names it.
    pub second_folder: Option<PathBuf>,
    /// A disk with less room than this is full, bytes: enough to close a recording.
    pub reserve_bytes: u64,
    /// A recording is not begun with room for less than this, seconds; 0 begins in any case.
    pub least_space_secs: f64,
    /// Bytes per second to reckon with before the first are written; 0 takes what the devices send at most.
    pub expected_bytes_per_sec: f64,
    /// Memory between the devices and the disk, bytes.
    pub queue_bytes: u64,
}

impl Default for RecorderConfig {
    /// One file, `lz4`, room for ten minutes, some seconds of the whole rig in memory.
    fn default() -> Self {
        Self {
            compression: Compression::default(),
            durability: Durability::default(),
            existing: Existing::Refuse,
            chunk_bytes: 4 << 20,
            split_bytes: 0,
            split_secs: 0.0,
            second_folder: None,
            reserve_bytes: 256 << 20,
            least_space_secs: 600.0,
            expected_bytes_per_sec: 0.0,
            queue_bytes: 384 << 20,
        }
    }
}

/// Models that can be asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LidarModel {
    /// Whatever the packets say.
    #[default]
    Any,
    /// VLP-32C.
    Vlp32c,
    /// VLP-16.
    Vlp16,
    /// HDL-32E.
    Hdl32e,
}

/// A Velodyne sensor on the network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LidarNetConfig {
    /// Address for data packets; port 0 takes a free one.
    pub data: SocketAddr,
    /// Address for position packets; port 0 takes a free one.
    pub position: SocketAddr,
    /// The sensor it must be.
    pub model: LidarModel,
    /// A scan ends where the rotor passes this angle, degrees. With a field-of-view window, choose one outside it.
    pub cut_azimuth_deg: f64,
    /// Take packets from this address only; several sensors share the factory ports.
    pub sensor: Option<IpAddr>,
    /// Wanted kernel receive buffer, bytes.
    pub receive_buffer_bytes: usize,
}

impl Default for LidarNetConfig {
    /// The factory ports on every interface, any sensor.
    fn default() -> Self {
        let wire = VelodyneConfig::default();
        Self {
            data: wire.data_bind,
            position: wire.position_bind,
            model: LidarModel::default(),
            cut_azimuth_deg: 0.0,
            sensor: wire.sensor,
            receive_buffer_bytes: wire.receive_buffer_bytes,
        }
    }
}

impl LidarNetConfig {
    pub(crate) fn decoder(&self) -> DecoderConfig {
        DecoderConfig {
            model: match self.model {
                LidarModel::Any => ModelChoice::FromPackets,
                LidarModel::Vlp32c => ModelChoice::Expect(Model::Vlp32c),
                LidarModel::Vlp16 => ModelChoice::Expect(Model::Vlp16),
                LidarModel::Hdl32e => ModelChoice::Expect(Model::Hdl32e),
            },
            // A float cast saturates, and a whole turn is none.
            cut_azimuth_centideg: (self.cut_azimuth_deg.rem_euclid(360.0) * 100.0) as u16 % 36_000,
            ..DecoderConfig::default()
        }
    }
}

/// One Mynt stereo unit.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraUnitConfig {
    /// Its socket.
    pub path: PathBuf,
    /// Serial number it must have; empty accepts any.
    #[serde(default)]
    pub serial: String,
    /// Names of the left and the right camera in the rig.
    pub names: [String; 2],
    /// Frame size, pixels: `[1280, 400]` or `[2560, 800]`.
    #[serde(default = "CameraUnitConfig::default_frame")]
    pub frame_px: [u32; 2],
    /// Frames per second.
    #[serde(default = "CameraUnitConfig::default_rate")]
    pub rate_hz: u32,
    /// Name of the unit's own IMU in the recording, as `imu1`; without a name it is not asked.
    #[serde(default)]
    pub imu: Option<String>,
}

impl CameraUnitConfig {
    fn default_frame() -> [u32; 2] {
        [1280, 400]
    }

    fn default_rate() -> u32 {
        10
    }
}

/// An IMU on a serial line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuLineConfig {
    /// The line.
    pub path: PathBuf,
    /// Speed, baud.
    #[serde(default = "ImuLineConfig::default_baud")]
    pub baud: u32,
    /// Samples per second.
    #[serde(default = "ImuLineConfig::default_rate")]
    pub rate_hz: u16,
}

impl ImuLineConfig {
    fn default_baud() -> u32 {
        lsfb_drivers::imu::model::DEFAULT_BAUD
    }

    fn default_rate() -> u16 {
        200
    }
}

/// Where phones and glasses connect.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SidecarConfig {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
}

impl DevicesConfig {
    /// Reads `devices.toml`; relative paths in it start at its folder.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|cause| Error::Io {
            path: path.to_owned(),
            cause,
        })?;
        let mut config: Self = toml::from_str(&text).map_err(|e| Error::Config {
            path: path.to_owned(),
            message: lsfb_geometry::toml_problem(&text, &e),
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        if let Some(rig) = &mut config.rig {
            *rig = folder.join(&*rig);
        }
        for camera in &mut config.cameras {
            camera.path = folder.join(&camera.path);
        }
        if let Some(second) = &mut config.recorder.second_folder {
            *second = folder.join(&*second);
        }
        if let Some(imu) = &mut config.imu {
            imu.path = folder.join(&imu.path);
        }
        Ok(config)
    }

    /// What all devices together write at most, bytes per second, unless [`RecorderConfig::expected_bytes_per_sec`] says.
    pub fn expected_bytes_per_sec(&self) -> f64 {
        /// A VLP-32C with one return: 1.8 MB of packets and 13 MB of points, which compress to two thirds.
        const LIDAR: f64 = 10e6;
        /// Samples, counters and raw bytes, at 400 Hz.
        const IMU: f64 = 0.3e6;
        /// Glasses with one compressed video.
        const SIDECAR: f64 = 3e6;
        if self.recorder.expected_bytes_per_sec > 0.0 {
            return self.recorder.expected_bytes_per_sec;
        }
        let pixels = |c: &CameraUnitConfig| f64::from(c.frame_px[0]) * f64::from(c.frame_px[1]);
        let cameras: f64 = self
            .cameras
            .iter()
            .map(|c| pixels(c) * f64::from(c.rate_hz))
            .sum();
        let part = |there: bool, rate: f64| if there { rate } else { 0.0 };
        cameras
            + part(self.lidar.is_some(), LIDAR)
            + part(self.imu.is_some(), IMU)
            + part(self.sidecar.is_some(), SIDECAR)
    }

    /// The text of `devices.toml`.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_its_own_text_and_names_what_it_does_not_know() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("devices.toml");
        let config = DevicesConfig {
            lidar: Some(LidarNetConfig::default()),
            cameras: vec![CameraUnitConfig {
                path: "/run/lsfb/front".into(),
                serial: String::new(),
                names: ["cam0".into(), "cam1".into()],
                frame_px: [1280, 400],
                rate_hz: 10,
                imu: None,
            }],
            ..DevicesConfig::default()
        };
        std::fs::write(&path, config.to_toml()).unwrap();
        assert_eq!(DevicesConfig::read(&path).unwrap(), config);
        std::fs::write(&path, "[lidar]\nrpm = 600\n").unwrap();
        let message = DevicesConfig::read(&path).unwrap_err().to_string();
        assert!(
            message.contains("devices.toml: line 2: ")
                && message.contains("rpm")
                && message.lines().count() == 1,
            "{message}"
        );
    }
}
