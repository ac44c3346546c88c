use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use self::file::{ImuTable, RigFile, pose_as_table};
use crate::{Camera, Matrix6, Se3};

mod file;

/// The sensors, their intrinsics and their poses on the rig. The rig frame is the frame of its main IMU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RigFile", into = "RigFile")]
pub struct Rig {
    /// Name of the device: `backpack`, `glasses`.
    pub name: String,
    /// End of the recording that its geometry was last calibrated from, seconds since 1970; `None` where nobody knows.
    pub calibrated_unix_s: Option<i64>,
    /// Cameras by name (`cam0` …), in the order of their topics.
    pub cameras: BTreeMap<String, RigCamera>,
    /// IMUs by name; [`Rig::imu`] is the main one.
    pub imus: BTreeMap<String, RigImu>,
    /// LiDARs by name; [`Rig::lidar`] is the main one.
    pub lidars: BTreeMap<String, RigLidar>,
}

/// Name of a rig's main IMU, which is its only one in most rigs.
pub const MAIN_IMU: &str = "imu0";
/// Name of a rig's main LiDAR, which is its only one in most rigs.
pub const MAIN_LIDAR: &str = "lidar";

/// A camera on the rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigCamera {
    /// Size and lens.
    pub camera: Camera,
    /// Pose of the camera in the rig frame.
    #[serde(with = "pose_as_table")]
    pub rig_from_camera: Se3,
    /// Its clock and shutter; an ideal global shutter where nothing is said.
    #[serde(default, skip_serializing_if = "CameraTiming::is_ideal")]
    pub timing: CameraTiming,
    /// How well all of that is known, as far as a calibration has said.
    #[serde(default, skip_serializing_if = "CameraSigmas::are_unknown")]
    pub sigmas: CameraSigmas,
}

/// Standard deviations of what a rig says of a camera; `None` where nobody has said how well it is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSigmas {
    /// Of its attitude on the rig, about the camera's axes, radians.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_rad: Option<[f64; 3]>,
    /// Of its position on the rig, along the camera's axes, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub translation_m: Option<[f64; 3]>,
    /// Of its focal lengths, as a share of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_share: Option<f64>,
    /// Of its clock, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rig_from_camera_s: Option<f64>,
    /// Of its readout time, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub readout_s: Option<f64>,
}

impl CameraSigmas {
    /// Whether nothing is said.
    pub fn are_unknown(&self) -> bool {
        *self == Self::default()
    }

    /// Of a pose on the rig with this covariance, tangent `[rotation, translation]` on the right, rad² and m²; the rest unknown.
    pub fn of_pose(covariance: &Matrix6<f64>) -> Self {
        let three = |first: usize| [0, 1, 2].map(|k| covariance[(first + k, first + k)].sqrt());
        let known = |sigmas: [f64; 3]| sigmas.iter().all(|s| is_sigma(*s)).then_some(sigmas);
        Self {
            rotation_rad: known(three(0)),
            translation_m: known(three(3)),
            ..Self::default()
        }
    }

    /// A standard deviation that was estimated; `None` for what was not searched, which has zero.
    pub fn estimated(sigma: f64) -> Option<f64> {
        Some(sigma).filter(|sigma| is_sigma(*sigma))
    }

    /// What each is called in a file, with its values.
    fn entries(&self) -> [(&'static str, Option<Vec<f64>>); 5] {
        [
            ("rotation_rad", self.rotation_rad.map(Vec::from)),
            ("translation_m", self.translation_m.map(Vec::from)),
            ("focal_share", self.focal_share.map(|s| vec![s])),
            ("rig_from_camera_s", self.rig_from_camera_s.map(|s| vec![s])),
            ("readout_s", self.readout_s.map(|s| vec![s])),
        ]
    }
}

fn is_sigma(sigma: f64) -> bool {
    sigma > 0.0 && sigma.is_finite()
}

/// When a camera sees what its stamp says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraTiming {
    /// Added to the camera's stamps it gives the time of the rig (IMU), seconds.
    pub rig_from_camera_s: f64,
    /// Time from the first row's exposure to that of one row below the last, seconds; 0 for a global shutter, negative where
    /// rows are read upwards.
    pub readout_s: f64,
}

