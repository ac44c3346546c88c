//! Kalibr's camera chain and IMU files.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, ImuNoiseModel, Matrix3, Rig, Se3, Vector3};
use serde::Deserialize;

use super::{
    Exported, ExportedFile, checked, deviation_px, exact, list, mounted, parse_error, radtan,
    rotation,
};
use crate::Error;

#[derive(Deserialize)]
struct Link {
    camera_model: String,
    intrinsics: Vec<f64>,
    distortion_model: Option<String>,
    #[serde(default)]
    distortion_coeffs: Vec<f64>,
    resolution: [u32; 2],
    #[serde(rename = "T_cam_imu")]
    camera_from_imu: Option<[[f64; 4]; 4]>,
    #[serde(rename = "T_cn_cnm1")]
    camera_from_before: Option<[[f64; 4]; 4]>,
    #[serde(default)]
    timeshift_cam_imu: f64,
}

#[derive(Deserialize)]
struct ImuFile {
    accelerometer_noise_density: f64,
    accelerometer_random_walk: f64,
    gyroscope_noise_density: f64,
    gyroscope_random_walk: f64,
}

/// Reads a camera chain, with or without the IMU; `path` names it in errors. Without `T_cam_imu` the first camera is the
/// origin.
pub fn import_kalibr(text: &str, path: &str) -> Result<Rig, Error> {
    let chain: BTreeMap<String, Link> =
        serde_norway::from_str(text).map_err(|e| parse_error(path, e))?;
    let mut links: Vec<(u32, Link)> = Vec::new();
    for (name, link) in chain {
        let number = name.strip_prefix("cam").and_then(|n| n.parse().ok());
        let number = number
            .ok_or_else(|| parse_error(path, format!("{name}: expected cam0, cam1 and so on")))?;
        links.push((number, link));
    }
    links.sort_by_key(|l| l.0);
    let mut rig = Rig::empty("kalibr");
    let mut before: Option<Se3> = None;
    for (number, link) in links {
        let name = format!("cam{number}");
        let fail = |problem: String| parse_error(path, format!("{name}: {problem}"));
        let camera = camera(&link).map_err(fail)?;
        let rig_from_camera = match (&link.camera_from_imu, &link.camera_from_before, before) {
            (Some(rows), _, _) => pose(rows)
                .map_err(|p| fail(format!("T_cam_imu {p}")))?
                .inverse(),
            (None, Some(rows), Some(before)) => {
                before
                    * pose(rows)
                        .map_err(|p| fail(format!("T_cn_cnm1 {p}")))?
                        .inverse()
            }
            (None, None, None) => Se3::identity(),
            _ => {
                return Err(fail(
                    "neither T_cam_imu nor T_cn_cnm1 joins it to the camera before".to_owned(),
                ));
            }
        };
        before = Some(rig_from_camera);
        let mut mounted = mounted(camera, rig_from_camera);
        mounted.timing.rig_from_camera_s = link.timeshift_cam_imu;
        rig.cameras.insert(name, mounted);
    }
    if rig.cameras.is_empty() {
        return Err(parse_error(path, "no camera in it"));
    }
    Ok(rig)
}

/// Reads the noise of an IMU.
pub fn import_kalibr_imu(text: &str, path: &str) -> Result<ImuNoiseModel, Error> {
    // Older files are flat, those of the calibration itself name the IMU first.
    let nested: Result<BTreeMap<String, ImuFile>, _> = serde_norway::from_str(text);
    let file = match nested.ok().and_then(|n| n.into_values().next()) {
        Some(file) => file,
        None => serde_norway::from_str(text).map_err(|e| parse_error(path, e))?,
    };
    Ok(ImuNoiseModel {
        gyro_noise_density: file.gyroscope_noise_density,
        accel_noise_density: file.accelerometer_noise_density,
        gyro_bias_walk: file.gyroscope_random_walk,
        accel_bias_walk: file.accelerometer_random_walk,
    })
}

