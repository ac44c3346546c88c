//! The pose of a camera to the LiDAR from corners on surfaces (the paper's Eq. 4, with the calibration as an unknown).
//!
//! A corner `X` on a plane `(q, n)` that the LiDAR saw, in an image taken when the LiDAR was at `T`:
//!
//! `Σ ‖π((T exp(ξ) exp(v τ) E)⁻¹ X) − x‖² / σ² + Σ (nᵀ(X − q))² / σ_p² + Σ ξᵀ Σ_ξ⁻¹ ξ`
//!
//! over the camera's pose `E` on the LiDAR, the camera's clock `τ`, each image's own error of the odometry `ξ`, and all corners. `v` is
//! the LiDAR's velocity at that time. Spreads `σ`, `σ_p` and the two of `Σ_ξ` are measured along with it. Blocks of images share `E`
//! and `τ` alone: how well blocks agree on these seven numbers says what they are worth.

mod block;

use lsfb_geometry::{Camera, Se3};
use lsfb_solver::gauss_newton::NormalEquations;
use lsfb_solver::{
    self as solver, Diagnosis, Kernel, PosePrior, Problem, SolveConfig, VectorPrior, solve,
};
use nalgebra::{SMatrix, SVector, Vector1};
use rayon::prelude::*;

use super::noise::{Left, Noise, START};
pub(super) use block::Block;
use block::Part;

/// The six numbers of the pose, in the camera's axes, and the clock.
pub(super) const SHARED: usize = 7;
pub(super) type SharedMatrix = SMatrix<f64, SHARED, SHARED>;
pub(super) type SharedVector = SVector<f64, SHARED>;

/// How far a pose by hand may be wrong (rad, m), and how far clocks may be that were calibrated (s): standard deviations.
pub(super) const BY_HAND: [f64; 2] = [0.026, 0.03];
pub(super) const CLOCK_S: f64 = 1e-3;

/// Times that all is adjusted with the spreads measured before, at least and at most.
const ROUNDS: [usize; 2] = [7, 25];
/// A round that moves less is the last: radians, metres.
const SHORTEST: [f64; 2] = [2e-6, 1e-5];
/// Steps of a round at most: spreads change again after it. And of the last adjustment, with the share of the cost that ends it.
const FEW: (usize, f64) = (3, 1e-4);
const MANY: (usize, f64) = (20, 1e-7);
/// What all images share.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shared {
    /// The camera's pose on the LiDAR.
    pub lidar_from_camera: Se3,
    /// What is to be added to the camera's times.
    pub delay_s: f64,
}

/// Normal equations over what is shared.
pub(super) type Normal = NormalEquations<SHARED>;

/// What was found.
pub(super) struct Adjusted {
    pub shared: Shared,
    pub noise: Noise,
    /// By block, at what was found.
    pub normals: Vec<Normal>,
}

/// Starts from a pose that is known as well as by hand. Numbers in `held` stay as they are there.
pub(super) fn adjusted(
    camera: &Camera,
    blocks: &mut [Block],
    start: &Se3,
    first: &Shared,
    held: &[usize],
) -> Option<Adjusted> {
    let (mut shared, mut noise) = (*first, START);
    for round in 1..=ROUNDS[1] {
        let before = shared;
        shared = solved(camera, blocks, &shared, &noise, (start, held), FEW)?;
        let step = before.lidar_from_camera.local(&shared.lidar_from_camera);
        let still = step.fixed_rows::<3>(0).norm() < SHORTEST[0]
            && step.fixed_rows::<3>(3).norm() < SHORTEST[1];
        if still && round >= ROUNDS[0] {
            break;
        }
        let left: Vec<Left> = blocks
            .par_iter()
            .map(|b| b.left(camera, &shared, &noise))
            .collect::<Option<_>>()?;
        noise = noise.measured(&left);
    }
    shared = solved(camera, blocks, &shared, &noise, (start, held), MANY)?;
    let normals = blocks
        .par_iter()
        .map(|b| b.normal(camera, &shared, &noise))
        .collect::<Option<_>>()?;
    Some(Adjusted {
        shared,
        noise,
        normals,
    })
}

