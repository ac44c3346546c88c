//! Kalibr's camera chain and IMU files.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, ImuNoiseModel, Matrix3, Rig, Se3, Vector3};
use serde::Deserialize;

use super::omni::Omni;
use super::yaml::{self, Others};
use super::{
    Exported, ExportedFile, ImportedImu, ImportedRig, checked, deviation_px, exact, list, mounted,
    parse_error, radtan, rotation,
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
    /// OpenVINS writes this one.
    #[serde(rename = "T_imu_cam")]
    imu_from_camera: Option<[[f64; 4]; 4]>,
    #[serde(rename = "T_cn_cnm1")]
    camera_from_before: Option<[[f64; 4]; 4]>,
    #[serde(default)]
    timeshift_cam_imu: f64,
    /// Where its images come from, and which cameras see the same: nothing that a rig says.
    #[serde(rename = "rostopic")]
    _topic: Option<String>,
    #[serde(rename = "cam_overlaps")]
    _overlaps: Option<Vec<u32>>,
    #[serde(flatten)]
    others: Others,
}

#[derive(Deserialize)]
struct ImuFile {
    accelerometer_noise_density: f64,
    accelerometer_random_walk: f64,
    gyroscope_noise_density: f64,
    gyroscope_random_walk: f64,
    #[serde(rename = "rostopic")]
    _topic: Option<String>,
    #[serde(rename = "update_rate")]
    _rate_hz: Option<f64>,
    #[serde(flatten)]
    others: Others,
}

/// Difference of two poses in one file that is more than their rounding, `[rad, m]` together.
const SAME_POSE: f64 = 1e-3;

/// Reads a camera chain, with or without the IMU; `path` names it in errors. Where no pose to an IMU is given the first camera
/// is the origin.
pub fn import_kalibr(text: &str, path: &str) -> Result<ImportedRig, Error> {
    let chain: BTreeMap<String, Link> = yaml::read(text, path)?;
    let mut links: Vec<(u32, Link)> = Vec::new();
    for (name, link) in chain {
        let number = name.strip_prefix("cam").and_then(|n| n.parse().ok());
        let number = number
            .ok_or_else(|| parse_error(path, format!("{name}: expected cam0, cam1 and so on")))?;
        links.push((number, link));
    }
    links.sort_by_key(|l| l.0);
    let mut rig = Rig::empty("kalibr");
    let mut notes = Vec::new();
    let mut before: Option<Se3> = None;
    let has_imu = links.iter().any(|(_, l)| l.has_imu());
    for (number, link) in links {
        let name = format!("cam{number}");
        let fail = |problem: String| parse_error(path, format!("{name}: {problem}"));
        let (camera, miss_px) = camera(&link).map_err(fail)?;
        if miss_px > 0.0 {
            notes.push(format!(
                "{name}: the omni lens is read as {}, which misses it by up to {miss_px:.3} px",
                camera.lens.model().name()
            ));
        }
        let rig_from_camera = match (link.rig_from_camera(before).map_err(fail)?, before) {
            (Some(pose), _) => pose,
            (None, None) if !has_imu => {
                notes.push(format!(
                    "no pose to an IMU in it (T_cam_imu or T_imu_cam): {name} is the origin"
                ));
                Se3::identity()
            }
            _ => {
                return Err(fail(
                    "neither T_cam_imu, T_imu_cam nor T_cn_cnm1 says where it is".to_owned(),
                ));
            }
        };
        notes.extend(yaml::unused(&name, &link.others));
        before = Some(rig_from_camera);
        let mut mounted = mounted(camera, rig_from_camera);
        mounted.timing.rig_from_camera_s = link.timeshift_cam_imu;
        rig.cameras.insert(name, mounted);
    }
    if rig.cameras.is_empty() {
        return Err(parse_error(path, "no camera in it"));
    }
    Ok(ImportedRig { rig, notes })
}

impl Link {
    fn has_imu(&self) -> bool {
        self.camera_from_imu.is_some() || self.imu_from_camera.is_some()
    }

