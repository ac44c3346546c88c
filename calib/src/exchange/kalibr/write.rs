//! Kalibr's files from a rig.

use std::fmt::Write as _;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, ImuNoiseModel, Rig, Se3};

use crate::exchange::{Exported, ExportedFile, deviation_px, exact, list, radtan};

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

pub(in crate::exchange) fn export(rig: &Rig, imu_rate_hz: f64) -> Exported {
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