fn pose(rows: &[[f64; 4]; 4]) -> Result<Se3, String> {
    let turn = Matrix3::from_fn(|i, j| rows[i][j]);
    let rotation = rotation(&turn).ok_or("is no rigid transform")?;
    let translation = Vector3::from_fn(|i, _| rows[i][3]);
    Ok(Se3::new(rotation, translation))
}

fn camera(link: &Link) -> Result<Camera, String> {
    let distortion_model = link.distortion_model.as_deref().unwrap_or("none");
    let expect = |values: &[f64], n: usize, what: &str| {
        if values.len() == n {
            Ok(())
        } else {
            Err(format!("{} {what}, expected {n}", values.len()))
        }
    };
    let own = match link.camera_model.as_str() {
        "pinhole" => 0,
        "ds" | "eucm" => 2,
        other => {
            return Err(format!(
                "camera_model {other} is not known: pinhole, ds and eucm are"
            ));
        }
    };
    expect(&link.intrinsics, own + 4, "intrinsics")?;
    let (shape, pinhole) = link.intrinsics.split_at(own);
    let focal_px = [pinhole[0], pinhole[1]];
    let principal_px = [pinhole[2], pinhole[3]];
    let d = &link.distortion_coeffs;
    let lens = match (link.camera_model.as_str(), distortion_model) {
        ("ds", "none") => Lens::DoubleSphere {
            focal_px,
            principal_px,
            distortion: [shape[0], shape[1]],
        },
        ("eucm", "none") => Lens::ExtendedUnified {
            focal_px,
            principal_px,
            distortion: [shape[0], shape[1]],
        },
        ("pinhole", "none") => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [0.0; 5],
        },
        ("pinhole", "radtan") => {
            expect(d, 4, "distortion_coeffs")?;
            Lens::PinholeRadtan {
                focal_px,
                principal_px,
                distortion: [d[0], d[1], d[2], d[3], 0.0],
            }
        }
        ("pinhole", "equidistant") => {
            expect(d, 4, "distortion_coeffs")?;
            Lens::KannalaBrandt {
                focal_px,
                principal_px,
                distortion: [d[0], d[1], d[2], d[3]],
            }
        }
        ("pinhole", "fov") => {
            expect(d, 1, "distortion_coeffs")?;
            Lens::FieldOfView {
                focal_px,
                principal_px,
                distortion: [d[0]],
            }
        }
        (model, distortion) => {
            return Err(format!("{model} with distortion {distortion} is not known"));
        }
    };
    checked(Camera {
        width: link.resolution[0],
        height: link.resolution[1],
        lens,
    })
}

/// From what the cameras of a chain are posed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChainOrigin {
    /// The IMU: Kalibr's `camchain-imucam.yaml`, with time shifts.
    Imu,
    /// The first camera: Kalibr's `camchain.yaml`.
    FirstCamera,
}

/// Kalibr's camera chain of the named cameras of a rig, in that order, each joined to the one before; names that the rig does
/// not have are left out. Kalibr's radtan has four coefficients: a `k3` is left out.
pub fn camera_chain<'a>(
    rig: &Rig,
    names: impl IntoIterator<Item = &'a str>,
    origin: ChainOrigin,
) -> String {
    let known = names
        .into_iter()
        .filter_map(|name| Some((name, rig.cameras.get(name)?)));
    let mut text = String::new();
    let mut rig_from_before: Option<Se3> = None;
    for (k, (name, mounted)) in known.enumerate() {
        let camera_from_rig = mounted.rig_from_camera.inverse();
        // Writing to a String cannot fail.
        let _ = writeln!(text, "cam{k}:");
        if origin == ChainOrigin::Imu {
            text += &matrix("T_cam_imu", &camera_from_rig);
        }
        if let Some(rig_from_before) = rig_from_before {
            text += &matrix("T_cn_cnm1", &(camera_from_rig * rig_from_before));
        }
        rig_from_before = Some(mounted.rig_from_camera);
        text += &lens_lines(name, &mounted.camera);
        if origin == ChainOrigin::Imu {
            let shift_s = mounted.timing.rig_from_camera_s;
            let _ = writeln!(text, "  timeshift_cam_imu: {}", exact(shift_s));
        }
    }
    text
}

