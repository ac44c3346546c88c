use lsfb_types::Timestamp;

use crate::Se3;

/// One pose of a [`Trajectory`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// When.
    pub time: Timestamp,
    /// Pose of the rig in the world.
    pub world_from_rig: Se3,
}

/// Timed poses in strictly increasing order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    poses: Vec<StampedPose>,
}

impl Trajectory {
    /// Sorts by time; of poses with one stamp the first is kept.
    pub fn new(mut poses: Vec<StampedPose>) -> Self {
        poses.sort_by_key(|p| p.time);
        poses.dedup_by_key(|p| p.time);
        Self { poses }
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
        self.poses
            .windows(2)
            .map(|w| (w[1].world_from_rig.translation - w[0].world_from_rig.translation).norm())
            .sum()
    }

    /// Pose at `time`, interpolated between its neighbours; `None` outside the trajectory.
    pub fn at(&self, time: Timestamp) -> Option<Se3> {
        let next = self.poses.partition_point(|p| p.time < time);
        let end = self.poses.get(next)?;
        if end.time == time {
            return Some(end.world_from_rig);
        }
        let start = self.poses.get(next.checked_sub(1)?)?;
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

    impl Se3 {
        fn with_x(mut self, x: f64) -> Self {
            self.translation.x = x;
            self
        }
    }
}