/// All blocks adjusted together, with spreads that are known.
fn solved(
    camera: &Camera,
    blocks: &mut [Block],
    shared: &Shared,
    noise: &Noise,
    (start, held): (&Se3, &[usize]),
    (max_iterations, cost_tolerance): (usize, f64),
) -> Option<Shared> {
    let config = SolveConfig {
        max_iterations,
        cost_tolerance,
        diagnosis: Diagnosis::Off,
        ..SolveConfig::default()
    };
    let mut problem = Problem::new();
    let known = Shared {
        lidar_from_camera: *start,
        delay_s: 0.0,
    };
    let unknown = shared.put_into(&mut problem, &known)?;
    let pose = unknown.lidar_from_camera;
    problem.set_constant_components(pose, held).ok()?;
    let parts: Vec<Part> = blocks
        .iter()
        .map(|b| b.put_into(&mut problem, camera, &unknown, noise))
        .collect::<Option<_>>()?;
    solve(&mut problem, &config).ok()?;
    for (block, part) in blocks.iter_mut().zip(&parts) {
        block.read_back(&problem, part);
    }
    Some(unknown.values(&problem))
}

/// All blocks together with what was known before.
pub(super) fn total(normals: &[Normal], start: &Se3, shared: &Shared, held: &[usize]) -> Normal {
    const FAST: f64 = 1e14;
    let off = start.local(&shared.lidar_from_camera);
    let deviation = SharedVector::from_fn(|k, _| if k < 6 { off[k] } else { shared.delay_s });
    let mut known = by_hand();
    for k in held {
        known[*k] = FAST;
    }
    let mut all = Normal::default();
    all.add_prior(&deviation, &SharedMatrix::from_diagonal(&known));
    for normal in normals {
        all.add_all(normal);
    }
    all
}

/// Information of a pose by hand and of a clock that was calibrated.
fn by_hand() -> SharedVector {
    SharedVector::from_fn(|k, _| {
        let sigma = if k < 6 { BY_HAND[k / 3] } else { CLOCK_S };
        1.0 / (sigma * sigma)
    })
}

/// What is shared, in a problem.
struct Unknown {
    lidar_from_camera: solver::Block<Se3>,
    delay_s: solver::Block<Vector1<f64>>,
}

impl Unknown {
    fn values(&self, problem: &Problem) -> Shared {
        Shared {
            lidar_from_camera: problem.value(self.lidar_from_camera),
            delay_s: problem.value(self.delay_s).x,
        }
    }
}

impl Shared {
    pub fn moved(&self, step: &SharedVector) -> Self {
        Self {
            lidar_from_camera: self
                .lidar_from_camera
                .retract(&step.fixed_rows::<6>(0).into()),
            delay_s: self.delay_s + step[6],
        }
    }

    /// Adds it to a problem, known as well as by hand around `known`.
    fn put_into(&self, problem: &mut Problem, known: &Self) -> Option<Unknown> {
        let unknown = Unknown {
            lidar_from_camera: problem.add_block(self.lidar_from_camera),
            delay_s: problem.add_block(Vector1::new(self.delay_s)),
        };
        let pose = PosePrior::isotropic(known.lidar_from_camera, BY_HAND[0], BY_HAND[1]);
        let clock = VectorPrior::new(Vector1::new(known.delay_s), Vector1::new(CLOCK_S));
        let (pose_id, clock_id) = (unknown.lidar_from_camera.id(), unknown.delay_s.id());
        let added = problem.add_residual(pose, &[pose_id], Kernel::Squared);
        added.ok()?;
        let added = problem.add_residual(clock, &[clock_id], Kernel::Squared);
        added.ok().map(|_| unknown)
    }
}

#[cfg(test)]
mod tests;
