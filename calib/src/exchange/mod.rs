//! Rigs in the files of other programs, and theirs as rigs.
//!
//! | program | files | pixel (0, 0) | poses | time |
//! | --- | --- | --- | --- | --- |
//! | Kalibr | `camchain.yaml`, `imu.yaml` | centre of the first pixel | `T_cam_imu`: camera from IMU | `t_imu = t_cam + timeshift_cam_imu` |
//! | ROS | one `CameraInfo` per camera | centre of the first pixel | none | none |
//! | COLMAP | `cameras.txt`, `rig_config.json` | **corner** of the first pixel: half a pixel more | `cam_from_rig`, the rig is the first camera | none |
//! | Basalt | `calibration.json` | centre of the first pixel | `T_imu_cam`: IMU from camera | `t_imu = t_cam + cam_time_offset_ns`, one for all |
//!
//! The signs of both time offsets are those of the programs' own residuals, not of their documentation alone: Kalibr's camera
//! error terms (`kalibr_imu_camera_calibration/IccSensors.py`) and Basalt's corner terms (`optimization/spline_linearize.h`) ask the
//! IMU's spline for the pose at the image's stamp **plus** the offset. Basalt's odometry does not apply it at all (the line is
//! commented out there), which [`Exported::notes`] says.
//!
//! What a format cannot hold is said in [`Exported::notes`], what a rig cannot hold, and what was not understood, in the `notes` of
//! [`ImportedRig`], [`ImportedImu`] and [`ImportedCamera`]: nothing is dropped in silence. Files of OpenCV and OpenVINS
//! (`%YAML:1.0`, `T_imu_cam`) are read as those of ROS and Kalibr.

mod basalt;
mod colmap;
mod kalibr;
mod omni;
mod plausible;
mod ros;
mod yaml;

use lsfb_geometry::camera::{Lens, LensModel};
use lsfb_geometry::{
    Camera, ImuNoiseModel, Matrix3, Quaternion, Rig, RigCamera, Se3, UnitQuaternion, Vector2,
    Vector3, so3,
};

use lsfb_types::{Bounds, OutOfBounds};

use crate::Error;
use crate::camera::fit_lens;

pub use basalt::import_basalt;
pub use colmap::import_colmap;
pub use kalibr::{ChainOrigin, camera_chain, import_kalibr, import_kalibr_imu, imu_to_kalibr};
pub use plausible::implausible;
pub use ros::{ImportedCamera, import_camera_info};

/// By how much a file's matrix may miss being a rotation (Frobenius norm of `R Rᵀ − 1`).
const ROTATION_ROUNDING: f64 = 1e-3;

/// Of what the poses of imported cameras are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PosesOf {
    /// The IMU, which is the rig's origin.
    Imu,
    /// One of the cameras: how they stand to each other, not how they stand on a rig.
    FirstCamera,
    /// Nothing: all cameras are at the origin.
    Nothing,
}

/// A rig from another program's file.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedRig {
    /// The rig.
    pub rig: Rig,
    /// Of what its cameras' poses are.
    pub poses: PosesOf,
    /// What is in the file that a rig does not hold, in words.
    pub notes: Vec<String>,
}

/// The noise of an IMU from another program's file.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedImu {
    /// The noise.
    pub noise: ImuNoiseModel,
    /// What is in the file that a rig does not hold, in words.
    pub notes: Vec<String>,
}

/// A program whose files can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Kalibr: camera chain with the IMU, noise of the IMU.
    Kalibr,
    /// ROS: `CameraInfo` as `camera_calibration` writes it.
    Ros,
    /// COLMAP: cameras and rig.
    Colmap,
    /// Basalt: calibration.
    Basalt,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 4] = [Self::Kalibr, Self::Ros, Self::Colmap, Self::Basalt];

    /// Its name on the command line.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Kalibr => "kalibr",
            Self::Ros => "ros",
            Self::Colmap => "colmap",
            Self::Basalt => "basalt",
        }
    }
}

/// One file of a format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExportedFile {
    /// Its usual name.
    pub name: String,
    /// Its text.
    pub text: String,
}

/// A rig in another program's files.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Exported {
    /// The files.
    pub files: Vec<ExportedFile>,
    /// What the format does not hold, in words.
    pub notes: Vec<String>,
}

/// Samples per second that an IMU gives.
const IMU_RATE_HZ: Bounds = Bounds::Within(1.0, 1e5);

