//! When a device rested: while its pose keeps still.

use std::ops::Range;

use lsfb_geometry::{StampedPose, Vector3, mean_position, so3};
use lsfb_types::{Bounds, Timestamp};

/// What a rest is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestConfig {
    /// Positions stay within this of their mean, metres.
    pub spread_m: f64,
    /// Rotations stay within this of each other, degrees.
    pub turn_deg: f64,
    /// For at least so long, seconds.
    pub least_secs: f64,
}

impl Default for RestConfig {
    fn default() -> Self {
        Self {
            spread_m: 0.01,
            turn_deg: 1.0,
            least_secs: 1.0,
        }
    }
}

lsfb_types::bounds! {
    RestConfig {
        spread_m: number(Bounds::POSITIVE),
        turn_deg: number(Bounds::POSITIVE),
        least_secs: number(Bounds::POSITIVE),
    }
}

/// Poses that a rest must have: fewer say nothing about what lies between them.
const LEAST_POSES: usize = 5;
/// A rest that wanders further than this many spreads is a slow walk.
const WANDERING: f64 = 3.0;

/// A time without motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest {
    /// Its first pose.
    pub start: Timestamp,
    /// Its last pose.
    pub end: Timestamp,
    /// Mean position, metres.
    pub place: Vector3<f64>,
    /// Root mean square of positions about it, metres.
    pub scatter_m: f64,
    /// Poses.
    pub poses: usize,
}

/// Rests of a trajectory in order of time, by its poses alone: a trajectory that stops while the device is carried on rests as well.
pub fn find_rests(poses: &[StampedPose], config: &RestConfig) -> Vec<Rest> {
    let is_rest = still_poses(poses, config);
    let runs = runs_of(&is_rest).into_iter();
    runs.filter_map(|run| rest(&poses[run], config)).collect()
}

/// Runs of `true`.
pub(super) fn runs_of(values: &[bool]) -> Vec<Range<usize>> {
    let mut runs = Vec::new();
    let mut start = 0;
    for run in values.chunk_by(|a, b| a == b) {
        if run[0] {
            runs.push(start..start + run.len());
        }
        start += run.len();
    }
    runs
}

/// Which poses lie in a window that keeps still.
pub(super) fn still_poses(poses: &[StampedPose], config: &RestConfig) -> Vec<bool> {
    let mut is_rest = vec![false; poses.len()];
    let mut end = 0;
    for start in 0..poses.len() {
        end = end.max(start);
        let lasts = |end: usize| poses[end].time.secs_since(poses[start].time);
        while end + 1 < poses.len() && lasts(end) < config.least_secs {
            end += 1;
        }
        let window = &poses[start..=end];
        if lasts(end) >= config.least_secs
            && window.len() >= LEAST_POSES
            && is_still(window, config)
        {
            is_rest[start..=end].fill(true);
        }
    }
    is_rest
}

fn is_still(poses: &[StampedPose], config: &RestConfig) -> bool {
    let mean = mean_position(poses);
    let first = poses[0].world_from_rig.rotation;
    poses.iter().all(|p| {
        let turn = so3::log(&(first.inverse() * p.world_from_rig.rotation)).norm();
        (p.world_from_rig.translation - mean).norm() <= config.spread_m
            && turn.to_degrees() <= config.turn_deg
    })
}

/// A run of still windows as one rest; `None` where it creeps.
fn rest(poses: &[StampedPose], config: &RestConfig) -> Option<Rest> {
    let found = spread(poses)?;
    (found.largest_m <= WANDERING * config.spread_m).then_some(found.rest)
}

/// Poses as one rest, and how far the furthest is from its place, metres.
pub(super) struct Spread {
    pub rest: Rest,
    pub largest_m: f64,
}

/// `None` without a pose.
pub(super) fn spread(poses: &[StampedPose]) -> Option<Spread> {
    let (first, last) = (poses.first()?, poses.last()?);
    let place = mean_position(poses);
    let squares = poses
        .iter()
        .map(|p| (p.world_from_rig.translation - place).norm_squared());
    let (largest, sum) = squares.fold((0.0f64, 0.0), |(most, sum), s| (most.max(s), sum + s));
    Some(Spread {
        rest: Rest {
            start: first.time,
            end: last.time,
            place,
            scatter_m: (sum / poses.len() as f64).sqrt(),
            poses: poses.len(),
        },
        largest_m: largest.sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Se3;

    fn walk(place: impl Fn(f64) -> f64) -> Vec<StampedPose> {
        (0..300)
            .map(|i| {
                let t = f64::from(i) / 20.0;
                let jitter = 0.002 * (37.0 * t).sin();
                StampedPose {
                    time: Timestamp::from_secs_f64(t),
                    world_from_rig: Se3::new(
                        Default::default(),
                        Vector3::new(place(t) + jitter, 0.0, 1.0),
                    ),
                }
            })
            .collect()
    }

    #[test]
    fn rests_are_found_and_walks_are_not() {
        // Stands until 3 s, walks, stands from 6 to 9 s, walks on.
        let poses = walk(|t| (t.clamp(3.0, 6.0) - 3.0) + (t.max(9.0) - 9.0));
        let rests = find_rests(&poses, &RestConfig::default());
        assert_eq!(rests.len(), 2, "{rests:?}");
        assert!((rests[0].place.x).abs() < 2e-3 && (rests[1].place.x - 3.0).abs() < 2e-3);
        assert!((rests[1].end.secs_since(rests[1].start) - 3.0).abs() < 0.1);
        assert!(rests[0].scatter_m < 0.002);
        // A creep of 6 mm a second is still in every window, and no rest.
        assert!(find_rests(&walk(|t| 0.006 * t), &RestConfig::default()).is_empty());
        assert!(find_rests(&[], &RestConfig::default()).is_empty());
        let sparse: Vec<StampedPose> = walk(|_| 0.0).into_iter().step_by(20).collect();
        assert_eq!(find_rests(&sparse, &RestConfig::default()).len(), 0);
    }
}
