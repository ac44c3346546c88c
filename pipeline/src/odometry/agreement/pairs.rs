//! Whether the trajectory has scans where these lie on each other.
//!
//! Where scans come often each is held by the IMU more than by the map, and what the map is drawn from is drawn away with it: an IMU that is wrong
//! in one axis bends a walk by metres, in which every scan lies on the map. So scans are taken a second later, registered to those about the first
//! alone by planes and without the IMU's help, and held against the trajectory along the directions that they see.

use lsfb_geometry::{Matrix6, RigLidar, Se3, StampedPose, Vector3, Vector6};
use lsfb_perception::lidar::{LocalMap, Match, PosePrior, observability, register};
use lsfb_perception::statistics::median;
use rayon::prelude::*;

use crate::odometry::OdometryConfig;
use crate::odometry::degeneracy::LEAST_SEEN_PER_M2;

/// From the scan in the middle of the map to the one that is registered, seconds: at least and at most.
const LATER_S: std::ops::RangeInclusive<f64> = 0.9..=1.3;
/// Scans before and behind the middle one that the map is made of as well: one alone is rings.
const BESIDE: usize = 3;
/// Pairs that are looked at, at most and at least.
const MAX_PAIRS: usize = 40;
const MIN_PAIRS: usize = 8;
/// Farthest correspondences, metres.
const GATE_M: f64 = 1.0;
/// A pair of which less lies on each other tells nothing.
const MIN_OVERLAP: f64 = 0.4;
/// Half of the pairs are off by more: metres. Right ones come to a centimetre or two.
const OFF_M: f64 = 0.06;

/// Scans and where the trajectory has them.
#[derive(Clone, Copy, Debug)]
pub(in crate::odometry) struct Scans<'a> {
    pub poses: &'a [StampedPose],
    /// Points of each in the rig, metres.
    pub clouds: &'a [&'a [[f32; 3]]],
    pub lidar: &'a RigLidar,
}

/// By how much half of the pairs are off at least, metres, where that is more than registration errs.
pub(in crate::odometry) fn pairs_off(scans: &Scans<'_>, config: &OdometryConfig) -> Option<f64> {
    let poses = scans.poses;
    let later = |first: usize| {
        let start = poses[first].time;
        let (k, pose) = poses
            .iter()
            .enumerate()
            .skip(first + BESIDE + 1)
            .find(|(_, p)| p.time.secs_since(start) >= *LATER_S.start())?;
        LATER_S
            .contains(&pose.time.secs_since(start))
            .then_some((first, k))
    };
    let pairs: Vec<_> = (BESIDE..poses.len()).filter_map(later).collect();
    let every = pairs.len().div_ceil(MAX_PAIRS).max(1);
    let pairs: Vec<_> = pairs.into_iter().step_by(every).collect();
    let off = pairs
        .into_par_iter()
        .filter_map(|(first, second)| pair_off(scans, config, first, second));
    let off: Vec<f64> = off.collect();
    let off_m = median(off.clone()).filter(|_| off.len() >= MIN_PAIRS)?;
    (off_m > OFF_M).then_some(off_m)
}

fn pair_off(
    scans: &Scans<'_>,
    config: &OdometryConfig,
    first: usize,
    second: usize,
) -> Option<f64> {
    let pose = |k: usize| scans.poses[k].world_from_rig;
    let first_from = |k: usize| pose(first).inverse() * pose(k);
    let points = |k: usize| -> Option<Vec<Vector3<f64>>> {
        let points = scans.clouds.get(k)?.iter();
        Some(points.map(|p| Vector3::from(p.map(f64::from))).collect())
    };
    let lidar = scans.lidar;
    let sensor_in_rig = lidar.rig_from_lidar.translation;
    let mut map = LocalMap::new(config.local_map(lidar));
    for k in first - BESIDE..=first + BESIDE {
        map.insert(&points(k)?, &first_from(k), &sensor_in_rig);
    }
    let planes = |points: &[Vector3<f64>], pose: &Se3, gate_m: f64| {
        let mut found = map.find_all(points, &sensor_in_rig, pose, gate_m);
        for m in &mut found {
            *m = m.filter(|m| matches!(m, Match::Plane(_)));
        }
        found
    };
    let prior = PosePrior {
        world_from_rig: first_from(second),
        information: Matrix6::identity(),
    };
    let settings = config.registration(lidar, GATE_M.min(config.initial_gate_m));
    let points = points(second)?;
    let found = register(&points, &prior, &settings, |pose, gate_m| {
        planes(&points, pose, gate_m)
    });
    let shift_m = 0.5 * config.finest_cell_m();
    let seen = observability(&points, &found, &settings, shift_m, planes)?;
    let r = seen.usual_range_m;
    let off = prior.world_from_rig.local(&found.world_from_rig);
    let off_m = off.component_mul(&Vector6::new(r, r, r, 1.0, 1.0, 1.0));
    let directions = seen.directions.iter();
    let directions = directions.filter(|d| d.seen_per_m2() > LEAST_SEEN_PER_M2);
    let off_m: Vector6<f64> = directions.map(|d| d.along * d.along.dot(&off_m)).sum();
    (found.inlier_ratio > MIN_OVERLAP).then(|| off_m.fixed_rows::<3>(3).norm())
}