/// Lens, size and topic of a camera.
fn lens_lines(name: &str, camera: &Camera) -> String {
    let [f, c] = [camera.focal_px(), camera.principal_px()];
    let pinhole = [f[0], f[1], c[0], c[1]];
    let with = |first: &[f64]| [first, &pinhole].concat();
    let (model, intrinsics, distortion_model, distortion) = match camera.lens {
        Lens::PinholeRadtan {
            distortion: [k1, k2, p1, p2, _],
            ..
        } => ("pinhole", pinhole.to_vec(), "radtan", vec![k1, k2, p1, p2]),
        Lens::KannalaBrandt { distortion, .. } => (
            "pinhole",
            pinhole.to_vec(),
            "equidistant",
            distortion.to_vec(),
        ),
        Lens::FieldOfView { distortion, .. } => {
            ("pinhole", pinhole.to_vec(), "fov", distortion.to_vec())
        }
        Lens::DoubleSphere { distortion, .. } => ("ds", with(&distortion), "none", vec![]),
        Lens::ExtendedUnified { distortion, .. } => ("eucm", with(&distortion), "none", vec![]),
    };
    format!(
        "  camera_model: {model}\n  intrinsics: {}\n  distortion_model: {distortion_model}\n  distortion_coeffs: {}\n  resolution: [{}, {}]\n  rostopic: /{name}/image\n",
        list(&intrinsics),
        list(&distortion),
        camera.width,
        camera.height,
    )
}

fn matrix(name: &str, pose: &Se3) -> String {
    let (r, t) = (pose.rotation_matrix(), pose.translation);
    let mut text = format!("  {name}:\n");
    for row in 0..3 {
        let row = [r[(row, 0)], r[(row, 1)], r[(row, 2)], t[row]];
        text += &format!("  - {}\n", list(&row));
    }
    text + "  - [0.0, 0.0, 0.0, 1.0]\n"
}

/// Kalibr's `imu.yaml`.
pub fn imu_to_kalibr(noise: &ImuNoiseModel, rate_hz: f64, topic: &str) -> String {
    format!(
        "rostopic: {topic}\nupdate_rate: {}\naccelerometer_noise_density: {}\naccelerometer_random_walk: {}\ngyroscope_noise_density: {}\ngyroscope_random_walk: {}\n",
        exact(rate_hz),
        exact(noise.accel_noise_density),
        exact(noise.accel_bias_walk),
        exact(noise.gyro_noise_density),
        exact(noise.gyro_bias_walk)
    )
}

pub(super) fn export(rig: &Rig, imu_rate_hz: f64) -> Exported {
    let mut out = Exported::default();
    for (k, (name, mounted)) in rig.cameras.iter().enumerate() {
        let camera = &mounted.camera;
        if let Some([.., k3]) = radtan(&camera.lens).filter(|d| d[4] != 0.0) {
            let mut without = *camera;
            if let Lens::PinholeRadtan { distortion, .. } = &mut without.lens {
                distortion[4] = 0.0;
            }
            out.notes.push(format!(
                "{name}: Kalibr's radtan has no k3 ({k3}); without it pixels move by up to {:.2} px: calibrate with kannala-brandt instead",
                deviation_px(camera, &without)
            ));
        }
        if *name != format!("cam{k}") {
            out.notes.push(format!("{name} is cam{k} in these files"));
        }
    }
    out.files.push(ExportedFile {
        name: "camchain-imucam.yaml".to_owned(),
        text: camera_chain(
            rig,
            rig.cameras.keys().map(String::as_str),
            ChainOrigin::Imu,
        ),
    });
    if let Some(imu) = rig.imu_noise() {
        out.files.push(ExportedFile {
            name: "imu.yaml".to_owned(),
            text: imu_to_kalibr(imu, imu_rate_hz, "/imu0"),
        });
    }
    out
}
