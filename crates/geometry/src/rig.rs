use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::{Camera, Se3};

/// The sensors, their intrinsics and their poses on the rig. The rig frame is the IMU frame of the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// Name of the device: `backpack`, `glasses`.
    pub name: String,
    /// Cameras by name (`cam0` …), in the order of their topics.
    #[serde(default)]
    pub cameras: BTreeMap<String, RigCamera>,
    /// The IMU, if there is one.
    pub imu: Option<RigImu>,
    /// The LiDAR, if there is one.
    pub lidar: Option<RigLidar>,
}

/// A camera on the rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigCamera {
    /// Size and lens.
    pub camera: Camera,
    /// Pose of the camera in the rig frame.
    #[serde(with = "pose_as_table")]
    pub rig_from_camera: Se3,
}

/// Noise of the IMU. The rig frame is its frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigImu {
    /// Gyroscope white noise, rad/s/√Hz.
    pub gyro_noise_density: f64,
    /// Accelerometer white noise, m/s²/√Hz.
    pub accel_noise_density: f64,
    /// Gyroscope bias random walk, rad/s²/√Hz.
    pub gyro_bias_walk: f64,
    /// Accelerometer bias random walk, m/s³/√Hz.
    pub accel_bias_walk: f64,
}

/// The LiDAR on the rig.
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
    /// Reads a rig from its TOML text; `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, RigError> {
        toml::from_str(text).map_err(|e| RigError::Parse {
            path: origin.to_owned(),
            message: toml_problem(text, &e),
        })
    }

    /// The TOML text.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
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

/// `{ rotation_xyzw = [..], translation_m = [..] }`
mod pose_as_table {
    use super::*;
    use serde::{Deserializer, Serializer, de::Error};

    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Table {
        rotation_xyzw: [f64; 4],
        translation_m: [f64; 3],
    }

    pub fn serialize<S: Serializer>(pose: &Se3, serializer: S) -> Result<S::Ok, S::Error> {
        let q = pose.rotation.quaternion();
        Table {
            rotation_xyzw: [q.i, q.j, q.k, q.w],
            translation_m: pose.translation.into(),
        }
        .serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Se3, D::Error> {
        let table = Table::deserialize(deserializer)?;
        let [x, y, z, w] = table.rotation_xyzw;
        let q = Quaternion::new(w, x, y, z);
        if !((q.norm() - 1.0).abs() < 1e-3) {
            return Err(D::Error::custom(format!(
                "rotation_xyzw has norm {}, expected 1",
                q.norm()
            )));
        }
        Ok(Se3::new(
            UnitQuaternion::new_normalize(q),
            Vector3::from(table.translation_m),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vector6;

    #[test]
    fn toml_round_trip_and_named_errors() {
        let rig = Rig {
            name: "backpack".into(),
            cameras: BTreeMap::from([(
                "cam0".into(),
                RigCamera {
                    camera: Camera::pinhole(640, 400, [350.0; 2], [319.5, 199.5]),
                    rig_from_camera: Se3::exp(&Vector6::new(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)),
                },
            )]),
            imu: Some(RigImu {
                gyro_noise_density: 1e-3,
                accel_noise_density: 1e-2,
                gyro_bias_walk: 1e-5,
                accel_bias_walk: 1e-4,
            }),
            lidar: Some(RigLidar {
                rig_from_lidar: Se3::identity(),
                range_noise_m: 0.03,
            }),
        };
        let back = Rig::from_toml(&rig.to_toml(), "memory").expect("own output");
        let (a, b) = (
            rig.cameras["cam0"].rig_from_camera,
            back.cameras["cam0"].rig_from_camera,
        );
        assert!((a.inverse() * b).log().norm() < 1e-12);
        assert_eq!(back.lidar, rig.lidar);

        for (text, problem) in [
            ("name = 'x'\nwheels = 4\n", "wheels"),
            ("name = 'x'\ncameras = [", "unclosed"),
        ] {
            let error = Rig::from_toml(text, "walk/rig.toml")
                .expect_err("no rig")
                .to_string();
            assert!(
                error.starts_with("rig file walk/rig.toml: line 2: "),
                "{error}"
            );
            assert!(
                error.contains(problem) && error.lines().count() == 1,
                "{error}"
            );
        }
    }
}
