//! Basalt's calibration file.

use lsfb_geometry::camera::{Lens, LensModel};
use lsfb_geometry::{Camera, ImuNoiseModel, Rig, Se3, Vector3};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::{
    Exported, ExportedFile, ImportedRig, PosesOf, checked, in_model, mounted, not_used,
    parse_error, quaternion,
};
use crate::Error;

#[derive(Deserialize)]
struct File {
    value0: Calibration,
    #[serde(flatten)]
    others: Map<String, Value>,
}

#[derive(Deserialize)]
struct Calibration {
    #[serde(rename = "T_imu_cam")]
    imu_from_camera: Vec<Pose>,
    intrinsics: Vec<Intrinsics>,
    resolution: Vec<[u32; 2]>,
    #[serde(default)]
    accel_noise_std: Vec<f64>,
    #[serde(default)]
    gyro_noise_std: Vec<f64>,
    #[serde(default)]
    accel_bias_std: Vec<f64>,
    #[serde(default)]
    gyro_bias_std: Vec<f64>,
    #[serde(default)]
    cam_time_offset_ns: i64,
    #[serde(default)]
    calib_accel_bias: Vec<f64>,
    #[serde(default)]
    calib_gyro_bias: Vec<f64>,
    #[serde(default)]
    vignette: Vec<Value>,
    /// Rate of the IMU, and where cameras overlap: nothing that a rig says.
    #[serde(rename = "imu_update_rate")]
    _imu_rate_hz: Option<f64>,
    #[serde(flatten)]
    others: Map<String, Value>,
}

impl Calibration {
    /// What a rig does not hold.
    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let mut biases = self.calib_accel_bias.iter().chain(&self.calib_gyro_bias);
        if biases.any(|b| *b != 0.0) {
            notes.push(
                "a rig cannot hold bias, scale and misalignment of the IMU (calib_accel_bias, calib_gyro_bias): correct its samples before they are recorded".to_owned(),
            );
        }
        let noises = [
            &self.accel_noise_std,
            &self.gyro_noise_std,
            &self.accel_bias_std,
            &self.gyro_bias_std,
        ];
        let uneven = |axes: &Vec<f64>| axes.windows(2).any(|w| w[0] != w[1]);
        if noises.into_iter().any(uneven) {
            notes.push(
                "a rig has one noise for all three axes: their root mean square is used".to_owned(),
            );
        }
        let is_zero = |value: &Value| value.as_f64() == Some(0.0);
        let others = self.others.iter().filter(|(_, value)| !is_zero(value));
        let names: Vec<&str> = others.map(|(name, _)| name.as_str()).collect();
        if !names.is_empty() {
            notes.push(not_used("value0", &names));
        }
        if !self.vignette.is_empty() {
            notes.push("a rig cannot hold vignettes".to_owned());
        }
        notes
    }
}

#[derive(Serialize, Deserialize)]
struct Pose {
    px: f64,
    py: f64,
    pz: f64,
    qx: f64,
    qy: f64,
    qz: f64,
    qw: f64,
    #[serde(flatten)]
    others: Map<String, Value>,
}

#[derive(Deserialize)]
struct Intrinsics {
    camera_type: String,
    intrinsics: Map<String, Value>,
    #[serde(flatten)]
    others: Map<String, Value>,
}

impl Intrinsics {
    /// Names of the distortion parameters of its camera type.
    fn distortion_names(&self) -> Option<&'static [&'static str]> {
        Some(match self.camera_type.as_str() {
            "pinhole" => &[],
            "pinhole-radtan8" => &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
            "kb4" => &["k1", "k2", "k3", "k4"],
            "ds" => &["xi", "alpha"],
            "eucm" => &["alpha", "beta"],
            "ucm" => &["alpha"],
            "fov" => &["w"],
            _ => return None,
        })
    }

    /// What of it makes no lens. A zero changes nothing, and how far from the middle a polynomial holds (`rpmax`) follows from it.
    fn not_read(&self) -> Vec<&str> {
        let read = self.distortion_names().unwrap_or_default();
        let is_read = |name: &str| {
            matches!(name, "fx" | "fy" | "cx" | "cy" | "rpmax") || read.contains(&name)
        };
        let values = self
            .intrinsics
            .iter()
            .filter(|(name, value)| !is_read(name) && value.as_f64() != Some(0.0));
        let others = self.others.keys().map(String::as_str);
        values
            .map(|(name, _)| name.as_str())
            .chain(others)
            .collect()
    }
}

