//! Eq. (4): keyframe poses and points from LiDAR planes and edges, reprojections and the odometry.

use std::collections::BTreeMap;
use std::sync::Arc;

use lsfb_geometry::{Rig, Se3, StampedPose, Vector3};
use lsfb_perception::RelativePose;
use lsfb_solver::{Block, Kernel, Problem, Report};
use lsfb_types::ProgressFn;
use rayon::prelude::*;

use super::keyframes::{Keyframe, Keyframes};
use super::{LidarWeights, MappingConfig};
use crate::Error;
use crate::hd_map::{MapPoint, PointObservation};
use crate::lidar_features::{Correspondences, correspond};
use crate::residuals::{LidarEdge, LidarPlane, ObservingCamera, Reprojection};
use crate::solve::solve_or_stop;

/// Two keyframes whose scans are compared: features of `n` on surfaces of `m`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ScanPair {
    pub m: usize,
    pub n: usize,
}

/// Keyframes between two that are compared as neighbours and two that are compared as a revisit.
const REVISIT_GAP: usize = 8;

/// Neighbours along the path, and the nearest keyframes of earlier visits.
pub(super) fn scan_pairs(keyframes: &[Keyframe], config: &MappingConfig) -> Vec<ScanPair> {
    let mut pairs = Vec::new();
    for n in 0..keyframes.len() {
        let neighbours = (1..=config.scan_neighbours).filter_map(|back| n.checked_sub(back));
        pairs.extend(neighbours.map(|m| ScanPair { m, n }));
        let here = keyframes[n].world_from_rig.translation;
        let mut revisits: Vec<(f64, usize)> = keyframes[..n.saturating_sub(REVISIT_GAP)]
            .iter()
            .enumerate()
            .map(|(m, k)| ((k.world_from_rig.translation - here).norm(), m))
            .filter(|(distance, _)| *distance < config.revisit_distance_m)
            .collect();
        revisits.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        revisits.truncate(config.scan_revisits);
        pairs.extend(revisits.iter().map(|(_, m)| ScanPair { m: *m, n }));
    }
    pairs
}

/// Correspondences of the scan pairs at the current poses.
pub(super) fn scan_correspondences(
    keyframes: &[Keyframe],
    pairs: &[ScanPair],
    config: &MappingConfig,
) -> Vec<(ScanPair, Correspondences)> {
    pairs
        .par_iter()
        .filter_map(|pair| {
            let (m, n) = (&keyframes[pair.m], &keyframes[pair.n]);
            let m_from_n = m.world_from_rig.inverse() * n.world_from_rig;
            let found = correspond(
                m.lidar.as_ref()?,
                n.lidar.as_ref()?,
                &m_from_n,
                &config.lidar_features,
            );
            Some((*pair, found))
        })
        .collect()
}

