//! Pose of a rig by least squares of reprojection errors.

use std::cell::Cell;

use lsfb_geometry::{Matrix2, Matrix2x3, Matrix3, Matrix6, Se3, Vector2, so3};
use lsfb_solver::gauss_newton::{Next, NormalEquations, minimise, minimise_damped};
use lsfb_types::Bounds;
use nalgebra::Matrix2x6;
use serde::{Deserialize, Serialize};

use super::matches::{MountedCamera, PointMatch};

/// Configuration of [`refine_pose`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RefinementConfig {
    /// Errors beyond this count linearly (Huber), pixels; those of points that are known badly are counted as smaller.
    pub huber_px: f64,
    /// Most iterations.
    pub max_iterations: u32,
}

impl Default for RefinementConfig {
    fn default() -> Self {
        Self {
            huber_px: 1.0,
            max_iterations: 10,
        }
    }
}

lsfb_types::bounds! {
    RefinementConfig {
        huber_px: number(Bounds::POSITIVE),
        max_iterations: any,
    }
}

/// A pose that fits its matches best.
#[derive(Clone, Debug, PartialEq)]
pub struct RefinedPose {
    /// Pose of the rig.
    pub world_from_rig: Se3,
    /// Sum of the robust costs, square pixels.
    pub cost_px2: f64,
    /// Half of the second derivatives of the cost by the pose's tangent: its inverse, times the variance of a pixel, is the
    /// covariance of the pose. Square pixels per rad², per m².
    pub information: Matrix6<f64>,
    /// The same with the curvature of the robust cost: see `pose_covariance`.
    pub(super) curvature: Matrix6<f64>,
}

/// Gauss–Newton from `start`, until a step no longer lowers the cost; `None` with fewer than three matches, or where a point
/// falls behind its camera at the start. Matches of cameras that are not given are ignored.
pub fn refine_pose(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    start: &Se3,
    config: &RefinementConfig,
) -> Option<RefinedPose> {
    if matches.len() < 3 {
        return None;
    }
    let weighted = WeightedMatches::at(cameras, matches, start)?;
    let fit = |pose: &Se3| weighted.fit(pose, config.huber_px);
    let best = Cell::new((*start, fit(start)?));
    let terms = |pose: &Se3| {
        let here = fit(pose)?;
        let gain = best.get().1.cost_px2 - here.cost_px2;
        if gain > 0.0 {
            best.set((*pose, here));
        }
        let moved = *pose != *start;
        (!moved || gain > 1e-9 * here.cost_px2).then_some(here.equations)
    };
    // The search ends where the terms end: what counts is the best pose on the way.
    let ended = minimise::<Se3, 6>(*start, config.max_iterations, terms, |_| Next::Iterate);
    if let Some(last) = ended {
        terms(&last.value);
    }
    let (world_from_rig, fit) = best.get();
    Some(fit.at(world_from_rig))
}

/// The pose again, from where [`refine_pose`] ended: by damped steps, as a step too far ends that search where it is.
pub(super) fn settle(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    refined: RefinedPose,
    config: &RefinementConfig,
) -> RefinedPose {
    let Some(weighted) = WeightedMatches::at(cameras, matches, &refined.world_from_rig) else {
        return refined;
    };
    let at = |pose: &Se3| weighted.fit(pose, config.huber_px);
    let terms = |pose: &Se3| at(pose).map_or_else(Default::default, |f| f.equations);
    let cost = |pose: &Se3| at(pose).map_or(f64::INFINITY, |f| f.cost_px2);
    let trials = 2 * config.max_iterations;
    let (world_from_rig, _) = minimise_damped(refined.world_from_rig, trials, terms, cost);
    at(&world_from_rig).map_or(refined, |fit| fit.at(world_from_rig))
}

/// What the matches say about a pose.
#[derive(Clone, Copy)]
pub(super) struct Fit {
    pub cost_px2: f64,
    pub equations: NormalEquations<6>,
    /// Half of the second derivatives of the robust cost: less than the information of the equations, whose weights are those of a
    /// step. An error that counts linearly has no curvature along itself.
    pub curvature: Matrix6<f64>,
}

