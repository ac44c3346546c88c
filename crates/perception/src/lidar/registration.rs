//! Registration of a scan to what is known of a place: Gauss–Newton on SE(3) with point-to-plane residuals where it is flat
//! and point-to-point residuals elsewhere, a Gaussian prior on the pose, and a robust kernel that tightens.

use std::cell::Cell;

use lsfb_geometry::{Matrix3, Matrix6, Se3, Vector3, Vector6, so3};
use nalgebra::Matrix3x6;
use rayon::prelude::*;

use super::plane::Plane;
use lsfb_solver::gauss_newton::{Next, NormalEquations, minimise};

/// What a point of a scan is registered to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Match {
    /// The plane it should lie on.
    Plane(Plane),
    /// The place it should be at, where nothing is flat.
    Point(Vector3<f64>),
}

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
    /// What counts less.
    pub weighting: Weighting,
}

/// How points that do not lie on their planes lose weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Weighting {
    /// Beyond the width of a kernel, the same for all planes, that tightens as the pose is found (Geman and McClure).
    Tightening,
    /// Beyond so many standard deviations of each plane (Cauchy): for planes of which some are only two rings on two surfaces.
    ByPlane {
        /// Where the weight is halved.
        deviations: f64,
    },
}

/// A registered scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// Pose of the rig: the best of scan and prior.
    pub world_from_rig: Se3,
    /// Information the scan alone gives on the pose, without the prior.
    pub information: Matrix6<f64>,
    /// The part of it that planes give. Points that are drawn to the nearest mean of a surface hold a scan along that surface too, where
    /// rings lie on rings: that looks like information and is none.
    pub plane_information: Matrix6<f64>,
    /// Share of the points that agree with the map within the final kernel.
    pub inlier_ratio: f64,
    /// Root mean square of the plane distances of those, metres.
    pub plane_rms_m: f64,
    /// Iterations taken.
    pub iterations: u32,
}

/// What the scan says at one pose.
#[derive(Clone, Copy, Default)]
struct Terms {
    equations: NormalEquations<6>,
    plane_information: Matrix6<f64>,
    inliers: u32,
    plane_inliers: u32,
    plane_squares: f64,
}

/// Points per task: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 256;

/// A step shorter than this ends the search: radians, metres.
const STILL_RAD: f64 = 2e-5;
const STILL_M: f64 = 2e-4;

/// Registers points in the rig. `matches` says what each belongs to at a pose, at most so many metres away.
pub fn register(
    points_in_rig: &[Vector3<f64>],
    prior: &PosePrior,
    config: &RegistrationConfig,
    mut matches: impl FnMut(&Se3, f64) -> Vec<Option<Match>>,
) -> Registration {
    let gate_m = Cell::new(config.gate_m);
    let kernel_m = || (gate_m.get() / 3.0).max(config.min_kernel_m);
    let mut last = Terms::default();
    let terms = |pose: &Se3| {
        let matches = matches(pose, 3.0 * kernel_m());
        last = linearize(points_in_rig, &matches, pose, kernel_m(), config);
        let mut equations = last.equations;
        // The prior's own Jacobian is the identity to first order in a deviation of millimetres and milliradians.
        equations.add_prior(&prior.world_from_rig.local(pose), &prior.information);
        Some(equations)
    };
    let mut iterations = 0;
    let inspect = |step: &mut Vector6<f64>| {
        iterations += 1;
        let still =
            step.fixed_rows::<3>(0).norm() < STILL_RAD && step.fixed_rows::<3>(3).norm() < STILL_M;
        if still && kernel_m() <= config.min_kernel_m {
            return Next::Settled;
        }
        // Once a kernel has converged the next is half as wide.
        if still || iterations % 4 == 0 || gate_m.get() < 1.0 {
            gate_m.set(gate_m.get() * 0.5);
        }
        Next::Iterate
    };
    let found = minimise(prior.world_from_rig, config.max_iterations, terms, inspect);
    let Some(found) = found else {
        // Nothing is known: neither by the scan nor before.
        return Registration {
            world_from_rig: prior.world_from_rig,
            information: Matrix6::zeros(),
            plane_information: Matrix6::zeros(),
            inlier_ratio: 0.0,
            plane_rms_m: 0.0,
            iterations,
        };
    };
    Registration {
        world_from_rig: found.value,
        information: last.equations.information,
        plane_information: last.plane_information,
        inlier_ratio: f64::from(last.inliers) / points_in_rig.len().max(1) as f64,
        plane_rms_m: (last.plane_squares / f64::from(last.plane_inliers.max(1))).sqrt(),
        iterations: found.iterations,
    }
}