/// A rig in the files of `format`. `imu_rate_hz` is the rate of the IMU's samples, which a rig does not say.
pub fn export(rig: &Rig, format: Format, imu_rate_hz: f64) -> Result<Exported, Error> {
    if !IMU_RATE_HZ.hold(imu_rate_hz) {
        return Err(OutOfBounds::new("", "imu_rate_hz", &imu_rate_hz, &IMU_RATE_HZ).into());
    }
    if rig.cameras.is_empty() {
        return Err(Error::Parse {
            path: format!("rig {}", rig.name),
            problem: "it has no camera: there is nothing to export".to_owned(),
        });
    }
    let mut out = match format {
        Format::Kalibr => kalibr::export(rig, imu_rate_hz),
        Format::Ros => ros::export(rig),
        Format::Colmap => colmap::export(rig),
        Format::Basalt => basalt::export(rig, imu_rate_hz),
    };
    if rig.lidar().is_some() {
        out.notes
            .push("the LiDAR's pose cannot be written to these files".to_owned());
    }
    if rig.calibrated_unix_s.is_some() {
        out.notes
            .push("the calibration date cannot be written to these files".to_owned());
    }
    if rig.cameras.values().any(|c| c.timing.readout_s != 0.0) {
        out.notes
            .push("rolling-shutter readout times cannot be written to these files".to_owned());
    }
    Ok(out)
}

/// A camera in a model that the other program knows: its own, or `other` fitted over the image. With a note of what that
/// costs.
fn in_model(
    name: &str,
    camera: &Camera,
    known: &[LensModel],
    other: LensModel,
    notes: &mut Vec<String>,
) -> Camera {
    let own = camera.lens.model();
    if known.contains(&own) {
        return *camera;
    }
    let rays = grid(camera);
    let fitted = Camera {
        lens: fit_lens(other, camera, &rays),
        ..*camera
    };
    notes.push(format!(
        "{name}: the lens model {} is converted to {}, with an error of up to {:.3} px",
        own.name(),
        other.name(),
        deviation_px(camera, &fitted)
    ));
    fitted
}

/// Rays of a grid of pixels.
fn grid(camera: &Camera) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    const STEPS: u32 = 24;
    let at = |k: u32, size: u32| f64::from(k) / f64::from(STEPS) * f64::from(size - 1);
    (0..=STEPS)
        .flat_map(|j| (0..=STEPS).map(move |i| (i, j)))
        .map(|(i, j)| Vector2::new(at(i, camera.width.max(1)), at(j, camera.height.max(1))))
        .filter_map(|pixel| Some((camera.unproject(&pixel)?, pixel)))
        .collect()
}

/// Largest distance between where two lenses see the same rays, pixels.
fn deviation_px(a: &Camera, b: &Camera) -> f64 {
    grid(a)
        .iter()
        .map(|(ray, pixel)| b.project(ray).map_or(f64::INFINITY, |p| (p - pixel).norm()))
        .fold(0.0, f64::max)
}

/// A number with all its digits.
fn exact(value: f64) -> String {
    format!("{value:?}")
}

fn list(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(|v| exact(*v)).collect();
    format!("[{}]", words.join(", "))
}

/// A rotation matrix as others write it: rounded; `None` where it is none.
fn rotation(rows: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    so3::from_rounded(rows, ROTATION_ROUNDING)
}

fn quaternion([w, x, y, z]: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    let q = Quaternion::new(w, x, y, z);
    ((q.norm() - 1.0).abs() < 1e-3).then(|| UnitQuaternion::new_normalize(q))
}

fn mounted(camera: Camera, rig_from_camera: Se3) -> RigCamera {
    RigCamera {
        camera,
        rig_from_camera,
        timing: Default::default(),
        sigmas: Default::default(),
    }
}

fn checked(camera: Camera) -> Result<Camera, String> {
    let whole = camera.width > 0 && camera.height > 0;
    if !whole {
        return Err(format!(
            "an image of {} × {} pixels",
            camera.width, camera.height
        ));
    }
    camera.lens.problem().map_or(Ok(camera), Err)
}

/// Whether all numbers of a pose are numbers.
fn is_finite(pose: &Se3) -> bool {
    pose.translation.iter().all(|v| v.is_finite())
        && pose.rotation.coords.iter().all(|v| v.is_finite())
}

/// A note on names in a file that no reader knew.
fn not_used(what: &str, names: &[&str]) -> String {
    format!("{what}: unknown and not used: {}", names.join(", "))
}

fn parse_error(path: &str, problem: impl std::fmt::Display) -> Error {
    Error::Parse {
        path: path.to_owned(),
        problem: problem.to_string().replace('\n', ", "),
    }
}

/// Radial-tangential distortion of the lens, where it has it.
fn radtan(lens: &Lens) -> Option<[f64; 5]> {
    match lens {
        Lens::PinholeRadtan { distortion, .. } => Some(*distortion),
        _ => None,
    }
}

#[cfg(test)]
mod odd_files;
#[cfg(test)]
mod tests;
