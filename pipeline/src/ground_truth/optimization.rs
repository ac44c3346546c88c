//! The batch problem of eq. (5) over all frames.

use std::sync::Arc;

use lsfb_geometry::Vector2;
use lsfb_solver::{Kernel, Problem, Report};
use lsfb_types::ProgressFn;

use super::GroundTruthConfig;
use super::inertial::{StateBlocks, add_inertial_residuals};
use super::walk::{FixedObservation, LocalObservation, LocalPoint, State, Walk};
use crate::Error;
use crate::residuals::{FixedPointReprojection, ObservingCamera, Reprojection};
use crate::solve::solve_or_stop;

/// States and local points after a solve.
pub(super) struct Optimized {
    pub states: Vec<State>,
    pub points: Vec<LocalPoint>,
    pub report: Report,
}

/// Minimises eq. (5) over all states and local points: fixed points of the HD map, local points, preintegrated IMU.
pub(super) fn optimize(
    walk: &Walk,
    states: &[State],
    points: &[LocalPoint],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Optimized, Error> {
    let kernel = Kernel::Cauchy {
        scale: config.kernel_scale,
    };
    let mut problem = Problem::new();
    let blocks: Vec<StateBlocks> = states
        .iter()
        .map(|state| StateBlocks::add(&mut problem, state))
        .collect();
    for (frame, state) in walk.frames.iter().zip(&blocks) {
        for seen in &frame.fixed {
            let residual = FixedPointReprojection {
                camera: walk.cameras[seen.camera].clone(),
                point_in_world: seen.point_in_world,
                pixel: seen.pixel,
                sigma_px: config.map_sigma_px,
            };
            problem.add_residual(residual, &[state.pose.id()], kernel)?;
        }
    }
    let mut point_blocks = Vec::with_capacity(points.len());
    for point in points {
        let block = problem.add_eliminated_point(point.point_in_world);
        point_blocks.push(block);
        for seen in &point.observations {
            let residual = Reprojection {
                camera: walk.cameras[seen.camera].clone(),
                pixel: seen.pixel,
                sigma_px: config.local_sigma_px,
            };
            let pose = blocks[seen.frame].pose;
            problem.add_residual(residual, &[pose.id(), block.id()], kernel)?;
        }
    }
    let intervals = walk.preintegrate(|k| states[k].bias)?;
    add_inertial_residuals(&mut problem, walk, &blocks, &intervals, config)?;
    let report = solve_or_stop("bundle adjustment", &mut problem, &config.solve, progress)?;
    Ok(Optimized {
        states: blocks.iter().map(|b| b.read(&problem)).collect(),
        points: points
            .iter()
            .zip(point_blocks)
            .map(|(point, block)| LocalPoint {
                point_in_world: problem.value(block),
                observations: point.observations.clone(),
            })
            .collect(),
        report,
    })
}

/// Reprojection error of a map point, pixels; infinite behind the lens.
pub(super) fn fixed_error_px(
    cameras: &[Arc<ObservingCamera>],
    state: &State,
    seen: &FixedObservation,
) -> f64 {
    let found = cameras[seen.camera].project(&state.nav.world_from_rig, &seen.point_in_world);
    distance(found, &seen.pixel)
}

/// Reprojection error of a local point, pixels; infinite behind the lens.
pub(super) fn local_error_px(
    walk: &Walk,
    states: &[State],
    point: &LocalPoint,
    seen: &LocalObservation,
) -> f64 {
    let pose = &states[seen.frame].nav.world_from_rig;
    let found = walk.cameras[seen.camera].project(pose, &point.point_in_world);
    distance(found, &seen.pixel)
}

fn distance(found: Option<Vector2<f64>>, seen: &Vector2<f64>) -> f64 {
    found.map_or(f64::INFINITY, |pixel| (pixel - seen).norm())
}

/// Takes out of walk and points what lies farther than the gate from where it should be; points with fewer than two
/// sights left go too. Returns the number of observations taken out.
pub(super) fn drop_outliers(
    walk: &mut Walk,
    states: &[State],
    points: &mut Vec<LocalPoint>,
    config: &GroundTruthConfig,
) -> usize {
    let mut dropped = 0;
    let Walk {
        cameras, frames, ..
    } = walk;
    for (frame, state) in frames.iter_mut().zip(states) {
        let before = frame.fixed.len();
        frame
            .fixed
            .retain(|seen| fixed_error_px(cameras, state, seen) <= config.max_error_px);
        dropped += before - frame.fixed.len();
    }
    for point in points.iter_mut() {
        let copy = point.clone();
        point
            .observations
            .retain(|seen| local_error_px(walk, states, &copy, seen) <= config.max_error_px);
        dropped += copy.observations.len() - point.observations.len();
    }
    points.retain(|point| point.observations.len() >= 2);
    dropped
}
