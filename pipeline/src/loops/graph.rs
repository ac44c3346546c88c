//! The graph of keyframes: steps of the odometry, and loops.

use lsfb_geometry::{Matrix6, Se3, Vector6, so3};
use lsfb_perception::RelativePose;
use lsfb_solver::{Block, Kernel, Problem, SolveConfig, covariance};
use lsfb_types::ProgressFn;

use super::assessment::CHI_SQUARED;
use super::keyframes::Keyframe;
use super::ways::step_covariance;
use super::{Measured, MeasuredLoop};
use crate::Error;
use crate::solve::{solve_or_stop, solve_until_converged};

/// By how much kernels are narrowed in each iteration while loops are told from false ones.
const GRADUATION: f64 = 1.4;
/// Iterations of that: from nearly quadratic to the kernel's own width, and to rest there.
const GRADUATED_ITERATIONS: usize = 120;
/// Keyframes whose covariances are taken at once: memory grows with the square.
const COVARIANCES_AT_ONCE: usize = 60;

/// Poses of the keyframes once loops are closed.
#[derive(Clone, Debug)]
pub(super) struct Closed {
    pub world_from_rig: Vec<Se3>,
    /// Relative to the first, in the tangent of each.
    pub covariances: Vec<Matrix6<f64>>,
}

/// Which loops fit all others and the odometry, where those that do not lose their weight.
pub(crate) fn fitting(
    keyframes: &[Keyframe],
    loops: &[Measured],
    progress: ProgressFn<'_>,
) -> Result<Vec<bool>, Error> {
    let kernel = Kernel::GemanMcClure {
        scale: CHI_SQUARED.sqrt(),
    };
    let (mut problem, poses) = problem(keyframes, loops, kernel)?;
    let config = SolveConfig {
        graduation: GRADUATION,
        max_iterations: GRADUATED_ITERATIONS,
        ..SolveConfig::default()
    };
    solve_or_stop("rejecting false loops", &mut problem, &config, progress)?;
    let fits = |l: &Measured| {
        let (a, b) = (
            problem.value(poses[l.earlier]),
            problem.value(poses[l.later]),
        );
        squared_sigmas(&a, &b, &l.loop_) < CHI_SQUARED
    };
    Ok(loops.iter().map(fits).collect())
}

/// Where all of these loops are closed.
pub(crate) fn closed_poses(
    keyframes: &[Keyframe],
    loops: &[Measured],
    progress: ProgressFn<'_>,
) -> Result<Vec<Se3>, Error> {
    let (problem, poses) = solved(keyframes, loops, progress)?;
    Ok(poses.iter().map(|p| problem.value(*p)).collect())
}

fn solved(
    keyframes: &[Keyframe],
    loops: &[Measured],
    progress: ProgressFn<'_>,
) -> Result<(Problem, Vec<Block<Se3>>), Error> {
    let (mut problem, poses) = problem(keyframes, loops, Kernel::Squared)?;
    let config = SolveConfig::default();
    solve_until_converged("loops closed", &mut problem, &config, progress)?;
    Ok((problem, poses))
}

/// Closes all of these loops.
pub(super) fn close(
    keyframes: &[Keyframe],
    loops: &[Measured],
    progress: ProgressFn<'_>,
) -> Result<Closed, Error> {
    let (problem, poses) = solved(keyframes, loops, progress)?;
    let mut covariances = vec![Matrix6::zeros()];
    for some in poses[1..].chunks(COVARIANCES_AT_ONCE) {
        let ids: Vec<_> = some.iter().map(|block| block.id()).collect();
        let found = covariance(&problem, &ids)?;
        covariances.extend(ids.iter().map(|id| {
            let of_pose = found.between(*id, *id);
            of_pose.map_or_else(Matrix6::zeros, |m| m.fixed_view::<6, 6>(0, 0).into_owned())
        }));
    }
    Ok(Closed {
        world_from_rig: poses.iter().map(|p| problem.value(*p)).collect(),
        covariances,
    })
}

/// How far two poses are from a loop, in its standard deviations, squared.
pub(crate) fn squared_sigmas(earlier: &Se3, later: &Se3, measured: &MeasuredLoop) -> f64 {
    let found = earlier.inverse() * *later;
    let expected = &measured.earlier_from_later;
    let turn = so3::log(&(expected.rotation.inverse() * found.rotation));
    let shift = found.translation - expected.translation;
    (turn / measured.rotation_sigma_rad).norm_squared()
        + (shift / measured.translation_sigma_m).norm_squared()
}

fn problem(
    keyframes: &[Keyframe],
    loops: &[Measured],
    of_loops: Kernel,
) -> Result<(Problem, Vec<Block<Se3>>), Error> {
    let mut problem = Problem::new();
    let poses: Vec<_> = keyframes
        .iter()
        .map(|k| problem.add_block(k.world_from_rig))
        .collect();
    if let Some(first) = poses.first() {
        problem.set_constant(*first);
    }
    for (pair, blocks) in keyframes.windows(2).zip(poses.windows(2)) {
        let a_from_b = pair[0].world_from_rig.inverse() * pair[1].world_from_rig;
        let step = RelativePose {
            a_from_b,
            sqrt_information: root_of_information(
                &step_covariance(&pair[0], &pair[1], 1.0),
                &a_from_b,
            ),
        };
        let blocks = [blocks[0].id(), blocks[1].id()];
        problem.add_residual(step, &blocks, Kernel::Squared)?;
    }
    for l in loops {
        let measured = RelativePose::isotropic(
            l.loop_.earlier_from_later,
            l.loop_.rotation_sigma_rad,
            l.loop_.translation_sigma_m,
        );
        let blocks = [poses[l.earlier].id(), poses[l.later].id()];
        problem.add_residual(measured, &blocks, of_loops)?;
    }
    Ok((problem, poses))
}

/// Of a covariance in the tangent of `b`, for a residual whose translation is in `a`.
fn root_of_information(covariance_in_b: &Matrix6<f64>, a_from_b: &Se3) -> Matrix6<f64> {
    let mut turned = Matrix6::identity();
    turned
        .fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&a_from_b.rotation_matrix());
    let covariance = turned * covariance_in_b * turned.transpose();
    // Steps have a floor: their covariance is one.
    let covariance = (covariance + covariance.transpose()) * 0.5;
    covariance
        .cholesky()
        .and_then(|c| c.inverse().cholesky())
        .map_or_else(
            || Matrix6::from_diagonal(&Vector6::repeat(1.0)),
            |c| c.l().transpose(),
        )
}
