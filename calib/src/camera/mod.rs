//! Intrinsics of cameras and their poses to each other, from views of a board.
//!
//! Each camera is first guessed without any input (`guess`), then adjusted alone, then all cameras that share instants
//! together. Robust first; what is an outlier then is left out of the final squares and counted.

mod adjustment;
mod batch;
mod corner_residual;
mod guess;
mod holdout;
mod page;
mod pairing;
mod pose_choice;
mod rig;
mod selection;
mod shutter;
mod solved;
mod summary;
mod uncertainty;
mod views;

use std::collections::BTreeMap;

use lsfb_geometry::camera::LensModel;
use lsfb_geometry::{Camera, CameraSigmas, Matrix6, Rig, Se3};
use lsfb_types::{Bounds, Finding, Limit, Progress, ProgressFn, Verdict};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::board::Target;
use crate::detect::Corner;

pub use crate::coverage::COVERAGE_CELLS;

pub use crate::residual_diagnosis::BoardDeformation;
pub(crate) use guess::fit_lens;
pub use guess::pose_of_target;
pub(crate) use pairing::expect_different_images;
pub(crate) use pose_choice::most_central;
pub(crate) use selection::copied as copied_views;
pub use shutter::as_global_shutter;
pub(crate) use views::last_number;
pub use views::{
    image_files, image_from_folder, views_from_bag, views_from_folder, views_from_recording,
};

/// What one camera saw.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraViews {
    /// Name of the camera in the rig.
    pub name: String,
    /// Width of its images, pixels.
    pub width: u32,
    /// Height of its images, pixels.
    pub height: u32,
    /// Images looked at, with the target or without.
    pub images: usize,
    /// Views of the target by instant: cameras that are triggered together share instants.
    pub views: BTreeMap<i64, Vec<Corner>>,
}

/// Settings of [`calibrate_cameras`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraConfig {
    /// Lens model of every camera.
    pub model: LensModel,
    /// Views used at most per camera, spread over image, distance and tilt.
    pub max_views: usize,
    /// Views needed per camera.
    pub min_views: usize,
    /// Corners that miss by more than this many times the typical error are outliers.
    pub outlier_ratio: f64,
    /// Root mean square error above which the model is said not to fit, pixels.
    pub max_rms_px: f64,
    /// Every n-th view is a holdout: it is only predicted, as a check; 0 for no holdout.
    pub holdout_every: usize,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            model: LensModel::KannalaBrandt,
            max_views: 60,
            min_views: 4,
            outlier_ratio: 6.0,
            max_rms_px: 3.0,
            holdout_every: 5,
        }
    }
}

lsfb_types::bounds! {
    CameraConfig {
        model: any,
        max_views: any,
        min_views: any,
        outlier_ratio: number(Bounds::POSITIVE),
        max_rms_px: number(Bounds::POSITIVE),
        holdout_every: any,
    }
}

/// A parameter with its standard deviation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Name: `fx`, `k1`.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard deviation, from the residuals' own spread, and from what a board does that is likely to be bent.
    pub sigma: f64,
}

/// Standard deviation of the focal lengths among a lens's parameters, as a share of them; `None` where they were not searched.
pub(crate) fn focal_sigma(lens: &[Estimate]) -> Option<f64> {
    let focal = lens
        .iter()
        .filter(|p| ["fx", "fy"].contains(&p.name.as_str()));
    let share = focal.map(|p| p.sigma / p.value.abs());
    CameraSigmas::estimated(share.fold(0.0, f64::max))
}

/// What is known of one camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibratedCamera {
    /// Name in the rig.
    pub name: String,
    /// Size and lens.
    pub camera: Camera,
    /// The parameters with their standard deviations.
    pub parameters: Vec<Estimate>,
    /// Pose of the first camera in this one.
    #[serde(skip)]
    pub camera_from_first: Se3,
    /// Standard deviations of [`CalibratedCamera::camera_from_first`], rotation (rad) then translation (m); zero for the
    /// first.
    pub pose_sigma: [f64; 6],
    /// Their covariance, by right perturbation.
    #[serde(skip)]
    pub pose_covariance: Matrix6<f64>,
    /// Images looked at.
    pub images: usize,
    /// Images in which the target was found.
    pub found: usize,
    /// Views adjusted.
    pub views: usize,
    /// Root mean square over all corners of these views, outliers too, pixels.
    pub rms_px: f64,
    /// The same without the outliers.
    pub inlier_rms_px: f64,
    /// Corners of these views.
    pub corners: usize,
    /// Corners left out as outliers.
    pub outliers: usize,
    /// Root mean square over views that were held back from a second adjustment, pixels.
    pub holdout_rms_px: Option<f64>,
    /// Share of the image's cells (12 × 8) in which a corner was seen.
    pub coverage: f64,
    /// Corners per cell, by rows from the upper left.
    pub cells: Vec<u32>,
    /// Mean reprojection error (x, y) per cell without outliers, pixels.
    pub cell_errors_px: Vec<[f64; 2]>,
    /// The board as it would be if it were not flat, and what that would do to the focal length.
    pub board: BoardDeformation,
    /// Reprojection errors (x, y) of all corners, pixels, in order.
    #[serde(skip)]
    pub errors_px: Vec<[f64; 2]>,
    /// What was looked at, and how it came out.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

/// All cameras.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraCalibration {
    /// By the order given.
    pub cameras: Vec<CalibratedCamera>,
    /// Root mean square over all cameras, pixels.
    pub rms_px: f64,
    /// Pose of the target in the first camera's frame by instant.
    #[serde(skip)]
    pub first_from_target: BTreeMap<i64, Se3>,
}

