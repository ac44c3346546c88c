//! ROS `CameraInfo`: the file of `camera_calibration`, and messages as `ros2 topic echo` prints them. OpenCV's own calibration
//! program writes the same keys.

use lsfb_geometry::camera::{Lens, LensModel};
use lsfb_geometry::{Camera, Rig};
use serde::Deserialize;

use super::yaml::{self, Others};
use super::{Exported, ExportedFile, checked, in_model, list, parse_error};
use crate::Error;

#[derive(Deserialize)]
struct Matrix {
    data: Vec<f64>,
}

/// The part of the sensor that images show, in its pixels; all of it where the size is zero.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Region {
    x_offset: u32,
    y_offset: u32,
    width: u32,
    height: u32,
    /// Whether images that were rectified already are meant.
    do_rectify: bool,
}

/// The keys of both forms; ROS 1 wrote those of the message in capitals.
#[derive(Deserialize)]
struct Info {
    #[serde(alias = "image_width")]
    width: u32,
    #[serde(alias = "image_height")]
    height: u32,
    camera_name: Option<String>,
    distortion_model: Option<String>,
    /// OpenCV's word for the distortion model.
    fisheye_model: Option<u8>,
    camera_matrix: Option<Matrix>,
    distortion_coefficients: Option<Matrix>,
    #[serde(alias = "K")]
    k: Option<Vec<f64>>,
    #[serde(alias = "D")]
    d: Option<Vec<f64>>,
    rectification_matrix: Option<Matrix>,
    #[serde(alias = "R")]
    r: Option<Vec<f64>>,
    projection_matrix: Option<Matrix>,
    #[serde(alias = "P")]
    p: Option<Vec<f64>>,
    #[serde(default)]
    binning_x: u32,
    #[serde(default)]
    binning_y: u32,
    #[serde(default)]
    roi: Region,
    /// Stamp and frame of one message.
    #[serde(rename = "header")]
    _header: Option<serde_norway::Value>,
    #[serde(flatten)]
    others: Others,
}

