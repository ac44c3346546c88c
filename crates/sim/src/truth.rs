//! What really was: written beside a recording, never inside, and opened by `eval` alone.

use std::fmt::Write as _;
use std::path::Path;

use serde::{Deserialize, Serialize};

use lsfb_geometry::{StampedPose, Trajectory};

use crate::Error;
use crate::ambient::GnssEpoch;
use crate::sensor::imu::{BiasedSample, GRAVITY_M_S2};
use crate::simulation::{RigSim, Simulation};

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
    /// What the gyroscope's axes make of the true angular velocity: a matrix, row by row.
    pub gyro_axes: [[f64; 3]; 3],
    /// What the accelerometer's axes make of the true specific force.
    pub accel_axes: [[f64; 3]; 3],
    /// Time from the first row of an image to the last, nanoseconds; an image's stamp is that of its middle row.
    pub readout_ns: u32,
    /// Biases once a second.
    pub biases: Vec<TrueBias>,
}

impl Simulation {
    /// Writes `truth_scan.tum`, `truth_walk.tum`, their `.json`, `_states.csv` and `_clocks.csv` files, what sends and what
    /// is magnetic (`truth_surroundings.json`) and `world.ply` into a folder.
    pub fn write_truth(&self, folder: &Path) -> Result<(), Error> {
        self.scan().write_truth(
            &folder.join("truth_scan.tum"),
            &folder.join("truth_scan.json"),
        )?;
        self.glasses().write_truth(
            &folder.join("truth_walk.tum"),
            &folder.join("truth_walk.json"),
        )?;
        for (rig, name) in [
            (self.scan(), "truth_scan_states.csv"),
            (self.glasses(), "truth_walk_states.csv"),
        ] {
            write(&folder.join(name), &rig.true_states_csv())?;
        }
        write_ambient(self, folder)?;
        write(&folder.join("world.ply"), &self.world().to_ply())
    }
}

impl RigSim {
    /// The poses of the rig at the times of its IMU.
    pub fn true_trajectory(&self) -> Trajectory {
        let pose = |s: &BiasedSample| StampedPose {
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
            gravity_m_s2: GRAVITY_M_S2,
            gyro_axes: rows(self.imu_axes(0)),
            accel_axes: rows(self.imu_axes(1)),
            readout_ns: self.readout_ns(),
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

    /// Velocity, angular velocity and biases at the times of the IMU, as CSV with a line of names.
    pub fn true_states_csv(&self) -> String {
        let mut text = String::from(
            "time_ns,vx_m_s,vy_m_s,vz_m_s,wx_rad_s,wy_rad_s,wz_rad_s,\
             gyro_bias_x_rad_s,gyro_bias_y_rad_s,gyro_bias_z_rad_s,\
             accel_bias_x_m_s2,accel_bias_y_m_s2,accel_bias_z_m_s2\n",
        );
        for s in self.imu() {
            let motion = self.walk().at(s.offset_ns as f64 * 1e-9);
            let _ = write!(text, "{}", self.time(s.offset_ns).nanos());
            let columns = motion
                .velocity_m_s
                .iter()
                .chain(motion.angular_velocity_rad_s.iter())
                .chain(&s.gyro_bias_rad_s)
                .chain(&s.accel_bias_m_s2);
            for value in columns {
                let _ = write!(text, ",{value:.9e}");
            }
            text.push('\n');
        }
        text
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

/// Writes how the clocks ran, what sends, what is magnetic, and how far off each position by satellites is.
fn write_ambient(simulation: &Simulation, folder: &Path) -> Result<(), Error> {
    let (scan, walk) = (simulation.scan(), simulation.glasses());
    let clocks = scan.clocks().scan_csv(scan.walk().duration_s());
    write(&folder.join("truth_scan_clocks.csv"), &clocks)?;
    let name = &walk.rig().name;
    let clocks = walk.clocks().walk_csv(name, walk.walk().duration_s());
    write(&folder.join("truth_walk_clocks.csv"), &clocks)?;
    let surroundings = simulation.surroundings();
    let json = folder.join("truth_surroundings.json");
    let text = serde_json::to_string_pretty(&surroundings.truth()).map_err(|e| Error::Write {
        path: json.clone(),
        source: e.into(),
    })?;
    write(&json, &text)?;
    let epochs = surroundings.gnss(simulation.world(), walk.walk());
    write(
        &folder.join("truth_walk_gnss.csv"),
        &gnss_csv(walk, &epochs),
    )?;
    write(
        &folder.join("truth_scan_gnss.csv"),
        &gnss_csv(scan, &scan.time_feed().epochs),
    )
}

/// Satellites and errors second by second; empty fields where there is no position.
fn gnss_csv(rig: &RigSim, epochs: &[GnssEpoch]) -> String {
    let mut text =
        String::from("time_ns,satellites,above_mask,error_east_m,error_north_m,error_up_m\n");
    for epoch in epochs {
        let time_ns = rig.time(epoch.offset_ns).nanos();
        let _ = write!(text, "{time_ns},{},{}", epoch.satellites, epoch.above_mask);
        match &epoch.error {
            Some(error) => {
                for value in error.enu_m.iter() {
                    let _ = write!(text, ",{value:.4}");
                }
            }
            None => text.push_str(",,,"),
        }
        text.push('\n');
    }
    text
}

fn rows(matrix: nalgebra::Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

fn write(path: &Path, text: &str) -> Result<(), Error> {
    std::fs::write(path, text).map_err(|source| Error::Write {
        path: path.to_owned(),
        source,
    })
}