/// Calibrates cameras that were triggered together; one is enough. The order of views and of cameras but the first does not
/// matter.
pub fn calibrate_cameras(
    target: &Target,
    cameras: &[CameraViews],
    config: &CameraConfig,
    progress: ProgressFn,
) -> Result<CameraCalibration, Error> {
    config.check_bounds("camera")?;
    if let Some(problem) = target.problem() {
        return Err(problem.into());
    }
    expect_different_images(cameras)?;
    let ordered = in_order(cameras);
    let mut alone = Vec::with_capacity(cameras.len());
    for (done, views) in ordered.iter().enumerate() {
        progress(Progress {
            stage: "camera",
            done: done as u64,
            total: cameras.len() as u64,
        })?;
        let found = views.views.len();
        let different = found - selection::copied(views).len();
        if found >= config.min_views && different < config.min_views {
            return Err(Error::CopiedImages {
                camera: views.name.clone(),
                found,
                different,
                needed: config.min_views,
            });
        }
        if found < config.min_views {
            return Err(Error::TargetNotSeen {
                camera: views.name.clone(),
                found,
                images: views.images,
                needed: config.min_views,
                target: target.describe(),
            });
        }
        let chosen = selection::choose(views, config.max_views);
        let start = guess::camera(target, views, &chosen, config.model)?;
        alone.push(solved::Start {
            views,
            chosen,
            camera: start,
            camera_from_first: Se3::identity(),
            alone_rms_px: None,
        });
    }
    let solved = adjustment::adjust_each_then_all(target, alone, config)?;
    let mut calibration = solved.report(target, &ordered, config)?;
    let place = |c: &CalibratedCamera| cameras.iter().position(|given| given.name == c.name);
    calibration.cameras.sort_by_key(place);
    let finding = swapped(&calibration.cameras);
    if let Some(last) = calibration.cameras.last_mut() {
        last.findings.extend(finding);
    }
    for c in &mut calibration.cameras {
        let views = cameras.iter().find(|views| views.name == c.name);
        c.findings.extend(views.and_then(copied));
        let far_m = c.camera_from_first.translation.norm();
        if far_m > FARTHEST_M {
            let what = format!("it is {far_m:.1} m from the first camera");
            let far = Finding::new("far-camera", Verdict::Warn, &c.name, what)
                .value(far_m, "m")
                .limit(Limit::AtMost(FARTHEST_M));
            c.findings.push(far.remedy(
                "check that the board's size is in metres, and that all cameras saw the same board",
            ));
        }
    }
    Ok(calibration)
}

/// Cameras of a rig that is carried are nearer to each other, metres.
const FARTHEST_M: f64 = 5.0;
/// Difference of two cameras' places that counts as much as another camera: radians and metres.
const TURN_RAD: f64 = 0.1;
const SHIFT_M: f64 = 0.05;
/// Cameras are exchanged where they stand so much nearer to each other's places than to their own.
const NEARER: f64 = 0.25;

impl CameraCalibration {
    /// Compares the result with the rig it goes into, where that has these cameras: those that were exchanged are added to the
    /// findings.
    pub fn compare_with(&mut self, rig: &Rig) {
        let Some((first, others)) = self.cameras.split_first_mut() else {
            return;
        };
        let expected = |to: &str, from: &str| {
            let (to, from) = (rig.cameras.get(to)?, rig.cameras.get(from)?);
            Some(to.rig_from_camera.inverse() * from.rig_from_camera)
        };
        for c in others {
            let off = |pose: Se3| {
                let off = pose.inverse() * c.camera_from_first;
                off.rotation.angle() / TURN_RAD + off.translation.norm() / SHIFT_M
            };
            let as_named = expected(&c.name, &first.name).map(off);
            let exchanged = expected(&first.name, &c.name).map(off);
            if let (Some(as_named), Some(exchanged)) = (as_named, exchanged)
                && exchanged < 1.0
                && exchanged < NEARER * as_named
            {
                let what = format!(
                    "{} and {} are swapped compared with the rig: their views or their names",
                    first.name, c.name
                );
                let finding = Finding::new("swapped", Verdict::Warn, &c.name, what);
                c.findings
                    .push(finding.remedy("check which images belong to which camera"));
            }
        }
    }
}

/// Images of a camera that are there more than once.
pub(crate) fn copied(views: &CameraViews) -> Option<Finding> {
    let copied = selection::copied(views);
    let (copy, first) = copied.first()?;
    let example = [copy, first].map(i64::to_string);
    let example = [example[0].as_str(), example[1].as_str()];
    let of = views.views.len();
    Some(crate::copies::finding(
        &views.name,
        copied.len(),
        of,
        example,
    ))
}

/// Cameras whose names and places contradict each other.
fn swapped(cameras: &[CalibratedCamera]) -> Option<Finding> {
    let named = |word: &str| {
        cameras
            .iter()
            .find(|c| c.name.to_lowercase().contains(word))
    };
    let (left, right) = (named("left")?, named("right")?);
    let left_from_right = left.camera_from_first * right.camera_from_first.inverse();
    (left_from_right.translation.x < 0.0).then(|| {
        let what = format!(
            "{} is to the left of {}: their views or their names are swapped",
            right.name, left.name
        );
        let finding = Finding::new("swapped", Verdict::Warn, &right.name, what);
        finding.remedy("check which images belong to which camera")
    })
}

/// The cameras but the first by name, their corners by number: sums round alike in whatever order they are given.
fn in_order(cameras: &[CameraViews]) -> Vec<CameraViews> {
    let mut ordered = cameras.to_vec();
    if let Some((_, others)) = ordered.split_first_mut() {
        others.sort_by(|a, b| a.name.cmp(&b.name));
    }
    for corners in ordered.iter_mut().flat_map(|c| c.views.values_mut()) {
        corners.sort_by_key(|c| c.index);
    }
    ordered
}

#[cfg(test)]
mod tests;
