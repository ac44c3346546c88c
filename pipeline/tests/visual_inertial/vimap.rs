//! Maps of maplab as tables (`SOURCES.md` of the recordings says what their columns are).

use std::collections::BTreeSet;
use std::path::Path;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{
    Camera, ImuNoiseModel, Matrix3, RigCamera, Se3, StampedPose, Trajectory, UnitQuaternion,
    Vector2, Vector3,
};
use lsfb_perception::imu::{ImuBias, NavState};
use lsfb_pipeline::ground_truth::{Sight, TrackedFrame, TrackedWalk};
use lsfb_types::{ImuSample, Stamped, Timestamp};
use nalgebra::Quaternion;

use super::table::{nanos, rows};

/// Tracks with the states that an odometry gave.
pub struct VisualInertialMap {
    pub walk: TrackedWalk,
    pub states: Vec<(NavState, ImuBias)>,
}

impl VisualInertialMap {
    pub fn read(folder: &Path) -> Self {
        let keyframes = folder.join("keyframes.csv.gz");
        let times = nanos(&keyframes, 1);
        let states = rows(&keyframes).iter().map(|row| state(row)).collect();
        let landmarks = rows(&folder.join("landmarks.csv.gz"));
        let good = landmarks.iter().filter(|row| row[5] == 2.0);
        let good: BTreeSet<i64> = good.map(|row| row[0] as i64).collect();
        let mut frames: Vec<TrackedFrame> = times
            .iter()
            .map(|ns| TrackedFrame {
                time: Timestamp::from_nanos(*ns),
                sights: Vec::new(),
            })
            .collect();
        for row in rows(&folder.join("keypoints.csv.gz")) {
            let landmark = row[6] as i64;
            if good.contains(&landmark) {
                frames[row[0] as usize].sights.push(Sight {
                    track: landmark as u32,
                    camera: 0,
                    pixel: Vector2::new(row[2], row[3]),
                });
            }
        }
        let imu = folder.join("imu.csv.gz");
        let stamps = nanos(&imu, 1);
        let mut imu: Vec<Stamped<ImuSample>> = stamps
            .iter()
            .zip(rows(&imu))
            .map(|(ns, row)| sample(*ns, [row[5], row[6], row[7]], [row[2], row[3], row[4]]))
            .collect();
        // A sample at the seam of two edges is in both.
        imu.sort_by_key(|s| s.time);
        imu.dedup_by_key(|s| s.time);
        let sensors = std::fs::read_to_string(folder.join("sensors.yaml")).expect("sensors");
        let (camera, noise) = read_sensors(&sensors);
        Self {
            walk: TrackedWalk {
                cameras: vec![camera],
                frames,
                imu,
                noise,
                views: Vec::new(),
            },
            states,
        }
    }
}

pub fn sample(ns: i64, gyro: [f64; 3], force: [f64; 3]) -> Stamped<ImuSample> {
    let time = Timestamp::from_nanos(ns);
    Stamped {
        time,
        arrival: time,
        device_ticks: 0,
        sample: ImuSample {
            angular_velocity_rad_s: gyro,
            specific_force_m_s2: force,
        },
    }
}

fn state(row: &[f64]) -> (NavState, ImuBias) {
    let at = |k: usize| Vector3::new(row[k], row[k + 1], row[k + 2]);
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(row[5], row[2], row[3], row[4]));
    let nav = NavState {
        world_from_rig: Se3::new(rotation, at(6)),
        velocity_m_s: at(9),
    };
    let bias = ImuBias {
        gyro_rad_s: at(15),
        accel_m_s2: at(12),
    };
    (nav, bias)
}

/// The one camera and the noise of the IMU. Numbers follow the names of their fields.
fn read_sensors(text: &str) -> (RigCamera, ImuNoiseModel) {
    let words: Vec<&str> = text
        .split(|c: char| c.is_whitespace() || "[],".contains(c))
        .filter(|w| !w.is_empty())
        .collect();
    let after = |name: &str, count: usize| -> Vec<f64> {
        let at = words.iter().position(|w| *w == name).expect("a field");
        let numbers = words[at + 1..].iter().filter_map(|w| w.parse::<f64>().ok());
        numbers.take(count).collect()
    };
    let one = |name: &str| after(name, 1)[0];
    let noise = ImuNoiseModel {
        gyro_noise_density: one("gyro_noise_density:"),
        accel_noise_density: one("acc_noise_density:"),
        gyro_bias_walk: one("gyro_bias_random_walk_noise_density:"),
        accel_bias_walk: one("acc_bias_random_walk_noise_density:"),
    };
    // Rows and columns come first.
    let intrinsics = &after("intrinsics:", 6)[2..];
    let focal_px = [intrinsics[0], intrinsics[1]];
    let principal_px = [intrinsics[2], intrinsics[3]];
    let kind = words
        .iter()
        .position(|w| *w == "distortion:")
        .expect("a lens");
    let lens = match words[kind + 2] {
        "fisheye" => Lens::FieldOfView {
            focal_px,
            principal_px,
            distortion: [after("distortion:", 3)[2]],
        },
        _ => {
            let d = &after("distortion:", 6)[2..];
            Lens::PinholeRadtan {
                focal_px,
                principal_px,
                distortion: [d[0], d[1], d[2], d[3], 0.0],
            }
        }
    };
    let m = &after("T_B_C:", 18)[2..];
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let rotation = UnitQuaternion::from_matrix(&rotation);
    let camera = RigCamera {
        camera: Camera {
            width: one("image_width:") as u32,
            height: one("image_height:") as u32,
            lens,
        },
        rig_from_camera: Se3::new(rotation, Vector3::new(m[3], m[7], m[11])),
        timing: Default::default(),
        sigmas: Default::default(),
    };
    (camera, noise)
}

/// Positions of the IMU by motion capture.
pub fn truth(path: &Path) -> Trajectory {
    let times = nanos(path, 0);
    let poses = times.iter().zip(rows(path)).map(|(ns, row)| {
        let rotation = Quaternion::new(row[4], row[5], row[6], row[7]);
        StampedPose {
            time: Timestamp::from_nanos(*ns),
            world_from_rig: Se3::new(
                UnitQuaternion::new_normalize(rotation),
                Vector3::new(row[1], row[2], row[3]),
            ),
        }
    });
    Trajectory::new(poses.collect())
}