impl CameraTiming {
    /// Whether stamps are the rig's own and the shutter is global.
    pub fn is_ideal(&self) -> bool {
        *self == Self::default()
    }
}

/// An IMU on the rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "ImuTable", into = "ImuTable")]
pub struct RigImu {
    /// Pose of the IMU in the rig frame: the identity for the main one.
    pub rig_from_imu: Se3,
    /// How noisy it is.
    pub noise: ImuNoiseModel,
}

impl RigImu {
    /// The IMUs of a rig that has this one only.
    pub fn alone(self) -> BTreeMap<String, Self> {
        BTreeMap::from([(MAIN_IMU.to_owned(), self)])
    }
}

impl From<ImuNoiseModel> for RigImu {
    /// The IMU whose frame is the rig's.
    fn from(noise: ImuNoiseModel) -> Self {
        Self {
            rig_from_imu: Se3::identity(),
            noise,
        }
    }
}

/// Noise of an IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuNoiseModel {
    /// Gyroscope white noise, rad/s/√Hz.
    pub gyro_noise_density: f64,
    /// Accelerometer white noise, m/s²/√Hz.
    pub accel_noise_density: f64,
    /// Gyroscope bias random walk, rad/s²/√Hz.
    pub gyro_bias_walk: f64,
    /// Accelerometer bias random walk, m/s³/√Hz.
    pub accel_bias_walk: f64,
}

/// A LiDAR on the rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigLidar {
    /// Pose of the LiDAR in the rig frame.
    #[serde(with = "pose_as_table")]
    pub rig_from_lidar: Se3,
    /// Standard deviation of one range, metres.
    pub range_noise_m: f64,
}

/// What is wrong with a rig file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RigError {
    /// The file could not be read.
    #[error("rig file {path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not a rig.
    #[error("rig file {path}: {message}")]
    Parse {
        /// The file, or where the text came from.
        path: String,
        /// Line and reason.
        message: String,
    },
}

/// What is wrong with a TOML text, on one line: messages of this project are one sentence.
pub fn toml_problem(text: &str, error: &toml::de::Error) -> String {
    let before = error.span().and_then(|span| text.get(..span.start));
    let place = before.map_or_else(String::new, |before| {
        format!("line {}: ", before.matches('\n').count() + 1)
    });
    format!("{place}{}", error.message().replace('\n', ", "))
}

