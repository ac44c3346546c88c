//! Scans laid on each other one after the other, without the IMU's accelerations and without the trajectory.
//!
//! A map of scans that a wrong trajectory has put together is smeared along its error, and then nothing tells of that: in a corridor door frames are drawn
//! out and a scan fits anywhere. So a second of scans is joined anew, each registered to those before it from where an even motion would have it. Such a chain drifts where scans see little
//! (half a metre in a second on stairs), so it does not count by itself: the scans must lie on each other much better as it has them than as the trajectory does.

use lsfb_geometry::{Matrix6, Se3, Vector3};
use lsfb_perception::lidar::{LocalMap, Match, PosePrior, ScanFinder, register};

use super::scans::{GATE_M, Scans, seen_off_m};
use crate::odometry::OdometryConfig;

/// Farthest that a point is held against a surface where it is asked how scans lie on each other, metres.
const LIE_M: f64 = 0.3;
/// What a point costs that lies on none: more than one at three standard deviations of a plane.
const ON_NONE: f64 = 5.0;
/// Squares in standard deviations that count at most.
const MOST_SQUARES: f64 = 9.0;

/// Scans joined without the trajectory.
pub(super) struct Chain {
    first: usize,
    /// Of the first and each behind it, in the rig of the first.
    poses: Vec<Se3>,
    /// By how much the trajectory has the last of them elsewhere, along what is seen, metres.
    pub off_m: f64,
}

impl Chain {
    /// From one scan to another behind it; `None` where one of them lies on too little.
    pub fn new(
        scans: &Scans<'_>,
        config: &OdometryConfig,
        first: usize,
        last: usize,
        least_overlap: f64,
    ) -> Option<Self> {
        let settings = config.registration(scans.lidar, GATE_M.min(config.initial_gate_m));
        let sensor_in_rig = scans.lidar.rig_from_lidar.translation;
        let mut map = LocalMap::new(config.local_map(scans.lidar));
        map.insert(&scans.points(first)?, &Se3::identity(), &sensor_in_rig);
        let mut poses = vec![Se3::identity()];
        let mut off_m = None;
        for now in first + 1..=last {
            let points = scans.points(now)?;
            let prior = PosePrior {
                world_from_rig: evenly(scans, first, &poses),
                // Next to nothing: it holds what no plane does.
                information: Matrix6::identity(),
            };
            let mut finder = ScanFinder::new(&map, &points, &sensor_in_rig);
            let found = register(&points, &prior, &settings, |pose, gate_m| {
                finder.find_planes(pose, gate_m)
            });
            if found.inlier_ratio < least_overlap {
                return None;
            }
            if now == last {
                let stated = scans.seen_from(first, last);
                let planes = |points: &[Vector3<f64>], pose: &Se3, gate_m: f64| {
                    ScanFinder::new(&map, points, &sensor_in_rig).find_planes(pose, gate_m)
                };
                off_m = seen_off_m(&points, &stated, &found, &settings, config, planes);
            }
            map.insert(&points, &found.world_from_rig, &sensor_in_rig);
            poses.push(found.world_from_rig);
        }
        Some(Self {
            first,
            poses,
            off_m: off_m?,
        })
    }

    /// How much better its scans lie on each other than as the trajectory has them, as the logarithm of what is likely, per point.
    pub fn better(&self, scans: &Scans<'_>, config: &OdometryConfig) -> Option<f64> {
        let members = (self.first..).take(self.poses.len());
        let stated: Vec<Se3> = members.map(|k| scans.seen_from(self.first, k)).collect();
        let cost = |poses: &[Se3]| lie(scans, config, self.first, poses);
        Some(cost(&stated)? - cost(&self.poses)?)
    }
}

/// Where an even motion has the next scan; its turn is the trajectory's, which has it of the gyroscope. The first step is the trajectory's.
fn evenly(scans: &Scans<'_>, first: usize, poses: &[Se3]) -> Se3 {
    let n = poses.len();
    let before = first + n - 1;
    let step = scans.seen_from(before, before + 1);
    let Some(earlier) = n.checked_sub(2) else {
        return step;
    };
    let seconds = |a: usize, b: usize| scans.poses[b].time.secs_since(scans.poses[a].time);
    let share = seconds(before, before + 1) / seconds(before - 1, before);
    let here = poses[n - 1].translation;
    Se3::new(
        poses[n - 1].rotation * step.rotation,
        here + (here - poses[earlier].translation) * share,
    )
}

/// How ill scans lie on each other at these poses: each half of them on planes of the other, the mean of all points.
fn lie(scans: &Scans<'_>, config: &OdometryConfig, first: usize, poses: &[Se3]) -> Option<f64> {
    let sensor_in_rig = scans.lidar.rig_from_lidar.translation;
    let noise_m = config.registration(scans.lidar, LIE_M).range_noise_m;
    let (mut sum, mut count) = (0.0, 0_usize);
    for half in [0, 1] {
        let mut map = LocalMap::new(config.local_map(scans.lidar));
        let placed = |of: usize| poses.iter().enumerate().filter(move |(at, _)| at % 2 == of);
        for (at, pose) in placed(half) {
            map.insert(&scans.points(first + at)?, pose, &sensor_in_rig);
        }
        for (at, pose) in placed(1 - half) {
            let points = scans.points(first + at)?;
            let found = ScanFinder::new(&map, &points, &sensor_in_rig).find_planes(pose, LIE_M);
            let costs = points.iter().zip(found).map(|(point, found)| match found {
                Some(Match::Plane(plane)) => {
                    let off_m = plane.normal.dot(&(*pose * *point - plane.point));
                    let variances = 1.0 + (plane.thickness_m / noise_m).powi(2);
                    let squares = (off_m / noise_m).powi(2) / variances;
                    // A plane that is smeared explains anything, and nothing well.
                    0.5 * (squares.min(MOST_SQUARES) + variances.ln())
                }
                _ => ON_NONE,
            });
            sum += costs.sum::<f64>();
            count += points.len();
        }
    }
    (count > 0).then(|| sum / count as f64)
}
