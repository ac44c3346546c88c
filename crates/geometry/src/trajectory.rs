use lsfb_types::{Timestamp, median};
use nalgebra::Vector3;

use crate::Se3;

/// One pose of a [`Trajectory`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// When.
    pub time: Timestamp,
    /// Pose of the rig in the world.
    pub world_from_rig: Se3,
}

/// Sum of the distances between neighbours, metres.
pub fn path_length_m(poses: &[StampedPose]) -> f64 {
    poses
        .windows(2)
        .map(|w| (w[1].world_from_rig.translation - w[0].world_from_rig.translation).norm())
        .sum()
}

/// Mean of the positions, metres.
pub fn mean_position(poses: &[StampedPose]) -> Vector3<f64> {
    let positions = poses.iter().map(|p| p.world_from_rig.translation);
    positions.sum::<Vector3<f64>>() / poses.len().max(1) as f64
}

/// Neighbours that are so far apart in time have the motion between them, seconds: a second without a measurement is bridged.
const LONGEST_GAP_S: f64 = 1.5;
/// Poses may be rarer where they always are: by how many times the usual distance in time.
const USUAL_GAPS: f64 = 5.0;

/// Timed poses in strictly increasing order of time. Where two neighbours are further apart than poses of this trajectory are, there is a hole: nobody knows
/// what the body did there, and no pose is made up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    poses: Vec<StampedPose>,
    longest_gap_s: f64,
}

impl Trajectory {
    /// Sorts by time; of poses with one stamp the first is kept.
    pub fn new(mut poses: Vec<StampedPose>) -> Self {
        poses.sort_by_key(|p| p.time);
        poses.dedup_by_key(|p| p.time);
        let gaps = poses.windows(2).map(|w| w[1].time.secs_since(w[0].time));
        let usual_s = median(gaps.collect()).unwrap_or_default();
        Self {
            poses,
            longest_gap_s: LONGEST_GAP_S.max(USUAL_GAPS * usual_s),
        }
    }

    /// Neighbours between which there is a hole.
    pub fn holes(&self) -> impl Iterator<Item = [&StampedPose; 2]> {
        let neighbours = self.poses.windows(2).map(|w| [&w[0], &w[1]]);
        neighbours.filter(|[start, end]| self.is_hole(start, end))
    }

    fn is_hole(&self, start: &StampedPose, end: &StampedPose) -> bool {
        end.time.secs_since(start.time) > self.longest_gap_s
    }

    /// The poses, in order of time.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no pose.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Sum of the distances between neighbours, metres.
    pub fn path_length_m(&self) -> f64 {
        path_length_m(&self.poses)
    }

    /// Pose at `time`, interpolated between its neighbours; `None` outside the trajectory, and in a hole.
    pub fn at(&self, time: Timestamp) -> Option<Se3> {
        let next = self.poses.partition_point(|p| p.time < time);
        let end = self.poses.get(next)?;
        if end.time == time {
            return Some(end.world_from_rig);
        }
        let start = self.poses.get(next.checked_sub(1)?)?;
        if self.is_hole(start, end) {
            return None;
        }
        let fraction = time.secs_since(start.time) / end.time.secs_since(start.time);
        Some(
            start
                .world_from_rig
                .interpolate(&end.world_from_rig, fraction),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Vector3, Vector6};

    #[test]
    fn interpolates_inside_and_refuses_outside() {
        let pose = |nanos, x, yaw| StampedPose {
            time: Timestamp::from_nanos(nanos),
            world_from_rig: Se3::exp(&Vector6::new(0.0, 0.0, yaw, 0.0, 0.0, 0.0))
                * Se3::new(Default::default(), Vector3::zeros()).with_x(x),
        };
        let t = Trajectory::new(vec![
            pose(2_000, 2.0, 0.0),
            pose(1_000, 0.0, 0.0),
            pose(1_000, 9.0, 0.0),
        ]);
        assert_eq!(t.len(), 2);
        assert_eq!(
            t.at(Timestamp::from_nanos(1_500)).map(|p| p.translation.x),
            Some(1.0)
        );
        assert!(
            t.at(Timestamp::from_nanos(999)).is_none()
                && t.at(Timestamp::from_nanos(2_001)).is_none()
        );
        assert_eq!(t.path_length_m(), 2.0);
    }

    #[test]
    fn no_pose_is_made_up_in_a_hole() {
        let walk = |ms: &mut dyn Iterator<Item = i64>| {
            let poses = ms.map(|ms| StampedPose {
                time: Timestamp::from_nanos(ms * 1_000_000),
                world_from_rig: Se3::identity().with_x(ms as f64),
            });
            Trajectory::new(poses.collect())
        };
        let at = |walk: &Trajectory, ms: i64| walk.at(Timestamp::from_nanos(ms * 1_000_000));
        // Ten poses a second, none from 3 to 5 s, and a second without one.
        let all = (0..=100).map(|k| 100 * k);
        let holed =
            walk(&mut all.filter(|ms| !(3001..5000).contains(ms) && !(8001..9000).contains(ms)));
        assert_eq!(holed.holes().count(), 1);
        assert!(at(&holed, 3000).is_some() && at(&holed, 5000).is_some());
        assert!(at(&holed, 3050).is_none() && at(&holed, 4000).is_none());
        assert_eq!(at(&holed, 8500).map(|p| p.translation.x), Some(8500.0));
        // Where there is one in five seconds that is no hole.
        let rare = walk(&mut (0..10).map(|k| 5000 * k));
        assert_eq!(rare.holes().count(), 0);
        assert_eq!(at(&rare, 7500).map(|p| p.translation.x), Some(7500.0));
    }

    impl Se3 {
        fn with_x(mut self, x: f64) -> Self {
            self.translation.x = x;
            self
        }
    }
}