impl Fit {
    fn at(self, world_from_rig: Se3) -> RefinedPose {
        RefinedPose {
            world_from_rig,
            cost_px2: self.cost_px2,
            information: self.equations.information,
            curvature: self.curvature,
        }
    }
}

/// Standard deviation of a keypoint along each axis, pixels.
const KEYPOINT_SIGMA_PX: f64 = 1.0;

/// Matches whose errors are counted in units of what they are expected to be: the keypoint's own, and that of the point.
pub(super) struct WeightedMatches<'a> {
    cameras: &'a [MountedCamera],
    matches: &'a [PointMatch],
    /// What makes each error one of [`KEYPOINT_SIGMA_PX`] along both axes.
    whitening: Vec<Matrix2<f64>>,
}

impl<'a> WeightedMatches<'a> {
    /// As seen from a pose; `None` where a point has no pixel there.
    pub fn at(
        cameras: &'a [MountedCamera],
        matches: &'a [PointMatch],
        world_from_rig: &Se3,
    ) -> Option<Self> {
        let mut whitening = Vec::with_capacity(matches.len());
        let own = Matrix2::from_diagonal_element(KEYPOINT_SIGMA_PX.powi(2));
        let rig_from_world = world_from_rig.inverse();
        reproject(cameras, matches, world_from_rig, |m, _, seen| {
            // The pixel moves with the point as it moves against the rig.
            let by_point = -(seen.by_pose.fixed_columns::<3>(3) * rig_from_world.rotation_matrix());
            let covariance = own + by_point * m.point_covariance_m2 * by_point.transpose();
            let root = covariance.cholesky().and_then(|c| c.l().try_inverse());
            let root = root.filter(|w| w.iter().all(|v| v.is_finite()));
            // A point that is nowhere in particular says nothing.
            whitening.push(root.map_or_else(Matrix2::zeros, |w| w * KEYPOINT_SIGMA_PX));
        })?;
        Some(Self {
            cameras,
            matches,
            whitening,
        })
    }

    /// Shows `each` match as a pose has it, with what its error is multiplied by; `None` as soon as a point has no pixel.
    pub fn reproject(
        &self,
        world_from_rig: &Se3,
        mut each: impl FnMut(&PointMatch, &MountedCamera, &Reprojected, &Matrix2<f64>),
    ) -> Option<()> {
        let mut whitening = self.whitening.iter();
        reproject(
            self.cameras,
            self.matches,
            world_from_rig,
            |m, mounted, seen| {
                if let Some(whitening) = whitening.next() {
                    each(m, mounted, seen, whitening);
                }
            },
        )
    }

    /// What they say about a pose.
    pub fn fit(&self, world_from_rig: &Se3, huber_px: f64) -> Option<Fit> {
        let mut sum = Fit {
            cost_px2: 0.0,
            equations: NormalEquations::default(),
            curvature: Matrix6::zeros(),
        };
        self.reproject(world_from_rig, |m, _, seen, whitening| {
            let residual = whitening * (seen.pixel - m.pixel);
            let jacobian = whitening * seen.by_pose;
            let robust = Huber::of(&residual, huber_px);
            sum.cost_px2 += robust.cost_px2;
            sum.curvature += jacobian.tr_mul(&(robust.curvature * jacobian));
            sum.equations.add_block(&residual, &jacobian, robust.weight);
        })?;
        Some(sum)
    }
}

/// A reprojection error as it counts.
pub(super) struct Huber {
    pub weight: f64,
    pub cost_px2: f64,
    /// Half of the second derivatives of the cost by the error.
    pub curvature: Matrix2<f64>,
}

impl Huber {
    pub fn of(error_px: &Vector2<f64>, huber_px: f64) -> Self {
        let norm = error_px.norm();
        if norm <= huber_px {
            return Self {
                weight: 1.0,
                cost_px2: norm * norm,
                curvature: Matrix2::identity(),
            };
        }
        let (weight, along) = (huber_px / norm, error_px / norm);
        Self {
            weight,
            cost_px2: huber_px * (2.0 * norm - huber_px),
            curvature: (Matrix2::identity() - along * along.transpose()) * weight,
        }
    }
}

/// Where a pose shows a point, and the derivative of the pixel by the pose.
pub(super) struct Reprojected {
    pub pixel: Vector2<f64>,
    pub by_pose: Matrix2x6<f64>,
}

