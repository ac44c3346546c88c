//! Folders of TUM VI: images of two fisheye cameras, an IMU and motion capture.

use std::ops::Range;
use std::path::Path;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{
    Camera, ImuNoiseModel, Matrix3, RigCamera, Se3, StampedPose, Trajectory, UnitQuaternion,
    Vector3,
};
use lsfb_perception::image;
use lsfb_pipeline::ground_truth::{FrontEnd, RevisitConfig, TrackedWalk};
use lsfb_types::{Image, ImuSample, Stamped, Timestamp};
use nalgebra::Quaternion;
use serde_json::Value;

use super::table::number;
use super::vimap::sample;

const KEYFRAME_SECS: f64 = 0.1;

/// What of a recording is shown to a walk.
pub struct Shown {
    /// So many of the cameras.
    pub cameras: usize,
    /// Until so long after the first image, seconds.
    pub until_secs: f64,
    /// When it is dark, seconds after the first image.
    pub dark_secs: Range<f64>,
}

impl Shown {
    /// All of it, by some cameras.
    pub fn all(cameras: usize) -> Self {
        Self {
            cameras,
            until_secs: f64::INFINITY,
            dark_secs: 0.0..0.0,
        }
    }
}

/// The walk as seen by the first cameras, and where the IMU was.
pub fn read(folder: &Path, calibration: &Path, shown: &Shown) -> (TrackedWalk, Trajectory) {
    let cameras = shown.cameras;
    let data = folder.join("mav0");
    let calibration = std::fs::read_to_string(calibration).expect("a calibration");
    let calibration: Value = serde_json::from_str(&calibration).expect("JSON");
    let rig: Vec<RigCamera> = (0..cameras)
        .map(|k| camera(&calibration[format!("cam{k}")]))
        .collect();
    let noise = &calibration["imu_noise"];
    let of = |name: &str| noise[name].as_f64().expect("a number");
    let noise = ImuNoiseModel {
        gyro_noise_density: of("gyro_density"),
        accel_noise_density: of("acc_density"),
        gyro_bias_walk: of("gyro_walk"),
        accel_bias_walk: of("acc_walk"),
    };
    let inertial = data.join("imu0/data.csv");
    let imu: Vec<Stamped<ImuSample>> = table(&inertial)
        .map(|(ns, v)| sample(ns, [v[0], v[1], v[2]], [v[3], v[4], v[5]]))
        .collect();
    let mocap = data.join("mocap0/data.csv");
    let truth = table(&mocap).map(|(ns, v)| StampedPose {
        time: Timestamp::from_nanos(ns),
        world_from_rig: Se3::new(
            UnitQuaternion::new_normalize(Quaternion::new(v[3], v[4], v[5], v[6])),
            Vector3::new(v[0], v[1], v[2]),
        ),
    });
    let truth = Trajectory::new(truth.collect());
    let mut stamps: Vec<i64> = std::fs::read_dir(data.join("cam0/data"))
        .expect("images")
        .map(|entry| {
            let name = entry.expect("an entry").file_name();
            let name = name.to_string_lossy().into_owned();
            name.trim_end_matches(".jpg").parse().expect("a stamp")
        })
        .collect();
    stamps.sort_unstable();
    let front_end = FrontEnd::new(rig, imu, noise, KEYFRAME_SECS);
    let front_end = front_end.keeping_views(&RevisitConfig::default());
    let mut front_end = front_end.expect("settings");
    let first = stamps.first().copied().unwrap_or(0);
    for ns in stamps {
        let secs = (ns - first) as f64 * 1e-9;
        if secs > shown.until_secs {
            break;
        }
        let mut images: Vec<Option<Image>> = (0..cameras)
            .map(|k| image::read(&data.join(format!("cam{k}/data/{ns}.jpg"))).ok())
            .collect();
        if shown.dark_secs.contains(&secs) {
            let all = images.iter_mut().flatten();
            all.for_each(|image| image.pixels.fill(0));
        }
        let images: Vec<Option<&Image>> = images.iter().map(Option::as_ref).collect();
        front_end.push(Timestamp::from_nanos(ns), &images);
    }
    (front_end.finish(), truth)
}

fn camera(value: &Value) -> RigCamera {
    let all = |value: &Value| -> Vec<f64> {
        let numbers = value.as_array().expect("a list").iter();
        numbers.map(|v| v.as_f64().expect("a number")).collect()
    };
    let (f, k) = (all(&value["intrinsics"]), all(&value["k"]));
    let m: Vec<f64> = value["T_cam_imu"].as_array().expect("rows")[..3]
        .iter()
        .flat_map(all)
        .collect();
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let camera_from_rig = Se3::new(
        UnitQuaternion::from_matrix(&rotation),
        Vector3::new(m[3], m[7], m[11]),
    );
    RigCamera {
        camera: Camera {
            width: 512,
            height: 512,
            lens: Lens::KannalaBrandt {
                focal_px: [f[0], f[1]],
                principal_px: [f[2], f[3]],
                distortion: [k[0], k[1], k[2], k[3]],
            },
        },
        rig_from_camera: camera_from_rig.inverse(),
        timing: Default::default(),
        sigmas: Default::default(),
    }
}

/// Nanoseconds and the numbers behind them.
fn table(path: &Path) -> impl Iterator<Item = (i64, Vec<f64>)> {
    let text = std::fs::read_to_string(path).expect("a table");
    let rows: Vec<(i64, Vec<f64>)> = text
        .lines()
        .filter(|line| !line.starts_with('#') && !line.trim().is_empty())
        .map(|line| {
            let mut words = line.split(',');
            let ns = words
                .next()
                .expect("a stamp")
                .trim()
                .parse()
                .expect("nanoseconds");
            (ns, words.map(number).collect())
        })
        .collect();
    rows.into_iter()
}
