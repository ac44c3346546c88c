//! What really was: written beside a recording, never inside, and opened by `eval` alone.

use std::fmt::Write as _;
use std::path::Path;

use serde::{Deserialize, Serialize};

use lsfb_geometry::{StampedPose, Trajectory};

use crate::Error;
use crate::simulation::RigSim;

/// Biases of an IMU at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrueBias {
    /// Time, nanoseconds since 1970.
    pub time_ns: i64,
    /// Gyroscope, rad/s.
    pub gyro_rad_s: [f64; 3],
    /// Accelerometer, m/s².
    pub accel_m_s2: [f64; 3],
}

/// Truth that is not a trajectory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// Name of the rig.
    pub rig: String,
    /// Seed of the simulation.
    pub seed: u64,
    /// Magnitude of gravity, m/s².
    pub gravity_m_s2: f64,
    /// Biases once a second.
    pub biases: Vec<TrueBias>,
}

impl RigSim {
    /// The poses of the rig at the times of its IMU.
    pub fn true_trajectory(&self) -> Trajectory {
        let pose = |s: &crate::BiasedSample| StampedPose {
            time: self.time(s.offset_ns),
            world_from_rig: self.walk().at(s.offset_ns as f64 * 1e-9).world_from_rig,
        };
        Trajectory::new(self.imu().iter().map(pose).collect())
    }

    /// Biases and constants.
    pub fn truth(&self) -> Truth {
        Truth {
            rig: self.rig().name.clone(),
            seed: self.seed(),
            gravity_m_s2: crate::GRAVITY_M_S2,
            biases: self
                .imu()
                .iter()
                .filter(|s| s.offset_ns % 1_000_000_000 == 0)
                .map(|s| TrueBias {
                    time_ns: self.time(s.offset_ns).nanos(),
                    gyro_rad_s: s.gyro_bias_rad_s,
                    accel_m_s2: s.accel_bias_m_s2,
                })
                .collect(),
        }
    }

    /// Writes the trajectory (TUM: time, position, quaternion x y z w) and the rest (JSON) of the truth.
    pub fn write_truth(&self, tum: &Path, json: &Path) -> Result<(), Error> {
        let mut text = String::new();
        for pose in self.true_trajectory().poses() {
            let t = pose.world_from_rig.translation;
            let q = pose.world_from_rig.rotation.quaternion();
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{} {:.9} {:.9} {:.9} {:.12} {:.12} {:.12} {:.12}",
                pose.time, t.x, t.y, t.z, q.i, q.j, q.k, q.w
            );
        }
        write(tum, &text)?;
        let truth = serde_json::to_string_pretty(&self.truth()).map_err(|e| Error::Write {
            path: json.to_owned(),
            source: e.into(),
        })?;
        write(json, &truth)
    }
}

pub(crate) fn write(path: &Path, text: &str) -> Result<(), Error> {
    std::fs::write(path, text).map_err(|source| Error::Write {
        path: path.to_owned(),
        source,
    })
}
