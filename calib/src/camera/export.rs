//! A calibration as a rig, and as Kalibr's camera chain.

use std::fmt::Write as _;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, Rig, RigCamera, Se3};

use super::CameraCalibration;

impl CameraCalibration {
    /// The cameras put into `rig`: those it has already keep the first one's pose on the rig and get lenses and poses to each
    /// other from here. In an empty rig the first camera is the origin.
    pub fn put_into(&self, rig: &mut Rig) {
        let rig_from_first = self
            .cameras
            .first()
            .and_then(|c| rig.cameras.get(&c.name))
            .map_or_else(Se3::identity, |c| c.rig_from_camera);
        for calibrated in &self.cameras {
            let timing = rig
                .cameras
                .get(&calibrated.name)
                .map_or_else(Default::default, |c| c.timing);
            rig.cameras.insert(
                calibrated.name.clone(),
                RigCamera {
                    camera: calibrated.camera,
                    rig_from_camera: rig_from_first * calibrated.camera_from_first.inverse(),
                    timing,
                },
            );
        }
    }

    /// Kalibr's camchain YAML. Kalibr's radtan has four coefficients: a `k3` is left out there.
    pub fn to_kalibr(&self) -> String {
        let mut text = String::new();
        for (k, calibrated) in self.cameras.iter().enumerate() {
            // Infallible on a String.
            let _ = writeln!(text, "cam{k}:");
            if k > 0 {
                let before = &self.cameras[k - 1].camera_from_first;
                let matrix = calibrated.camera_from_first * before.inverse();
                text.push_str("  T_cn_cnm1:\n");
                let (r, t) = (matrix.rotation_matrix(), matrix.translation);
                for row in 0..3 {
                    let row = [r[(row, 0)], r[(row, 1)], r[(row, 2)], t[row]];
                    let _ = writeln!(text, "  - {}", list(&row));
                }
                text.push_str("  - [0.0, 0.0, 0.0, 1.0]\n");
            }
            text += &kalibr_camera(&calibrated.name, &calibrated.camera);
        }
        text
    }
}

fn list(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(|v| format!("{v:?}")).collect();
    format!("[{}]", words.join(", "))
}

/// Lens, size and topic as lines of a camera in Kalibr's chain.
pub(crate) fn kalibr_camera(name: &str, camera: &Camera) -> String {
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
