use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use toml::Table;

use crate::{Camera, Se3};

/// The sensors, their intrinsics and their poses on the rig. The rig frame is the IMU frame of the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// Name of the device: `backpack`, `glasses`.
    pub name: String,
    /// End of the recording that its geometry was last calibrated from, seconds since 1970; `None` where nobody knows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibrated_unix_s: Option<i64>,
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
    /// Its clock and shutter; an ideal global shutter where nothing is said.
    #[serde(default, skip_serializing_if = "CameraTiming::is_ideal")]
    pub timing: CameraTiming,
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
    /// A device without sensors, calibrated nobody knows when.
    pub fn empty(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            calibrated_unix_s: None,
            cameras: BTreeMap::new(),
            imu: None,
            lidar: None,
        }
    }

    /// Reads a rig from its TOML text; `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, RigError> {
        let rig: Self = toml::from_str(text).map_err(|e| RigError::Parse {
            path: origin.to_owned(),
            message: toml_problem(text, &e),
        })?;
        for (name, mounted) in &rig.cameras {
            if let Some(problem) = mounted.camera.lens.problem() {
                return Err(RigError::Parse {
                    path: origin.to_owned(),
                    message: format!("camera {name}: {problem}"),
                });
            }
        }
        Ok(rig)
    }

    /// The TOML text: the same for equal rigs, and again the same after it was read back, so that its hash names the
    /// calibration. Built value by value, so that nothing in it can fail.
    pub fn to_toml(&self) -> String {
        let mut rig = Table::new();
        rig.insert("name".into(), self.name.clone().into());
        if let Some(time) = self.calibrated_unix_s {
            rig.insert("calibrated_unix_s".into(), time.into());
        }
        if let Some(imu) = &self.imu {
            let noise = [
                ("gyro_noise_density", imu.gyro_noise_density),
                ("accel_noise_density", imu.accel_noise_density),
                ("gyro_bias_walk", imu.gyro_bias_walk),
                ("accel_bias_walk", imu.accel_bias_walk),
            ];
            rig.insert("imu".into(), numbers(&noise).into());
        }
        if let Some(lidar) = &self.lidar {
            let mut table = numbers(&[("range_noise_m", lidar.range_noise_m)]);
            table.insert("rig_from_lidar".into(), pose(&lidar.rig_from_lidar).into());
            rig.insert("lidar".into(), table.into());
        }
        let cameras: Table = self
            .cameras
            .iter()
            .map(|(name, camera)| (name.clone(), camera.table().into()))
            .collect();
        rig.insert("cameras".into(), cameras.into());
        rig.to_string()
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

impl RigCamera {
    fn table(&self) -> Table {
        let lens = &self.camera.lens;
        let mut lens_table = Table::new();
        lens_table.insert("model".into(), lens.model().name().into());
        lens_table.insert("focal_px".into(), lens.focal_px().to_vec().into());
        lens_table.insert("principal_px".into(), lens.principal_px().to_vec().into());
        lens_table.insert("distortion".into(), lens.distortion().to_vec().into());
        let mut camera = Table::new();
        camera.insert("width".into(), self.camera.width.into());
        camera.insert("height".into(), self.camera.height.into());
        camera.insert("lens".into(), lens_table.into());
        let mut mounted = Table::new();
        mounted.insert("camera".into(), camera.into());
        mounted.insert("rig_from_camera".into(), pose(&self.rig_from_camera).into());
        if !self.timing.is_ideal() {
            let timing = [
                ("rig_from_camera_s", self.timing.rig_from_camera_s),
                ("readout_s", self.timing.readout_s),
            ];
            mounted.insert("timing".into(), numbers(&timing).into());
        }
        mounted
    }
}

fn numbers(entries: &[(&str, f64)]) -> Table {
    entries
        .iter()
        .map(|(name, value)| ((*name).to_owned(), (*value).into()))
        .collect()
}

/// A quaternion made a unit; one that is a unit but for rounding stays to the last bit, so that what was written is what is
/// read.
fn unit(q: Quaternion<f64>) -> UnitQuaternion<f64> {
    if (q.norm() - 1.0).abs() < 1e-12 {
        UnitQuaternion::new_unchecked(q)
    } else {
        UnitQuaternion::new_normalize(q)
    }
}

fn pose(pose: &Se3) -> Table {
    let rotation_xyzw = unit(*pose.rotation.quaternion()).coords.as_slice().to_vec();
    let translation_m = pose.translation.as_slice().to_vec();
    Table::from_iter([
        ("rotation_xyzw".to_owned(), toml::Value::from(rotation_xyzw)),
        ("translation_m".to_owned(), translation_m.into()),
    ])
}

/// `{ rotation_xyzw = [..], translation_m = [..] }`
mod pose_as_table {
    use super::*;
    use serde::{Deserializer, Serializer, de::Error};

    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct PoseTable {
        rotation_xyzw: [f64; 4],
        translation_m: [f64; 3],
    }

    pub fn serialize<S: Serializer>(pose: &Se3, serializer: S) -> Result<S::Ok, S::Error> {
        let q = pose.rotation.quaternion();
        PoseTable {
            rotation_xyzw: [q.i, q.j, q.k, q.w],
            translation_m: pose.translation.into(),
        }
        .serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Se3, D::Error> {
        let table = PoseTable::deserialize(deserializer)?;
        let [x, y, z, w] = table.rotation_xyzw;
        let q = Quaternion::new(w, x, y, z);
        if !((q.norm() - 1.0).abs() < 1e-3) {
            return Err(D::Error::custom(format!(
                "rotation_xyzw has norm {}, expected 1",
                q.norm()
            )));
        }
        Ok(Se3::new(unit(q), Vector3::from(table.translation_m)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vector6;
    use crate::camera::Lens;

    #[test]
    fn toml_round_trip_and_named_errors() {
        let (focal_px, principal_px) = ([350.0, 350.1], [319.5, 199.5]);
        let lenses = [
            Camera::pinhole(640, 400, focal_px, principal_px).lens,
            Lens::KannalaBrandt {
                focal_px,
                principal_px,
                distortion: [0.1, -0.2, 1e-3, 1e-9],
            },
            Lens::DoubleSphere {
                focal_px,
                principal_px,
                distortion: [-0.17, 0.59],
            },
            Lens::ExtendedUnified {
                focal_px,
                principal_px,
                distortion: [0.62, 1.1],
            },
            Lens::FieldOfView {
                focal_px,
                principal_px,
                distortion: [0.92],
            },
        ];
        let cameras = lenses.into_iter().enumerate().map(|(k, lens)| {
            let mounted = RigCamera {
                camera: Camera {
                    width: 640,
                    height: 400,
                    lens,
                },
                rig_from_camera: Se3::exp(&Vector6::new(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)),
                timing: CameraTiming {
                    rig_from_camera_s: k as f64 * 1e-3,
                    readout_s: 0.0,
                },
            };
            (format!("cam {k} \"left\""), mounted)
        });
        let rig = Rig {
            name: "backpack".into(),
            calibrated_unix_s: Some(1_772_359_200),
            cameras: cameras.collect(),
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
        assert_eq!(back, rig);
        // What serde itself writes is the same rig.
        let serde = toml::to_string(&rig).expect("serde writes a rig");
        let serde = Rig::from_toml(&serde, "memory").expect("own output");
        assert_eq!(serde, back);

        let broken = rig.to_toml().replace("1.1", "-1.1");
        let error = Rig::from_toml(&broken, "rig.toml").expect_err("bad lens");
        assert!(error.to_string().contains("beta is -1.1"), "{error}");

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
    /// The text names the calibration: it must not move when it is read and written.
    #[test]
    fn text_stays_the_same_to_the_last_bit() {
        let mut pose = Se3::exp(&Vector6::new(0.3, -0.2, 0.1, 0.01, 0.2, -0.3));
        for k in 0..500 {
            pose = pose * Se3::exp(&Vector6::repeat(0.1 + 1e-3 * f64::from(k)));
            let rig = Rig {
                lidar: Some(RigLidar {
                    rig_from_lidar: pose,
                    range_noise_m: 0.03,
                }),
                ..Rig::empty("turned")
            };
            let text = rig.to_toml();
            let back = Rig::from_toml(&text, "memory").expect("own output");
            assert_eq!(back.to_toml(), text);
        }
        // Typed by hand with few digits: made a unit once, then it stays.
        let rough = "name = 'x'\n[lidar]\nrange_noise_m = 0.03\nrig_from_lidar = { rotation_xyzw = [0.1, 0.2, 0.3, 0.9273], translation_m = [0, 0, 0] }\n";
        let text = Rig::from_toml(rough, "memory").expect("a rig").to_toml();
        let again = Rig::from_toml(&text, "memory").expect("own output");
        assert_eq!(again.to_toml(), text);
    }
}
