//! Tracks of one camera and samples, in one table.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_geometry::{Camera, ImuNoiseModel, RigCamera, Se3, UnitQuaternion, Vector2, Vector3};
use lsfb_pipeline::ground_truth::{Sight, TrackedFrame, TrackedWalk};
use lsfb_types::Timestamp;
use nalgebra::Quaternion;

use super::table::{lines, number};
use super::vimap::sample;

/// Focal length given to the undistorted coordinates, so that errors are in the camera's pixels.
const FOCAL_PX: f64 = 458.0;

pub fn read(path: &Path) -> TrackedWalk {
    let lines = lines(path);
    let mut meta = BTreeMap::new();
    let mut frames: Vec<TrackedFrame> = Vec::new();
    let mut imu = Vec::new();
    for line in &lines[1..] {
        let words: Vec<&str> = line.split(',').collect();
        match words[0] {
            "meta" => {
                meta.insert(words[20].to_owned(), words[21].to_owned());
            }
            "vision_feature" => {
                let time = Timestamp::from_secs_f64(number(words[1]));
                if frames.last().is_none_or(|f| f.time != time) {
                    frames.push(TrackedFrame {
                        time,
                        sights: Vec::new(),
                    });
                }
                let sights = &mut frames.last_mut().expect("a frame").sights;
                sights.push(Sight {
                    track: words[5].parse().expect("a number"),
                    camera: 0,
                    pixel: Vector2::new(number(words[18]), number(words[19])) * FOCAL_PX,
                });
            }
            "imu" => {
                let [gx, gy, gz, ax, ay, az] = [6, 7, 8, 9, 10, 11].map(|k| number(words[k]));
                let time = Timestamp::from_secs_f64(number(words[1]));
                imu.push(sample(time.nanos(), [gx, gy, gz], [ax, ay, az]));
            }
            other => panic!("a row of {other}"),
        }
    }
    let of = |name: &str| number(&meta[&format!("T_ci_{name}")]);
    let rotation = Quaternion::new(of("qw"), of("qx"), of("qy"), of("qz"));
    let camera = RigCamera {
        camera: Camera::pinhole(752, 480, [FOCAL_PX; 2], [0.0; 2]),
        rig_from_camera: Se3::new(
            UnitQuaternion::new_normalize(rotation),
            Vector3::new(of("tx"), of("ty"), of("tz")),
        ),
        timing: Default::default(),
        sigmas: Default::default(),
    };
    TrackedWalk {
        cameras: vec![camera],
        frames,
        imu,
        // As EuRoC's sensor.yaml states it.
        noise: ImuNoiseModel {
            gyro_noise_density: 1.6968e-4,
            accel_noise_density: 2.0e-3,
            gyro_bias_walk: 1.9393e-5,
            accel_bias_walk: 3.0e-3,
        },
        views: Vec::new(),
    }
}