impl Info {
    /// The distortion model by the name that ROS has for it, and whether the file says so.
    fn distortion_model(&self) -> (&str, bool) {
        match (self.distortion_model.as_deref(), self.fisheye_model) {
            (Some(name), _) => (name, true),
            (None, Some(0)) => ("plumb_bob", true),
            (None, Some(_)) => ("equidistant", true),
            (None, None) => ("plumb_bob", false),
        }
    }
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
    let info: Info = yaml::read(text, path)?;
    let fail = |problem: String| parse_error(path, problem);
    let mut notes = Vec::new();
    if info.binning_x > 1 || info.binning_y > 1 {
        return Err(fail(format!(
            "binning of {} × {} pixels: the file does not say whether pixels are averaged or skipped, which shifts the image by up to half a pixel: calibrate images as they are recorded",
            info.binning_x, info.binning_y
        )));
    }
    let (model, is_said) = info.distortion_model();
    let model = model.to_owned();
    if !is_said {
        notes.push(format!(
            "{path}: it has no distortion_model: {model} is assumed"
        ));
    }
    let roi = &info.roi;
    if roi.do_rectify {
        notes.push(format!(
            "{path}: do_rectify is not used: a rig holds the lens of the unrectified images"
        ));
    }
    let is_cut = roi.width > 0 && roi.height > 0;
    let size = if is_cut {
        notes.push(format!(
            "{path}: the images are a region of {} × {} pixels from ({}, {}): the lens is for this region",
            roi.width, roi.height, roi.x_offset, roi.y_offset
        ));
        [roi.width, roi.height]
    } else {
        [info.width, info.height]
    };
    let corner = [roi.x_offset, roi.y_offset].map(f64::from);
    if !is_cut && corner != [0.0; 2] {
        return Err(fail("the region of interest has no size".to_owned()));
    }
    let is_inside = u64::from(roi.x_offset) + u64::from(size[0]) <= u64::from(info.width)
        && u64::from(roi.y_offset) + u64::from(size[1]) <= u64::from(info.height);
    if !is_inside {
        return Err(fail(format!(
            "region of interest of {} × {} pixels from ({}, {}) in an image of {} × {}",
            size[0], size[1], roi.x_offset, roi.y_offset, info.width, info.height
        )));
    }
    let k = one_of(["camera_matrix", "k"], info.camera_matrix, info.k)
        .map_err(fail)?
        .unwrap_or_default();
    let d = one_of(
        ["distortion_coefficients", "d"],
        info.distortion_coefficients,
        info.d,
    )
    .map_err(fail)?
    .unwrap_or_default();
    if k.len() != 9 {
        return Err(fail(format!(
            "{} numbers in the camera matrix, expected 9",
            k.len()
        )));
    }
    if k[1] != 0.0 {
        return Err(fail(format!(
            "the camera matrix has skew {}, which no lens model here supports",
            k[1]
        )));
    }
    if [k[3], k[6], k[7], k[8]] != [0.0, 0.0, 0.0, 1.0] {
        return Err(fail(format!(
            "the camera matrix is {}, expected fx, 0, cx, 0, fy, cy, 0, 0, 1; is it written column by column?",
            list(&k)
        )));
    }
    if d.is_empty() {
        notes.push(format!(
            "{path}: it has no distortion coefficients: a lens without distortion is assumed"
        ));
    }
    let focal_px = [k[0], k[4]];
    let principal_px = [k[2] - corner[0], k[5] - corner[1]];
    let at = |i: usize| d.get(i).copied().unwrap_or(0.0);
    let beyond = |n: usize| d.iter().skip(n).any(|x| *x != 0.0);
    let is_polynomial = matches!(model.as_str(), "plumb_bob" | "rational_polynomial" | "");
    // As many as OpenCV has; a list that was cut short is not read as zeros.
    if is_polynomial && ![0, 4, 5, 8, 12, 14].contains(&d.len()) {
        return Err(fail(format!(
            "{} distortion coefficients, expected 4, 5 or 8",
            d.len()
        )));
    }
    let lens = match model.as_str() {
        "plumb_bob" | "rational_polynomial" | "" if !beyond(5) => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [at(0), at(1), at(2), at(3), at(4)],
        },
        "plumb_bob" | "rational_polynomial" => {
            return Err(fail(
                "rational distortion with k4 to k6 is not supported: calibrate with `lsfb calib camera`".to_owned(),
            ));
        }
        "equidistant" | "fisheye" if d.len() == 4 => Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [d[0], d[1], d[2], d[3]],
        },
        other => {
            return Err(fail(format!(
                "distortion_model {other} with {} coefficients is not supported: use plumb_bob or equidistant",
                d.len()
            )));
        }
    };
    let camera = checked(Camera {
        width: size[0],
        height: size[1],
        lens,
    })
    .map_err(fail)?;
    let p = info.projection_matrix.map(|m| m.data).or(info.p);
    // That of the second camera of a rectified pair is −fx times their distance.
    if let Some(shift) = p.and_then(|p| p.get(3).copied()).filter(|t| *t != 0.0) {
        notes.push(format!(
            "{path}: the projection matrix of a rectified pair ({shift} in its fourth column) is not used: get camera poses from `lsfb calib camera`"
        ));
    }
    let turned = info.rectification_matrix.map(|m| m.data).or(info.r);
    let is_turned = |r: &Vec<f64>| {
        let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        !r.is_empty() && *r != identity && r.iter().any(|x| *x != 0.0)
    };
    if turned.as_ref().is_some_and(is_turned) {
        notes.push(format!(
            "{path}: the rectification matrix is not used: a rig holds the lens of the unrectified images"
        ));
    }
    notes.extend(yaml::unused(path, &info.others));
    Ok(ImportedCamera {
        name: info.camera_name,
        camera,
        notes,
    })
}

/// What a file says by either of two names; both must say the same.
fn one_of(
    names: [&str; 2],
    matrix: Option<Matrix>,
    list: Option<Vec<f64>>,
) -> Result<Option<Vec<f64>>, String> {
    match (matrix.map(|m| m.data), list) {
        (Some(a), Some(b)) if a != b => Err(format!(
            "{} and {} contradict each other: delete the wrong one",
            names[0], names[1]
        )),
        (a, b) => Ok(a.or(b)),
    }
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
        .push("CameraInfo cannot hold poses and time offsets".to_owned());
    out
}