/// Reads a calibration; `path` names it in errors.
pub fn import_basalt(text: &str, path: &str) -> Result<ImportedRig, Error> {
    let file: File = serde_json::from_str(text).map_err(|e| parse_error(path, e))?;
    let c = file.value0;
    let count = c.intrinsics.len();
    if count == 0 || c.resolution.len() != count || c.imu_from_camera.len() != count {
        return Err(parse_error(
            path,
            format!(
                "{} T_imu_cam, {count} intrinsics and {} resolutions: their numbers must be equal",
                c.imu_from_camera.len(),
                c.resolution.len()
            ),
        ));
    }
    let mut rig = Rig::empty("basalt");
    let mut notes = Vec::new();
    for (k, ((pose, intrinsics), size)) in c
        .imu_from_camera
        .iter()
        .zip(&c.intrinsics)
        .zip(&c.resolution)
        .enumerate()
    {
        let name = format!("cam{k}");
        let fail = |problem: String| parse_error(path, format!("{name}: {problem}"));
        let rotation = quaternion([pose.qw, pose.qx, pose.qy, pose.qz])
            .ok_or_else(|| fail("the norm of its quaternion is not 1".to_owned()))?;
        let camera = checked(Camera {
            width: size[0],
            height: size[1],
            lens: lens(intrinsics).map_err(fail)?,
        })
        .map_err(fail)?;
        let mut not_read = intrinsics.not_read();
        not_read.extend(pose.others.keys().map(String::as_str));
        if !not_read.is_empty() {
            notes.push(not_used(&name, &not_read));
        }
        let pose = Se3::new(rotation, Vector3::new(pose.px, pose.py, pose.pz));
        let mut mounted = mounted(camera, pose);
        mounted.timing.rig_from_camera_s = c.cam_time_offset_ns as f64 * 1e-9;
        rig.cameras.insert(name, mounted);
    }
    // Three axes each; a rig has one number.
    let mean = |axes: &[f64]| {
        let squares: f64 = axes.iter().map(|a| a * a).sum();
        (!axes.is_empty()).then(|| (squares / axes.len() as f64).sqrt())
    };
    let noise = [
        mean(&c.gyro_noise_std),
        mean(&c.accel_noise_std),
        mean(&c.gyro_bias_std),
        mean(&c.accel_bias_std),
    ];
    match noise {
        [Some(gyro), Some(accel), Some(gyro_walk), Some(accel_walk)] => {
            rig.set_imu_noise(ImuNoiseModel {
                gyro_noise_density: gyro,
                accel_noise_density: accel,
                gyro_bias_walk: gyro_walk,
                accel_bias_walk: accel_walk,
            });
        }
        [None, None, None, None] => {}
        _ => notes.push(
            "the noise of the IMU is not used: one of gyro_noise_std, accel_noise_std, gyro_bias_std and accel_bias_std is missing".to_owned(),
        ),
    }
    notes.extend(c.notes());
    if !file.others.is_empty() {
        let names: Vec<&str> = file.others.keys().map(String::as_str).collect();
        notes.push(not_used(path, &names));
    }
    Ok(ImportedRig {
        rig,
        poses: PosesOf::Imu,
        notes,
    })
}

fn lens(camera: &Intrinsics) -> Result<Lens, String> {
    let get = |name: &str| {
        camera
            .intrinsics
            .get(name)
            .and_then(Value::as_f64)
            .ok_or_else(|| format!("{} has no number {name}", camera.camera_type))
    };
    let focal_px = [get("fx")?, get("fy")?];
    let principal_px = [get("cx")?, get("cy")?];
    let names = camera
        .distortion_names()
        .ok_or_else(|| format!("camera_type {} is not supported", camera.camera_type))?;
    let values: Vec<f64> = names
        .iter()
        .map(|name| get(name))
        .collect::<Result<_, _>>()?;
    Ok(match (camera.camera_type.as_str(), values.as_slice()) {
        ("kb4", &[k1, k2, k3, k4]) => Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [k1, k2, k3, k4],
        },
        ("ds", &[xi, alpha]) => Lens::DoubleSphere {
            focal_px,
            principal_px,
            distortion: [xi, alpha],
        },
        ("eucm", &[alpha, beta]) => Lens::ExtendedUnified {
            focal_px,
            principal_px,
            distortion: [alpha, beta],
        },
        // Unified: the extended one of an unstretched sphere.
        ("ucm", &[alpha]) => Lens::ExtendedUnified {
            focal_px,
            principal_px,
            distortion: [alpha, 1.0],
        },
        ("fov", &[w]) => Lens::FieldOfView {
            focal_px,
            principal_px,
            distortion: [w],
        },
        ("pinhole-radtan8", &[k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]) => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [k1, k2, p1, p2, k3],
        },
        ("pinhole", []) => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [0.0; 5],
        },
        _ => return Err("rational distortion with k4 to k6 is not supported".to_owned()),
    })
}

