//! Registration of a scan to the local map: Gauss–Newton on SE(3) with point-to-plane residuals where the map is flat
//! and point-to-point residuals elsewhere, a Gaussian prior on the pose, and a robust kernel that tightens.

use lsfb_geometry::{Matrix6, Se3, Vector3, Vector6, so3};
use nalgebra::{Matrix3x6, RowVector6};
use rayon::prelude::*;

use super::local_map::{LocalMap, Match};

/// What is known of the pose before the scan is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePrior {
    /// The predicted pose.
    pub world_from_rig: Se3,
    /// Inverse covariance of its `[rotation, translation]` error, perturbed on the right.
    pub information: Matrix6<f64>,
}

/// How to register.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegistrationConfig {
    /// Gauss–Newton iterations at most.
    pub max_iterations: u32,
    /// Farthest correspondence of the first iteration, metres.
    pub gate_m: f64,
    /// Scale below which the kernel is not tightened, metres.
    pub min_kernel_m: f64,
    /// Standard deviation of one range, metres.
    pub range_noise_m: f64,
    /// Standard deviation of a point-to-point correspondence, metres.
    pub point_noise_m: f64,
    /// Neighbouring points share their errors: this many count as one.
    pub points_per_independent: f64,
}

/// A registered scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// Pose of the rig: the best of scan and prior.
    pub world_from_rig: Se3,
    /// Information the scan alone gives on the pose, without the prior.
    pub information: Matrix6<f64>,
    /// Share of the points that agree with the map within the final kernel.
    pub inlier_ratio: f64,
    /// Root mean square of the plane distances of those, metres.
    pub plane_rms_m: f64,
    /// Iterations taken.
    pub iterations: u32,
}

/// Normal equations of the scan at one pose.
#[derive(Clone, Copy)]
struct Normal {
    hessian: Matrix6<f64>,
    gradient: Vector6<f64>,
    inliers: u32,
    plane_inliers: u32,
    plane_squares: f64,
}

/// Points per task: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 256;

/// Registers `points_in_rig`, seen from `sensor_in_rig`, to `map`.
pub fn register(
    points_in_rig: &[Vector3<f64>],
    sensor_in_rig: &Vector3<f64>,
    map: &LocalMap,
    prior: &PosePrior,
    config: &RegistrationConfig,
) -> Registration {
    let mut pose = prior.world_from_rig;
    let mut gate_m = config.gate_m;
    let mut iterations = 0;
    loop {
        let kernel_m = (gate_m / 3.0).max(config.min_kernel_m);
        let normal = linearize(points_in_rig, sensor_in_rig, map, &pose, kernel_m, config);
        let settled = kernel_m <= config.min_kernel_m;
        let deviation = (prior.world_from_rig.inverse() * pose).log();
        // The prior's own Jacobian is the identity to first order in a deviation of millimetres and milliradians.
        let hessian = normal.hessian + prior.information;
        let gradient = normal.gradient + prior.information * deviation;
        let step = hessian
            .cholesky()
            .map_or_else(Vector6::zeros, |c| -c.solve(&gradient));
        pose = pose * Se3::exp(&step);
        iterations += 1;
        let small = step.fixed_rows::<3>(0).norm() < 2e-5 && step.fixed_rows::<3>(3).norm() < 2e-4;
        if (small && settled) || iterations >= config.max_iterations {
            return Registration {
                world_from_rig: pose,
                information: normal.hessian,
                inlier_ratio: f64::from(normal.inliers) / points_in_rig.len().max(1) as f64,
                plane_rms_m: (normal.plane_squares / f64::from(normal.plane_inliers.max(1))).sqrt(),
                iterations,
            };
        }
        // Once a kernel has converged the next is half as wide.
        if small || iterations % 4 == 0 || gate_m < 1.0 {
            gate_m *= 0.5;
        }
    }
}

fn linearize(
    points_in_rig: &[Vector3<f64>],
    sensor_in_rig: &Vector3<f64>,
    map: &LocalMap,
    world_from_rig: &Se3,
    kernel_m: f64,
    config: &RegistrationConfig,
) -> Normal {
    let rotation = world_from_rig.rotation_matrix();
    let sensor = *world_from_rig * *sensor_in_rig;
    let partial: Vec<Normal> = points_in_rig
        .par_chunks(CHUNK)
        .map(|points| {
            let mut sum = Normal::zero();
            for p in points {
                let in_world = rotation * p + world_from_rig.translation;
                let towards_sensor = sensor - in_world;
                match map.find(&in_world, &towards_sensor, 3.0 * kernel_m) {
                    Some(Match::Plane(plane)) => {
                        let residual = plane.normal.dot(&(in_world - plane.point));
                        let n = rotation.transpose() * plane.normal;
                        let by_rotation = p.cross(&n);
                        let j = RowVector6::new(
                            by_rotation.x,
                            by_rotation.y,
                            by_rotation.z,
                            n.x,
                            n.y,
                            n.z,
                        );
                        let sigma = config.range_noise_m.max(plane.thickness_m);
                        let weight = geman_mcclure(residual * residual, kernel_m) / (sigma * sigma);
                        sum.hessian += j.transpose() * (j * weight);
                        sum.gradient += j.transpose() * (residual * weight);
                        if residual.abs() < kernel_m {
                            sum.inliers += 1;
                            sum.plane_inliers += 1;
                            sum.plane_squares += residual * residual;
                        }
                    }
                    Some(Match::Point(q)) => {
                        let residual = rotation.transpose() * (in_world - q);
                        let mut j = Matrix3x6::zeros();
                        j.fixed_view_mut::<3, 3>(0, 0).copy_from(&-so3::hat(p));
                        j.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
                        let squared = residual.norm_squared();
                        let scale = kernel_m.max(config.point_noise_m);
                        let weight = geman_mcclure(squared, scale)
                            / (config.point_noise_m * config.point_noise_m);
                        sum.hessian += j.transpose() * (j * weight);
                        sum.gradient += j.transpose() * (residual * weight);
                        if squared < scale * scale {
                            sum.inliers += 1;
                        }
                    }
                    None => {}
                }
            }
            sum
        })
        .collect();
    let mut total = partial.iter().fold(Normal::zero(), |a, b| a.plus(b));
    total.hessian /= config.points_per_independent;
    total.gradient /= config.points_per_independent;
    total
}

/// Weight of a residual: 1 at zero, falling with the fourth power beyond `scale`.
fn geman_mcclure(squared: f64, scale: f64) -> f64 {
    let s = scale * scale;
    (s / (s + squared)).powi(2)
}

impl Normal {
    fn zero() -> Self {
        Self {
            hessian: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            inliers: 0,
            plane_inliers: 0,
            plane_squares: 0.0,
        }
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            hessian: self.hessian + other.hessian,
            gradient: self.gradient + other.gradient,
            inliers: self.inliers + other.inliers,
            plane_inliers: self.plane_inliers + other.plane_inliers,
            plane_squares: self.plane_squares + other.plane_squares,
        }
    }
}

#[cfg(test)]
mod tests;
