//! Which devices are recorded: `devices.toml`.

mod camera;
mod imu;
mod lidar;
mod recorder;
mod sidecar;

use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use lsfb_drivers::ImuFamily;
use lsfb_types::{Names, OutOfBounds};
use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::Error;

pub use camera::CameraUnitConfig;
pub use imu::ImuLineConfig;
pub use lidar::{LidarNetConfig, LidarSettingsConfig};
pub use recorder::{LidarData, RecorderConfig};
pub use sidecar::SidecarConfig;

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
    /// LiDARs; one alone may be written `[lidar]`, several are `[[lidar]]`.
    #[serde(rename = "lidar", deserialize_with = "one_or_many")]
    pub lidars: Vec<LidarNetConfig>,
    /// Mynt units: together they form the camera group.
    #[serde(rename = "camera")]
    pub cameras: Vec<CameraUnitConfig>,
    /// IMUs; one alone may be written `[imu]`, several are `[[imu]]`.
    #[serde(rename = "imu", deserialize_with = "one_or_many")]
    pub imus: Vec<ImuLineConfig>,
    /// Phones and glasses.
    pub sidecar: Option<SidecarConfig>,
}

/// Reads one table, or an array of them.
fn one_or_many<'de, D, T>(deserializer: D) -> Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Tables<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for Tables<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("a table or an array of tables")
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
            T::deserialize(MapAccessDeserializer::new(map)).map(|one| vec![one])
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
            let mut many = Vec::new();
            while let Some(next) = seq.next_element()? {
                many.push(next);
            }
            Ok(many)
        }
    }
    deserializer.deserialize_any(Tables(PhantomData))
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
        if let Some(sidecar) = &mut config.sidecar {
            sidecar.folder = folder.join(&sidecar.folder);
        }
        // A CAN interface is no file.
        for imu in config
            .imus
            .iter_mut()
            .filter(|imu| imu.family != ImuFamily::Sbg)
        {
            imu.path = folder.join(&imu.path);
        }
        for angles in config
            .lidars
            .iter_mut()
            .filter_map(|lidar| lidar.angles.as_mut())
        {
            *angles = folder.join(&*angles);
        }
        Ok(config)
    }

    /// Refuses settings outside their bounds, images that do not fill a frame, and LiDARs that would take each other's packets.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.check_bounds("")?;
        for lidar in &self.lidars {
            lidar.check_settings()?;
        }
        for unit in &self.cameras {
            if unit.format().image_width(unit.names.len() as u32).is_none() {
                let [width, height] = unit.frame_px;
                let count = unit.names.len();
                return Err(Error::Cameras {
                    names: unit.names.join(", "),
                    problem: format!("{count} images do not fill a frame of {width}x{height}"),
                });
            }
        }
        self.check_ports()
    }

    /// Devices have names of their own, which are parts of topics.
    fn is_named(&self, _section: &str) -> Result<(), OutOfBounds> {
        let of_cameras = self.cameras.iter().flat_map(|unit| {
            let cameras = unit.names.iter().map(|name| ("camera.names", name));
            cameras.chain(unit.imu.iter().map(|name| ("camera.imu", name)))
        });
        let lidars = self.lidars.iter().map(|lidar| ("lidar.name", &lidar.name));
        let imus = self.imus.iter().map(|imu| ("imu.name", &imu.name));
        let all = of_cameras.chain(lidars).chain(imus);
        DEVICE_NAMES.check(all.map(|(setting, name)| (setting, name.as_str())))
    }

    fn check_ports(&self) -> Result<(), Error> {
        for (index, lidar) in self.lidars.iter().enumerate() {
            let takes_same = |other: &&LidarNetConfig| {
                let has_own_address = lidar.sensor.is_some()
                    && other.sensor.is_some()
                    && lidar.sensor != other.sensor;
                lidar.shares_port_with(other) && !has_own_address
            };
            if let Some(other) = self.lidars[..index].iter().find(takes_same) {
                return Err(Error::LidarPorts {
                    first: other.name.clone(),
                    second: lidar.name.clone(),
                });
            }
        }
        Ok(())
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
            + self.lidars.len() as f64 * LIDAR
            + self.imus.len() as f64 * IMU
            + part(self.sidecar.is_some(), SIDECAR)
    }

    /// The text of `devices.toml`.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }
}

lsfb_types::bounds! {
    DevicesConfig {
        rig: any,
        overflow: any,
        recorder: section,
        lidars as "lidar": sections,
        cameras as "camera": sections,
        imus as "imu": sections,
        sidecar: sections,
    }
    also is_named
}

/// Names of devices are parts of topics.
pub(crate) const DEVICE_NAMES: Names = Names {
    holds: |c| c.is_ascii_alphanumeric() || c == '_',
    letters: "letters, digits and underscores",
};

#[cfg(test)]
mod tests;
