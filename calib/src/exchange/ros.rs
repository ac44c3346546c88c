//! ROS `CameraInfo`: the file of `camera_calibration`, and the message as `ros2 topic echo` prints it.

use lsfb_geometry::camera::{Lens, LensModel};
use lsfb_geometry::{Camera, Rig};
use serde::Deserialize;

use super::{Exported, ExportedFile, checked, in_model, list, parse_error};
use crate::Error;

#[derive(Deserialize)]
struct Matrix {
    data: Vec<f64>,
}

/// The keys of both forms; ROS 1 wrote those of the message in capitals.
#[derive(Deserialize)]
struct Info {
    #[serde(alias = "image_width")]
    width: u32,
    #[serde(alias = "image_height")]
    height: u32,
    camera_name: Option<String>,
    distortion_model: String,
    camera_matrix: Option<Matrix>,
    distortion_coefficients: Option<Matrix>,
    #[serde(alias = "K")]
    k: Option<Vec<f64>>,
    #[serde(alias = "D")]
    d: Option<Vec<f64>>,
    projection_matrix: Option<Matrix>,
    #[serde(alias = "P")]
    p: Option<Vec<f64>>,
}

/// A camera from a `CameraInfo`.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedCamera {
    /// Its name, where the file has one.
    pub name: Option<String>,
    /// Size and lens.
    pub camera: Camera,
    /// What is in the file that a rig does not hold, in words.
    pub notes: Vec<String>,
}

/// Reads a `CameraInfo`; `path` names it in errors.
pub fn import_camera_info(text: &str, path: &str) -> Result<ImportedCamera, Error> {
    let info: Info = serde_norway::from_str(text).map_err(|e| parse_error(path, e))?;
    let fail = |problem: String| parse_error(path, problem);
    let k = info
        .camera_matrix
        .map(|m| m.data)
        .or(info.k)
        .unwrap_or_default();
    let d = info
        .distortion_coefficients
        .map(|m| m.data)
        .or(info.d)
        .unwrap_or_default();
    if k.len() != 9 {
        return Err(fail(format!(
            "{} numbers in the camera matrix, expected 9",
            k.len()
        )));
    }
    if k[1] != 0.0 {
        return Err(fail(format!(
            "the camera matrix has skew {}, which no lens here has",
            k[1]
        )));
    }
    let focal_px = [k[0], k[4]];
    let principal_px = [k[2], k[5]];
    let at = |i: usize| d.get(i).copied().unwrap_or(0.0);
    let beyond = |n: usize| d.iter().skip(n).any(|x| *x != 0.0);
    let lens = match info.distortion_model.as_str() {
        "plumb_bob" | "rational_polynomial" | "" if !beyond(5) => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [at(0), at(1), at(2), at(3), at(4)],
        },
        "plumb_bob" | "rational_polynomial" => {
            return Err(fail(
                "rational distortion with k4 to k6 is not known: calibrate with `lsfb calib camera`".to_owned(),
            ));
        }
        "equidistant" | "fisheye" if d.len() == 4 => Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [d[0], d[1], d[2], d[3]],
        },
        other => {
            return Err(fail(format!(
                "distortion_model {other} with {} coefficients is not known: plumb_bob and equidistant are",
                d.len()
            )));
        }
    };
    let camera = checked(Camera {
        width: info.width,
        height: info.height,
        lens,
    })
    .map_err(fail)?;
    let p = info.projection_matrix.map(|m| m.data).or(info.p);
    let mut notes = Vec::new();
    // That of the second camera of a rectified pair is −fx times their distance.
    if let Some(shift) = p.and_then(|p| p.get(3).copied()).filter(|t| *t != 0.0) {
        notes.push(format!(
            "{path}: the projection matrix of a rectified pair ({shift} in its fourth column) is not read: poses of cameras come from `lsfb calib camera`"
        ));
    }
    Ok(ImportedCamera {
        name: info.camera_name,
        camera,
        notes,
    })
}

pub(super) fn export(rig: &Rig) -> Exported {
    let mut out = Exported::default();
    for (name, mounted) in &rig.cameras {
        let camera = in_model(
            name,
            &mounted.camera,
            &[LensModel::PinholeRadtan, LensModel::KannalaBrandt],
            LensModel::KannalaBrandt,
            &mut out.notes,
        );
        let model = match camera.lens {
            Lens::PinholeRadtan { .. } => "plumb_bob",
            _ => "equidistant",
        };
        let ([fx, fy], [cx, cy]) = (camera.focal_px(), camera.principal_px());
        let d = camera.lens.distortion();
        let k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
        let r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
        let matrix = |rows: usize, columns: usize, data: &[f64]| {
            format!(
                "\n  rows: {rows}\n  cols: {columns}\n  data: {}\n",
                list(data)
            )
        };
        let text = format!(
            "image_width: {}\nimage_height: {}\ncamera_name: {name}\ncamera_matrix:{}distortion_model: {model}\ndistortion_coefficients:{}rectification_matrix:{}projection_matrix:{}",
            camera.width,
            camera.height,
            matrix(3, 3, &k),
            matrix(1, d.len(), d),
            matrix(3, 3, &r),
            matrix(3, 4, &p)
        );
        out.files.push(ExportedFile {
            name: format!("{name}.yaml"),
            text,
        });
    }
    out.notes
        .push("poses and time offsets have no place in CameraInfo".to_owned());
    out
}