fn linearize(
    points_in_rig: &[Vector3<f64>],
    matches: &[Option<Match>],
    world_from_rig: &Se3,
    kernel_m: f64,
    config: &RegistrationConfig,
) -> Terms {
    let rotation = world_from_rig.rotation_matrix();
    let partial: Vec<Terms> = points_in_rig
        .par_chunks(CHUNK)
        .zip(matches.par_chunks(CHUNK))
        .map(|(points, matches)| {
            let mut sum = Terms::default();
            for (p, found) in points.iter().zip(matches) {
                let in_world = rotation * p + world_from_rig.translation;
                match found {
                    Some(Match::Plane(plane)) => {
                        sum.add_plane(p, &in_world, plane, &rotation, kernel_m, config);
                    }
                    Some(Match::Point(q)) => {
                        sum.add_point(p, &(in_world - q), &rotation, kernel_m, config);
                    }
                    None => {}
                }
            }
            sum
        })
        .collect();
    let mut total = partial.iter().fold(Terms::default(), |a, b| a.plus(b));
    total.equations.information /= config.points_per_independent;
    total.equations.gradient /= config.points_per_independent;
    total.plane_information /= config.points_per_independent;
    total
}

/// Weight of a residual: 1 at zero, falling with the fourth power beyond `scale`.
fn geman_mcclure(squared: f64, scale: f64) -> f64 {
    let s = scale * scale;
    (s / (s + squared)).powi(2)
}

impl Terms {
    fn add_plane(
        &mut self,
        p: &Vector3<f64>,
        in_world: &Vector3<f64>,
        plane: &Plane,
        rotation: &Matrix3<f64>,
        kernel_m: f64,
        config: &RegistrationConfig,
    ) {
        let residual = plane.normal.dot(&(in_world - plane.point));
        let n = rotation.transpose() * plane.normal;
        let by_rotation = p.cross(&n);
        let derivative = Vector6::new(by_rotation.x, by_rotation.y, by_rotation.z, n.x, n.y, n.z);
        let sigma = config.range_noise_m.max(plane.thickness_m);
        let share = match config.weighting {
            Weighting::Tightening => geman_mcclure(residual * residual, kernel_m),
            Weighting::ByPlane { deviations } => {
                1.0 / (1.0 + (residual / (deviations * sigma)).powi(2))
            }
        };
        let weight = share / (sigma * sigma);
        self.equations.add(residual, &derivative, weight);
        self.plane_information += derivative * (derivative.transpose() * weight);
        if residual.abs() < kernel_m {
            self.inliers += 1;
            self.plane_inliers += 1;
            self.plane_squares += residual * residual;
        }
    }

    fn add_point(
        &mut self,
        p: &Vector3<f64>,
        off_in_world: &Vector3<f64>,
        rotation: &Matrix3<f64>,
        kernel_m: f64,
        config: &RegistrationConfig,
    ) {
        let residual = rotation.transpose() * off_in_world;
        let mut jacobian = Matrix3x6::zeros();
        jacobian
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&-so3::hat(p));
        jacobian.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
        let squared = residual.norm_squared();
        let scale = kernel_m.max(config.point_noise_m);
        let variance = config.point_noise_m * config.point_noise_m;
        let weight = geman_mcclure(squared, scale) / variance;
        self.equations.add_block(&residual, &jacobian, weight);
        if squared < scale * scale {
            self.inliers += 1;
        }
    }

    fn plus(mut self, other: &Self) -> Self {
        self.equations.add_all(&other.equations);
        self.plane_information += other.plane_information;
        self.inliers += other.inliers;
        self.plane_inliers += other.plane_inliers;
        self.plane_squares += other.plane_squares;
        self
    }
}
