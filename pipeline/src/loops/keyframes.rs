//! The scans between which loops are sought.

use std::collections::BTreeSet;

use lsfb_geometry::{Matrix6, RigLidar, Se3, Vector3};
use lsfb_perception::lidar::LocalMap;
use lsfb_types::Timestamp;
use nalgebra::SymmetricEigen;

use crate::odometry::{DeskewedCloud, OdometryConfig, OdometryResult, ScanPose};
use crate::place_search::thinned;

/// Distance between keyframes, metres.
const SPACING_M: f64 = 1.0;
/// Turn between keyframes, radians.
const SPACING_RAD: f64 = 0.5;
/// Distance between scans that make a submap, metres.
pub(super) const SUBMAP_SPACING_M: f64 = 0.45;
/// Points of a scan that is registered, at most.
const QUERY_POINTS: usize = 2000;

/// A scan, or a frame of images, between which and others loops are sought.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Keyframe {
    /// Which of the scans that found their place, or of the frames.
    pub scan: usize,
    pub time: Timestamp,
    pub world_from_rig: Se3,
    /// Relative to the first of them, in the tangent of this pose.
    pub covariance: Matrix6<f64>,
    /// Way from the first scan, metres.
    pub path_m: f64,
}

/// The scans of a walk that found their place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scans<'a> {
    pub poses: &'a [ScanPose],
    pub clouds: &'a [DeskewedCloud],
    /// Way from the first scan to each, metres.
    pub paths_m: &'a [f64],
    pub lidar: &'a RigLidar,
}

/// Whether a scan is far enough from the last keyframe to be one.
pub(super) fn is_apart(last: Option<&Keyframe>, world_from_rig: &Se3) -> bool {
    last.is_none_or(|last| {
        let moved = last.world_from_rig.inverse() * *world_from_rig;
        moved.translation.norm() > SPACING_M || moved.rotation.angle() > SPACING_RAD
    })
}

/// Of the scans that found their place those that are apart, the first always.
pub(super) fn choose(result: &OdometryResult) -> Vec<Keyframe> {
    with(result, &BTreeSet::new())
}

/// The same, with those that ended at certain times besides.
pub(super) fn with(result: &OdometryResult, ends: &BTreeSet<Timestamp>) -> Vec<Keyframe> {
    let mut chosen: Vec<Keyframe> = Vec::new();
    for (scan, path_m) in paths_m(result).into_iter().enumerate() {
        let at = &result.scan_poses[scan];
        if ends.contains(&at.pose.time) || is_apart(chosen.last(), &at.pose.world_from_rig) {
            chosen.push(Keyframe {
                scan,
                time: at.pose.time,
                world_from_rig: at.pose.world_from_rig,
                covariance: at.covariance,
                path_m,
            });
        }
    }
    chosen
}

/// Way from the first scan to each, metres.
pub(super) fn paths_m(result: &OdometryResult) -> Vec<f64> {
    let mut path_m = 0.0;
    let mut last: Option<Se3> = None;
    let poses = result.scan_poses.iter().map(|s| s.pose.world_from_rig);
    poses
        .map(|pose| {
            let moved = last.map_or(0.0, |l: Se3| (pose.translation - l.translation).norm());
            last = Some(pose);
            path_m += moved;
            path_m
        })
        .collect()
}

/// What a pose that follows another adds to its covariance: never less than nothing.
pub(super) fn added(
    covariance: &Matrix6<f64>,
    before: &Matrix6<f64>,
    here_from_before: &Se3,
) -> Matrix6<f64> {
    let adjoint = here_from_before.adjoint();
    let difference = covariance - adjoint * before * adjoint.transpose();
    let eigen = SymmetricEigen::new((difference + difference.transpose()) * 0.5);
    let kept = Matrix6::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0)));
    eigen.eigenvectors * kept * eigen.eigenvectors.transpose()
}

/// The points of a scan, thinned evenly.
pub(super) fn query_points(cloud: &DeskewedCloud) -> Vec<Vector3<f64>> {
    thinned(&points(cloud).collect::<Vec<_>>(), QUERY_POINTS)
}

/// The points of a scan.
pub(super) fn points(cloud: &DeskewedCloud) -> impl Iterator<Item = Vector3<f64>> {
    let all = cloud.points_in_rig.iter();
    all.map(|p| Vector3::new(p[0], p[1], p[2]).map(f64::from))
}

/// The map of the scans up to `reach_m` before and after a keyframe, none after `last_path_m`, in that keyframe's rig frame.
pub(super) fn submap(
    scans: &Scans<'_>,
    centre: &Keyframe,
    reach_m: f64,
    last_path_m: f64,
    config: &OdometryConfig,
) -> LocalMap {
    let mut map = LocalMap::new(config.local_map(scans.lidar));
    let sensor_in_rig = scans.lidar.rig_from_lidar.translation;
    let centre_from_world = centre.world_from_rig.inverse();
    let mut last_m = f64::NEG_INFINITY;
    for (scan, path_m) in scans.paths_m.iter().copied().enumerate() {
        let is_near = (path_m - centre.path_m).abs() <= reach_m && path_m <= last_path_m;
        if scan != centre.scan && (!is_near || path_m - last_m < SUBMAP_SPACING_M) {
            continue;
        }
        last_m = path_m;
        let centre_from_rig = centre_from_world * scans.poses[scan].pose.world_from_rig;
        let points: Vec<_> = points(&scans.clouds[scan]).collect();
        map.insert(&points, &centre_from_rig, &sensor_in_rig);
    }
    map
}
