//! The batch problem of eq. (5) over all frames.

use std::collections::BTreeSet;
use std::sync::Arc;

use lsfb_geometry::Vector2;
use lsfb_solver::{Kernel, Problem, Report};
use lsfb_types::ProgressFn;

use super::GroundTruthConfig;
use super::inertial::{StateBlocks, add_inertial_residuals};
use super::walk::{FixedObservation, Frame, LocalObservation, LocalPoint, State, Walk};
use crate::Error;
use crate::residuals::{FixedPointReprojection, ObservingCamera, Reprojection};
use crate::solve::solve_until_converged;

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
        if !point.is_determined() {
            point_blocks.push(None);
            continue;
        }
        let block = problem.add_eliminated_point(point.point_in_world);
        point_blocks.push(Some(block));
        for seen in point.observations.iter().filter(|seen| seen.used) {
            let residual = Reprojection {
                camera: walk.cameras[seen.camera].clone(),
                pixel: seen.pixel,
                sigma_px: config.local_sigma_px,
            };
            let pose = blocks[seen.frame].pose;
            problem.add_residual(residual, &[pose.id(), block.id()], kernel)?;
        }
    }
    add_inertial_residuals(&mut problem, walk, &blocks, config)?;
    let report = solve_until_converged("bundle adjustment", &mut problem, &config.solve, progress)?;
    Ok(Optimized {
        states: blocks.iter().map(|b| b.read(&problem)).collect(),
        points: points
            .iter()
            .zip(point_blocks)
            .map(|(point, block)| LocalPoint {
                point_in_world: block.map_or(point.point_in_world, |b| problem.value(b)),
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

/// Uses of what was recognised and followed that which now lies within the gate of where it should be, whether it was used
/// before or not; in each image each keypoint and each point of the map once, at the smaller error. Returns how many
/// observations came or went.
pub(super) fn choose_observations(
    walk: &mut Walk,
    states: &[State],
    points: &mut [LocalPoint],
    config: &GroundTruthConfig,
) -> usize {
    let mut changed = 0;
    for (frame, state) in walk.frames.iter_mut().zip(states) {
        let within = within_gate(&walk.cameras, state, frame, config);
        let came = within.iter().filter(|seen| !frame.fixed.contains(seen));
        changed += came.count();
        let went = frame.fixed.iter().filter(|seen| !within.contains(seen));
        changed += went.count();
        frame.fixed = within;
    }
    for point in points.iter_mut() {
        for k in 0..point.observations.len() {
            let error_px = local_error_px(walk, states, point, &point.observations[k]);
            let used = error_px <= config.max_error_px;
            changed += usize::from(used != point.observations[k].used);
            point.observations[k].used = used;
        }
    }
    changed
}

/// Of what a frame recognised, that which lies where it should be.
pub(super) fn within_gate(
    cameras: &[Arc<ObservingCamera>],
    state: &State,
    frame: &Frame,
    config: &GroundTruthConfig,
) -> Vec<FixedObservation> {
    let mut near: Vec<(f64, FixedObservation)> = frame
        .recognised
        .iter()
        .map(|seen| (fixed_error_px(cameras, state, seen), *seen))
        .filter(|(error_px, _)| *error_px <= config.max_error_px)
        .collect();
    near.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let mut chosen: Vec<FixedObservation> = Vec::with_capacity(near.len());
    let (mut keypoints, mut points) = (BTreeSet::new(), BTreeSet::new());
    for (_, seen) in near {
        let free = !keypoints.contains(&(seen.camera, seen.keypoint))
            && !points.contains(&(seen.camera, seen.point));
        if free {
            keypoints.insert((seen.camera, seen.keypoint));
            points.insert((seen.camera, seen.point));
            chosen.push(seen);
        }
    }
    chosen.sort_by_key(|seen| (seen.camera, seen.keypoint));
    chosen
}