/// Shows `each` match with its camera as the pose has it; `None` as soon as a point has no pixel. Matches of cameras that are not
/// given are passed over.
pub(super) fn reproject(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    world_from_rig: &Se3,
    mut each: impl FnMut(&PointMatch, &MountedCamera, &Reprojected),
) -> Option<()> {
    let rig_from_world = world_from_rig.inverse();
    let from_rig: Vec<(Se3, Matrix3<f64>)> = cameras
        .iter()
        .map(|c| {
            let camera_from_rig = c.rig_from_camera.inverse();
            (camera_from_rig, camera_from_rig.rotation_matrix())
        })
        .collect();
    for m in matches {
        let (Some(mounted), Some((camera_from_rig, rotation))) =
            (cameras.get(m.camera), from_rig.get(m.camera))
        else {
            continue;
        };
        let point_in_rig = rig_from_world * m.point_in_world;
        let seen = mounted
            .camera
            .project_with_jacobian(&(*camera_from_rig * point_in_rig))?;
        let by_point: Matrix2x3<f64> = seen.pixel_by_point * rotation;
        // A step of the pose on the right moves the point in the rig frame by −(φ × p) − ρ … = [p]× φ − ρ.
        let mut by_pose = Matrix2x6::zeros();
        by_pose
            .fixed_columns_mut::<3>(0)
            .copy_from(&(by_point * so3::hat(&point_in_rig)));
        by_pose.fixed_columns_mut::<3>(3).copy_from(&-by_point);
        let pixel = seen.pixel;
        each(m, mounted, &Reprojected { pixel, by_pose });
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::{Camera, Vector3, Vector6};

    #[test]
    fn gradient_is_that_of_the_cost_and_the_minimum_is_the_truth() {
        let cameras = [MountedCamera {
            camera: Camera::pinhole(640, 480, [500.0; 2], [319.5, 239.5]),
            rig_from_camera: Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 0.05, 0.1, -0.02)),
            readout_s: 0.0,
        }];
        let truth = Se3::exp(&Vector6::new(0.2, 0.1, -0.3, 1.0, 2.0, 3.0));
        let matches: Vec<PointMatch> = (0..20)
            .map(|i| {
                let pixel = Vector2::new(
                    f64::from(i % 5) * 120.0 + 30.0,
                    f64::from(i / 5) * 110.0 + 20.0,
                );
                let ray = cameras[0].camera.unproject(&pixel).expect("pinhole");
                let depth = 1.0 + f64::from(i % 7) * 0.6;
                PointMatch {
                    camera: 0,
                    pixel,
                    point_in_world: truth * (cameras[0].rig_from_camera * (ray * depth)),
                    // Some are known badly, most of all along one direction.
                    point_covariance_m2: Matrix3::from_diagonal(&Vector3::new(
                        1e-4,
                        1e-5,
                        0.01 * f64::from(i % 3),
                    )),
                }
            })
            .collect();
        let start = truth * Se3::exp(&Vector6::new(0.03, -0.02, 0.04, 0.05, -0.1, 0.08));
        let weighted = WeightedMatches::at(&cameras, &matches, &start).expect("in front");
        let here = weighted.fit(&start, 2.0).expect("in front");
        for axis in 0..6 {
            let cost = |h: f64| {
                let mut delta = Vector6::zeros();
                delta[axis] = h;
                let moved = start * Se3::exp(&delta);
                weighted.fit(&moved, 2.0).expect("in front").cost_px2
            };
            let numeric = (cost(1e-6) - cost(-1e-6)) / 4e-6;
            assert!(
                (numeric - here.equations.gradient[axis]).abs()
                    < 1e-4 * here.equations.gradient.norm(),
                "{axis}: {numeric} {}",
                here.equations.gradient[axis]
            );
        }
        let config = RefinementConfig::default();
        let found = refine_pose(&cameras, &matches, &start, &config).expect("enough matches");
        assert!((truth.inverse() * found.world_from_rig).log().norm() < 1e-6);
        let behind = truth * Se3::new(Default::default(), Vector3::new(0.0, 0.0, 50.0));
        assert!(refine_pose(&cameras, &matches, &behind, &config).is_none());
    }
}