/// Minimises Eq. (4); `keyframes` and `points` take the result.
pub(super) fn adjust(
    rig: &Rig,
    keyframes: &mut Keyframes,
    points: &mut [MapPoint],
    scans: &[(ScanPair, Correspondences)],
    odometry: &[StampedPose],
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<Report, Error> {
    let mut problem = Problem::new();
    let poses: Vec<Block<Se3>> = keyframes
        .frames
        .iter()
        .map(|k| problem.add_block(k.world_from_rig))
        .collect();
    // The first pose holds the map in place.
    if let Some(first) = poses.first() {
        problem.set_constant(*first);
    }
    for (pair, measured) in poses.windows(2).zip(odometry.windows(2)) {
        let root_secs = measured[1].time.secs_since(measured[0].time).sqrt();
        let residual = RelativePose::isotropic(
            measured[0].world_from_rig.inverse() * measured[1].world_from_rig,
            config.odometry_rotation_sigma_deg.to_radians() * root_secs,
            config.odometry_translation_sigma_m * root_secs,
        );
        problem.add_residual(residual, &[pair[0].id(), pair[1].id()], Kernel::Squared)?;
    }
    add_scans(&mut problem, &poses, scans, &config.lidar_weights)?;
    let observing: BTreeMap<&str, Arc<ObservingCamera>> = rig
        .cameras
        .iter()
        .map(|(name, camera)| (name.as_str(), ObservingCamera::new(camera)))
        .collect();
    let blocks: Vec<_> = points
        .iter()
        .map(|p| problem.add_eliminated_point(p.point_in_world))
        .collect();
    for (point, block) in points.iter().zip(&blocks) {
        for o in &point.observations {
            let image = &keyframes.images[o.image];
            let Some(camera) = observing.get(image.camera.as_str()) else {
                continue;
            };
            let residual = Reprojection {
                camera: camera.clone(),
                pixel: image.features.keypoints[o.keypoint as usize].pixel_f64(),
                sigma_px: config.pixel_sigma_px,
            };
            let kernel = Kernel::Huber { scale: 2.0 };
            problem.add_residual(residual, &[poses[image.keyframe].id(), block.id()], kernel)?;
        }
    }
    let report = solve_or_stop("map adjustment", &mut problem, &config.solver, progress)?;
    for (keyframe, block) in keyframes.frames.iter_mut().zip(&poses) {
        keyframe.world_from_rig = problem.value(*block);
    }
    for (point, block) in points.iter_mut().zip(&blocks) {
        point.point_in_world = problem.value(*block);
    }
    Ok(report)
}

fn add_scans(
    problem: &mut Problem,
    poses: &[Block<Se3>],
    scans: &[(ScanPair, Correspondences)],
    weights: &LidarWeights,
) -> Result<(), Error> {
    let kernel = Kernel::Cauchy { scale: 2.0 };
    for (pair, found) in scans {
        let blocks = [poses[pair.m].id(), poses[pair.n].id()];
        for f in &found.planes {
            let residual = LidarPlane {
                point_in_n: f.point_in_n,
                point_in_m: f.plane_in_m.point,
                normal_in_m: f.plane_in_m.normal,
                sigma_m: weights.plane_sigma_m,
            };
            problem.add_residual(residual, &blocks, kernel)?;
        }
        for f in &found.edges {
            let residual = LidarEdge {
                point_in_n: f.point_in_n,
                point_in_m: f.edge_in_m.point,
                direction_in_m: f.edge_in_m.direction,
                sigma_m: weights.edge_sigma_m,
            };
            problem.add_residual(residual, &blocks, kernel)?;
        }
    }
    Ok(())
}

/// Leaves out observations farther than `max_px` from where their point is seen, and points with fewer than two left;
/// brings the points' own errors up to date. Returns how many observations went.
pub(super) fn drop_outliers(
    rig: &Rig,
    keyframes: &Keyframes,
    points: &mut Vec<MapPoint>,
    max_px: f64,
) -> u64 {
    let count =
        |points: &[MapPoint]| -> u64 { points.iter().map(|p| p.observations.len() as u64).sum() };
    let before = count(points);
    for point in points.iter_mut() {
        let position = point.point_in_world;
        let error = |o: &PointObservation| reprojection_px(rig, keyframes, o, &position);
        point.observations.retain(|o| error(o) <= max_px);
        let squares: f64 = point.observations.iter().map(|o| error(o).powi(2)).sum();
        point.reprojection_rms_px = (squares / point.observations.len().max(1) as f64).sqrt();
    }
    points.retain(|p| p.observations.len() >= 2);
    before - count(points)
}

/// Reprojection errors of all observations, in order of the points; unseen ones are infinite.
pub(super) fn reprojection_errors_px(
    rig: &Rig,
    keyframes: &Keyframes,
    points: &[MapPoint],
) -> Vec<f64> {
    points
        .iter()
        .flat_map(|p| p.observations.iter().map(move |o| (p, o)))
        .map(|(p, o)| reprojection_px(rig, keyframes, o, &p.point_in_world))
        .collect()
}

/// Distance of where a point should be seen from where it is; infinite where it cannot be.
fn reprojection_px(
    rig: &Rig,
    keyframes: &Keyframes,
    observation: &PointObservation,
    point_in_world: &Vector3<f64>,
) -> f64 {
    let error = || {
        let image = keyframes.images.get(observation.image)?;
        let keypoint = image
            .features
            .keypoints
            .get(observation.keypoint as usize)?;
        let mounted = rig.cameras.get(&image.camera)?;
        let world_from_rig = keyframes.frames.get(image.keyframe)?.world_from_rig;
        let camera_from_world = (world_from_rig * mounted.rig_from_camera).inverse();
        let pixel = mounted
            .camera
            .project(&(camera_from_world * *point_in_world))?;
        Some((pixel - keypoint.pixel_f64()).norm())
    };
    error().unwrap_or(f64::INFINITY)
}