pub(super) fn export(rig: &Rig, imu_rate_hz: f64) -> Exported {
    let mut out = Exported::default();
    let mut intrinsics = Vec::new();
    let mut poses = Vec::new();
    let mut resolution = Vec::new();
    for (k, (name, mounted)) in rig.cameras.iter().enumerate() {
        if *name != format!("cam{k}") {
            out.notes.push(format!("{name} is cam{k} in this file"));
        }
        let camera = in_model(
            name,
            &mounted.camera,
            &[
                LensModel::PinholeRadtan,
                LensModel::KannalaBrandt,
                LensModel::DoubleSphere,
                LensModel::ExtendedUnified,
                LensModel::FieldOfView,
            ],
            LensModel::KannalaBrandt,
            &mut out.notes,
        );
        let (kind, names): (&str, &[&str]) = match camera.lens {
            Lens::PinholeRadtan { .. } => ("pinhole-radtan8", &["k1", "k2", "p1", "p2", "k3"]),
            Lens::KannalaBrandt { .. } => ("kb4", &["k1", "k2", "k3", "k4"]),
            Lens::DoubleSphere { .. } => ("ds", &["xi", "alpha"]),
            Lens::ExtendedUnified { .. } => ("eucm", &["alpha", "beta"]),
            Lens::FieldOfView { .. } => ("fov", &["w"]),
        };
        let ([fx, fy], [cx, cy]) = (camera.focal_px(), camera.principal_px());
        let mut values = Map::new();
        for (key, value) in [("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)] {
            values.insert(key.to_owned(), json!(value));
        }
        for (key, value) in names.iter().zip(camera.lens.distortion()) {
            values.insert((*key).to_owned(), json!(value));
        }
        if kind == "pinhole-radtan8" {
            for key in ["k4", "k5", "k6", "rpmax"] {
                values.insert(key.to_owned(), json!(0.0));
            }
        }
        intrinsics.push(json!({ "camera_type": kind, "intrinsics": values }));
        let (t, q) = (
            mounted.rig_from_camera.translation,
            mounted.rig_from_camera.rotation.coords,
        );
        poses.push(Pose {
            px: t.x,
            py: t.y,
            pz: t.z,
            qx: q.x,
            qy: q.y,
            qz: q.z,
            qw: q.w,
            others: Map::new(),
        });
        resolution.push([camera.width, camera.height]);
    }
    let offsets: Vec<f64> = rig
        .cameras
        .values()
        .map(|c| c.timing.rig_from_camera_s)
        .collect();
    let mean_s = offsets.iter().sum::<f64>() / offsets.len().max(1) as f64;
    let apart_s = offsets
        .iter()
        .map(|o| (o - mean_s).abs())
        .fold(0.0, f64::max);
    if apart_s > 1e-6 {
        out.notes.push(format!(
            "Basalt has a single time offset: the mean is written; cameras differ from it by up to {:.0} µs",
            apart_s * 1e6
        ));
    }
    let offset_ns = (mean_s * 1e9).round() as i64;
    if offset_ns != 0 {
        out.notes.push(format!(
            "Basalt's calibration applies the time offset, but its odometry does not: for odometry, add {offset_ns} ns to the image stamps"
        ));
    }
    let mut value = json!({
        "T_imu_cam": poses,
        "intrinsics": intrinsics,
        "resolution": resolution,
        "calib_accel_bias": vec![0.0; 9],
        "calib_gyro_bias": vec![0.0; 12],
        "imu_update_rate": imu_rate_hz,
        "cam_time_offset_ns": offset_ns,
        "vignette": Vec::<f64>::new(),
    });
    match rig.imu_noise() {
        Some(imu) => {
            for (key, noise) in [
                ("accel_noise_std", imu.accel_noise_density),
                ("gyro_noise_std", imu.gyro_noise_density),
                ("accel_bias_std", imu.accel_bias_walk),
                ("gyro_bias_std", imu.gyro_bias_walk),
            ] {
                value[key] = json!(vec![noise; 3]);
            }
        }
        None => out
            .notes
            .push("the rig has no IMU: add the noise that Basalt needs".to_owned()),
    }
    // Names and numbers: nothing in it can fail.
    let text = serde_json::to_string_pretty(&json!({ "value0": value })).unwrap_or_default();
    out.files.push(ExportedFile {
        name: "calibration.json".to_owned(),
        text: text + "\n",
    });
    out
}
