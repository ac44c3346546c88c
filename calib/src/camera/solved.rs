//! Cameras and poses of the board as an adjustment has them.

use std::collections::BTreeMap;

use lsfb_geometry::{Camera, Se3, Vector2};

use super::CameraViews;
use crate::board::Target;

/// A camera on its way.
#[derive(Clone)]
pub(super) struct Start<'a> {
    pub views: &'a CameraViews,
    /// Instants of the views adjusted.
    pub chosen: Vec<i64>,
    pub camera: Camera,
    pub camera_from_first: Se3,
    /// Root mean square of its inliers' errors when it was adjusted for itself, pixels; `None` where it is the only camera.
    pub alone_rms_px: Option<f64>,
}

/// Cameras, poses and outliers after adjustment.
pub(super) struct Solved<'a> {
    pub cameras: Vec<Start<'a>>,
    pub first_from_target: BTreeMap<i64, Se3>,
    /// By camera and instant, whether each corner counts.
    pub inliers: Inliers,
    /// What the last adjustment found that these views do not determine: a camera, and what of it.
    pub undetermined: Option<[String; 2]>,
}

pub(super) type Inliers = Vec<BTreeMap<i64, Vec<bool>>>;

impl Solved<'_> {
    /// Parameters of each lens.
    pub fn lens_size(&self) -> usize {
        let first = self.cameras.first();
        first.map_or(0, |c| c.camera.lens.model().parameter_count())
    }

    /// Root mean square of the errors of all inliers.
    pub fn rms_px(&self, target: &Target) -> f64 {
        let (mut squares, mut count) = (0.0, 0);
        for (k, camera) in self.cameras.iter().enumerate() {
            for instant in &camera.chosen {
                let errors = self.errors_px(target, k, *instant).into_iter();
                for (error, inlier) in errors.zip(&self.inliers[k][instant]) {
                    if let Some(error) = error.filter(|_| *inlier) {
                        squares += error.norm_squared();
                        count += 1;
                    }
                }
            }
        }
        (squares / f64::from(count.max(1))).sqrt()
    }

    /// Reprojection errors of a view; `None` for corners that the camera does not see.
    pub fn errors_px(
        &self,
        target: &Target,
        camera: usize,
        instant: i64,
    ) -> Vec<Option<Vector2<f64>>> {
        let start = &self.cameras[camera];
        let Some(pose) = self.first_from_target.get(&instant) else {
            return Vec::new();
        };
        let camera_from_target = start.camera_from_first * *pose;
        start.views.views[&instant]
            .iter()
            .map(|c| {
                let seen = start
                    .camera
                    .project(&(camera_from_target * target.corner(c.index)))?;
                Some(seen - c.pixel)
            })
            .collect()
    }
}
