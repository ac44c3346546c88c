//! What the batch leaves of each corner: outliers, and the spread of the others.

use lsfb_geometry::Vector2;

use super::state::{RigEstimate, View};
use crate::board::Target;
use crate::clusters::{Clusters, share_of_board};
use crate::{Error, JoinProblem};

/// Corners that miss by more than this many times the median are outliers.
const OUTLIER_RATIO: f64 = 5.0;
/// Median error above which a camera does not fit, pixels.
const MAX_MEDIAN_PX: f64 = 3.0;
/// Stretch of time in which errors are not independent, seconds.
const CLUSTER_S: f64 = 0.5;
/// Least standard deviation of a corner that is believed, pixels.
const LEAST_SIGMA_PX: f64 = 0.01;
/// Median length of a two-dimensional normal error of standard deviation 1.
const MEDIAN_LENGTH: f64 = 1.1774;

impl RigEstimate {
    /// Error of each corner of a view, pixels; `None` where it is not seen.
    pub fn errors_px(&self, view: &View) -> Vec<Option<Vector2<f64>>> {
        let camera = &self.cameras[view.camera];
        let mut pose = None;
        view.corners
            .iter()
            .map(|(point, pixel)| {
                if pose.is_none() || camera.readout_s != 0.0 {
                    let time_s = self.time_s(view) + camera.row_s(pixel);
                    pose = self.motion.pose_at(time_s);
                }
                let in_rig = pose?.inverse() * self.bent(point);
                let seen = camera.camera.project(&(camera.camera_from_rig * in_rig))?;
                Some(seen - pixel)
            })
            .collect()
    }

    /// Half the weighted squares of all corners that count.
    pub fn cost_of_corners(&self) -> f64 {
        let of_view = |view: &View| {
            let errors = self.errors_px(view).into_iter().zip(&view.inliers);
            let squares: f64 = errors
                .filter(|(_, inlier)| **inlier)
                .filter_map(|(error, _)| Some(error?.norm_squared()))
                .sum();
            0.5 * squares / self.cameras[view.camera].sigma_px.powi(2)
        };
        self.views.iter().map(of_view).sum()
    }

    /// How much less a camera's corners are worth than as many independent ones.
    fn design_effect(&self, target: &Target, camera: usize) -> f64 {
        let mut clusters = Clusters::default();
        for view in self.views.iter().filter(|v| v.camera == camera) {
            let time = (view.stamp_s / CLUSTER_S).floor() as i64;
            let errors = self.errors_px(view).into_iter().zip(&view.inliers);
            for ((error, inlier), (point, _)) in errors.zip(&view.corners) {
                if let Some(error) = error.filter(|_| *inlier) {
                    clusters.add(time, share_of_board(target, point), &error);
                }
            }
        }
        clusters.design_effect()
    }

    /// Finds outliers and the spread of the others, camera by camera.
    pub fn find_outliers(&mut self, target: &Target) -> Result<(), Error> {
        let length = |e: &Option<Vector2<f64>>| e.map_or(f64::INFINITY, |e| e.norm());
        let errors: Vec<Vec<f64>> = self
            .views
            .iter()
            .map(|v| self.errors_px(v).iter().map(length).collect())
            .collect();
        for k in 0..self.cameras.len() {
            let of_camera = || {
                self.views
                    .iter()
                    .zip(&errors)
                    .filter(|(v, _)| v.camera == k)
            };
            let mut lengths: Vec<f64> = of_camera().flat_map(|(_, e)| e.iter().copied()).collect();
            lengths.sort_by(f64::total_cmp);
            let median = lengths
                .get(lengths.len() / 2)
                .copied()
                .unwrap_or(f64::INFINITY);
            if !(median < MAX_MEDIAN_PX) && self.cameras[k].alone_px < 0.5 * MAX_MEDIAN_PX {
                return Err(Error::NotJoined {
                    first: self.cameras[k].name.clone(),
                    second: "the IMU".to_owned(),
                    cause: JoinProblem::MissAlongMotion {
                        alone_px: self.cameras[k].alone_px,
                        together_px: median,
                    },
                });
            }
            if !(median < MAX_MEDIAN_PX) {
                return Err(Error::DoesNotFit {
                    camera: self.cameras[k].name.clone(),
                    rms_px: median,
                    target: target.describe(),
                    model: self.cameras[k].model().name(),
                });
            }
            let limit = OUTLIER_RATIO * median;
            let inliers = lengths.partition_point(|e| *e <= limit).max(1);
            let squares: f64 = lengths[..inliers].iter().map(|e| e * e).sum();
            let spread = (squares / (2 * inliers) as f64).sqrt();
            // Robust against what is left of outliers, exact where the errors are normal.
            let spread = spread.min(1.2 * median / MEDIAN_LENGTH).max(LEAST_SIGMA_PX);
            for (view, errors) in self.views.iter_mut().zip(&errors) {
                if view.camera == k {
                    view.inliers = errors.iter().map(|e| *e <= limit).collect();
                }
            }
            self.cameras[k].sigma_px = spread * self.design_effect(target, k).sqrt();
        }
        Ok(())
    }
}