impl Rig {
    /// A device without sensors, calibrated nobody knows when.
    pub fn empty(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            calibrated_unix_s: None,
            cameras: BTreeMap::new(),
            imus: BTreeMap::new(),
            lidars: BTreeMap::new(),
        }
    }

    /// The LiDAR that stages work with: the one named [`MAIN_LIDAR`], else the first by name.
    pub fn lidar(&self) -> Option<&RigLidar> {
        main(&self.lidars, MAIN_LIDAR).map(|(_, lidar)| lidar)
    }

    /// Name of [`Rig::lidar`].
    pub fn main_lidar_name(&self) -> Option<&str> {
        main(&self.lidars, MAIN_LIDAR).map(|(name, _)| name)
    }

    /// [`Rig::lidar`], to be changed.
    pub fn lidar_mut(&mut self) -> Option<&mut RigLidar> {
        let name = main(&self.lidars, MAIN_LIDAR)?.0.to_owned();
        self.lidars.get_mut(&name)
    }

    /// Puts `lidar` in the place of the main LiDAR.
    pub fn set_lidar(&mut self, lidar: RigLidar) {
        match self.lidar_mut() {
            Some(place) => *place = lidar,
            None => self.lidars = lidar.alone(),
        }
    }

    /// The IMU whose frame is the rig's: the one named [`MAIN_IMU`], else the first by name.
    pub fn imu(&self) -> Option<&RigImu> {
        self.main_imu().map(|(_, imu)| imu)
    }

    /// Noise of the main IMU.
    pub fn imu_noise(&self) -> Option<&ImuNoiseModel> {
        self.imu().map(|imu| &imu.noise)
    }

    /// Says how noisy the main IMU is.
    pub fn set_imu_noise(&mut self, noise: ImuNoiseModel) {
        let name = self
            .main_imu()
            .map_or(MAIN_IMU, |(name, _)| name)
            .to_owned();
        self.imus.insert(name, noise.into());
    }

    fn main_imu(&self) -> Option<(&str, &RigImu)> {
        main(&self.imus, MAIN_IMU)
    }

    /// Reads a rig from its TOML text; `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, RigError> {
        let rig: Self = toml::from_str(text).map_err(|e| RigError::Parse {
            path: origin.to_owned(),
            message: toml_problem(text, &e),
        })?;
        match rig.problem() {
            Some(message) => Err(RigError::Parse {
                path: origin.to_owned(),
                message,
            }),
            None => Ok(rig),
        }
    }

    /// What in it cannot be: numbers that are none, negative noise, lenses that do not project.
    pub fn problem(&self) -> Option<String> {
        let of_cameras = self.cameras.iter().filter_map(|(name, mounted)| {
            let timing = &mounted.timing;
            let camera = &mounted.camera;
            let lens = camera.lens.problem();
            lens.or_else(|| size_problem([camera.width, camera.height]))
                .or_else(|| pose_problem(&mounted.rig_from_camera))
                .or_else(|| number_problem("rig_from_camera_s", timing.rig_from_camera_s))
                .or_else(|| number_problem("readout_s", timing.readout_s))
                .map(|problem| format!("camera {name}: {problem}"))
        });
        let of_imus = self.imus.iter().filter_map(|(name, imu)| {
            let noise = &imu.noise;
            [
                ("gyro_noise_density", noise.gyro_noise_density),
                ("accel_noise_density", noise.accel_noise_density),
                ("gyro_bias_walk", noise.gyro_bias_walk),
                ("accel_bias_walk", noise.accel_bias_walk),
            ]
            .into_iter()
            .find_map(|(what, value)| noise_problem(what, value))
            .or_else(|| pose_problem(&imu.rig_from_imu))
            .map(|problem| format!("IMU {name}: {problem}"))
        });
        let of_lidars = self.lidars.iter().filter_map(|(name, lidar)| {
            noise_problem("range_noise_m", lidar.range_noise_m)
                .or_else(|| pose_problem(&lidar.rig_from_lidar))
                .map(|problem| format!("LiDAR {name}: {problem}"))
        });
        of_cameras.chain(of_imus).chain(of_lidars).next()
    }

    /// Reads a rig file.
    pub fn read(path: &Path) -> Result<Self, RigError> {
        let text = std::fs::read_to_string(path).map_err(|source| RigError::Io {
            path: path.display().to_string(),
            source,
        })?;
        Self::from_toml(&text, &path.display().to_string())
    }
}

fn main<'a, T>(sensors: &'a BTreeMap<String, T>, name: &'a str) -> Option<(&'a str, &'a T)> {
    match sensors.get(name) {
        Some(sensor) => Some((name, sensor)),
        None => sensors
            .iter()
            .next()
            .map(|(name, sensor)| (name.as_str(), sensor)),
    }
}

impl RigLidar {
    /// The LiDARs of a rig that has this one only.
    pub fn alone(self) -> BTreeMap<String, Self> {
        BTreeMap::from([(MAIN_LIDAR.to_owned(), self)])
    }
}

fn size_problem([width, height]: [u32; 2]) -> Option<String> {
    (width == 0 || height == 0).then(|| format!("an image of {width} × {height} pixels"))
}

fn pose_problem(pose: &Se3) -> Option<String> {
    let (turn, shift) = (pose.rotation.coords, pose.translation);
    let mut numbers = turn.iter().chain(shift.iter());
    (!numbers.all(|v| v.is_finite())).then(|| "a pose that is not a number".to_owned())
}

fn number_problem(what: &str, value: f64) -> Option<String> {
    (!value.is_finite()).then(|| format!("{what} is {value}"))
}

fn noise_problem(what: &str, value: f64) -> Option<String> {
    (!(value.is_finite() && value >= 0.0)).then(|| format!("{what} is {value}"))
}

#[cfg(test)]
mod tests;
