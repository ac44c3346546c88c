//! Which devices are recorded: `devices.toml`.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

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

/// A Velodyne sensor on the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LidarNetConfig {
    /// Address for data packets; port 0 takes a free one.
    pub data: SocketAddr,
    /// Address for position packets; port 0 takes a free one.
    pub position: SocketAddr,
}

impl Default for LidarNetConfig {
    /// The factory ports on every interface.
    fn default() -> Self {
        Self {
            data: SocketAddr::from(([0, 0, 0, 0], 2368)),
            position: SocketAddr::from(([0, 0, 0, 0], 8308)),
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
        if let Some(imu) = &mut config.imu {
            imu.path = folder.join(&imu.path);
        }
        Ok(config)
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