    /// The pose of the camera by whatever says it; `None` where nothing does. What says it twice must agree.
    fn rig_from_camera(&self, before: Option<Se3>) -> Result<Option<Se3>, String> {
        let read = |name: &'static str, rows: &Option<[[f64; 4]; 4]>| {
            let pose = rows.as_ref().map(pose).transpose();
            pose.map_err(|p| format!("{name} {p}"))
        };
        let said = [
            read("T_cam_imu", &self.camera_from_imu)?.map(|p| ("T_cam_imu", p.inverse())),
            read("T_imu_cam", &self.imu_from_camera)?.map(|p| ("T_imu_cam", p)),
            read("T_cn_cnm1", &self.camera_from_before)?
                .zip(before)
                .map(|(p, before)| ("T_cn_cnm1", before * p.inverse())),
        ];
        let mut said = said.into_iter().flatten();
        let Some((first, pose)) = said.next() else {
            return Ok(None);
        };
        for (other, again) in said {
            let off = (pose.inverse() * again).log();
            if off.norm() > SAME_POSE {
                return Err(format!(
                    "{first} and {other} contradict each other by {:.1}° and {:.1} mm: delete the wrong one",
                    off.fixed_rows::<3>(0).norm().to_degrees(),
                    off.fixed_rows::<3>(3).norm() * 1e3
                ));
            }
        }
        Ok(Some(pose))
    }
}

/// Reads the noise of an IMU: the file that Kalibr is given, which is flat, or that of its calibration, which names the IMU first.
pub fn import_kalibr_imu(text: &str, path: &str) -> Result<ImportedImu, Error> {
    let nested: Result<BTreeMap<String, ImuFile>, _> = yaml::read(text, path);
    let mut notes = Vec::new();
    let (name, file) = match nested.ok().map(BTreeMap::into_iter) {
        Some(mut imus) => {
            let first = imus
                .next()
                .ok_or_else(|| parse_error(path, "no IMU in it"))?;
            for (other, _) in imus {
                notes.push(format!(
                    "{other} is not used: a rig has one IMU, {} is taken",
                    first.0
                ));
            }
            first
        }
        None => ("imu".to_owned(), yaml::read(text, path)?),
    };
    let mut others = file.others;
    // An IMU whose axes are taken as they are.
    if others.get("model").and_then(|m| m.as_str()) == Some("calibrated") {
        others.remove("model");
    }
    notes.extend(yaml::unused(&name, &others));
    let noise = ImuNoiseModel {
        gyro_noise_density: file.gyroscope_noise_density,
        accel_noise_density: file.accelerometer_noise_density,
        gyro_bias_walk: file.gyroscope_random_walk,
        accel_bias_walk: file.accelerometer_random_walk,
    };
    Ok(ImportedImu { noise, notes })
}

fn pose(rows: &[[f64; 4]; 4]) -> Result<Se3, String> {
    let turn = Matrix3::from_fn(|i, j| rows[i][j]);
    let rotation = rotation(&turn).ok_or("is no rigid transform")?;
    let translation = Vector3::from_fn(|i, _| rows[i][3]);
    Ok(Se3::new(rotation, translation))
}

/// The camera, and by how much its lens misses the one in the file at most, pixels.
fn camera(link: &Link) -> Result<(Camera, f64), String> {
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
        "omni" => 1,
        "ds" | "eucm" => 2,
        other => {
            return Err(format!(
                "camera_model {other} is not known: pinhole, omni, ds and eucm are"
            ));
        }
    };
    expect(&link.intrinsics, own + 4, "intrinsics")?;
    let (shape, pinhole) = link.intrinsics.split_at(own);
    let focal_px = [pinhole[0], pinhole[1]];
    let principal_px = [pinhole[2], pinhole[3]];
    let d = &link.distortion_coeffs;
    let [width, height] = link.resolution;
    let mut miss_px = 0.0;
    let lens = match (link.camera_model.as_str(), distortion_model) {
        ("omni", "none" | "radtan") => {
            if distortion_model == "radtan" {
                expect(d, 4, "distortion_coeffs")?;
            }
            let omni = Omni {
                xi: shape[0],
                focal_px,
                principal_px,
                distortion: std::array::from_fn(|k| d.get(k).copied().unwrap_or(0.0)),
            };
            let (lens, miss) = omni.to_lens(width, height)?;
            miss_px = miss;
            lens
        }
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
    let camera = checked(Camera {
        width,
        height,
        lens,
    })?;
    Ok((camera, miss_px))
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
