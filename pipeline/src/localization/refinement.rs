//! Pose of a rig by least squares of reprojection errors.

use std::cell::Cell;

use lsfb_geometry::{Matrix2x3, Matrix3, Matrix6, Se3, so3};
use lsfb_perception::gauss_newton::{Next, NormalEquations, minimise};
use lsfb_types::Bounds;
use nalgebra::Matrix2x6;
use serde::{Deserialize, Serialize};

use super::matches::{MountedCamera, PointMatch};

/// Configuration of [`refine_pose`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RefinementConfig {
    /// Errors beyond this count linearly (Huber), pixels.
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
    let fit = |pose: &Se3| fit(cameras, matches, pose, config.huber_px);
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
    Some(RefinedPose {
        world_from_rig,
        cost_px2: fit.cost_px2,
        information: fit.equations.information,
    })
}

/// What the matches say about a pose.
#[derive(Clone, Copy)]
pub(super) struct Fit {
    pub cost_px2: f64,
    pub equations: NormalEquations<6>,
}

pub(super) fn fit(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    world_from_rig: &Se3,
    huber_px: f64,
) -> Option<Fit> {
    let rig_from_world = world_from_rig.inverse();
    let from_rig: Vec<(Se3, Matrix3<f64>)> = cameras
        .iter()
        .map(|c| {
            let camera_from_rig = c.rig_from_camera.inverse();
            (camera_from_rig, camera_from_rig.rotation_matrix())
        })
        .collect();
    let mut sum = Fit {
        cost_px2: 0.0,
        equations: NormalEquations::default(),
    };
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
        let residual = seen.pixel - m.pixel;
        let by_point: Matrix2x3<f64> = seen.pixel_by_point * rotation;
        // A step of the pose on the right moves the point in the rig frame by −(φ × p) − ρ … = [p]× φ − ρ.
        let mut jacobian = Matrix2x6::zeros();
        jacobian
            .fixed_columns_mut::<3>(0)
            .copy_from(&(by_point * so3::hat(&point_in_rig)));
        jacobian.fixed_columns_mut::<3>(3).copy_from(&-by_point);
        let norm = residual.norm();
        let (weight, cost) = if norm <= huber_px {
            (1.0, norm * norm)
        } else {
            (huber_px / norm, huber_px * (2.0 * norm - huber_px))
        };
        sum.cost_px2 += cost;
        sum.equations.add_block(&residual, &jacobian, weight);
    }
    Some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::{Camera, Vector2, Vector3, Vector6};

    #[test]
    fn gradient_is_that_of_the_cost_and_the_minimum_is_the_truth() {
        let cameras = [MountedCamera {
            camera: Camera::pinhole(640, 480, [500.0; 2], [319.5, 239.5]),
            rig_from_camera: Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 0.05, 0.1, -0.02)),
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
                }
            })
            .collect();
        let start = truth * Se3::exp(&Vector6::new(0.03, -0.02, 0.04, 0.05, -0.1, 0.08));
        let here = fit(&cameras, &matches, &start, 2.0).expect("in front");
        for axis in 0..6 {
            let cost = |h: f64| {
                let mut delta = Vector6::zeros();
                delta[axis] = h;
                let moved = start * Se3::exp(&delta);
                fit(&cameras, &matches, &moved, 2.0)
                    .expect("in front")
                    .cost_px2
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
