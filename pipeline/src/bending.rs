//! Trajectories bent through some of their poses that were corrected.

use lsfb_geometry::{Se3, StampedPose};

/// What a pose drifts by while it stands still, as if it walked so fast, m/s.
const STANDING_M_S: f64 = 0.02;

/// How far a trajectory went from one pose to another, metres, as far as its errors grow with that: a turn by a radian counts as a metre.
fn way_m(from: &StampedPose, to: &StampedPose) -> f64 {
    let moved = from.world_from_rig.inverse() * to.world_from_rig;
    let secs = to.time.secs_since(from.time);
    moved.translation.norm() + moved.rotation.angle() + STANDING_M_S * secs
}

/// A pose of a trajectory of which some poses (`before`, in order of time) are now `after`: it follows the one before it and the one
/// behind it, each with the trajectory's own motion from it, in proportion to the way from them. Its errors grow with that, not with time: somebody who
/// stands and then walks stays where he stood.
pub(crate) fn bent(pose: &StampedPose, before: &[StampedPose], after: &[Se3]) -> Se3 {
    let from = |k: usize| {
        let (before, after) = (before.get(k)?, after.get(k)?);
        Some(*after * before.world_from_rig.inverse() * pose.world_from_rig)
    };
    let next = before.partition_point(|k| k.time < pose.time);
    let previous = next.checked_sub(1);
    match (previous.and_then(from), from(next)) {
        (Some(a), Some(b)) => a.interpolate(&b, fraction_of_way(before, next, pose)),
        (Some(only), None) | (None, Some(only)) => only,
        (None, None) => pose.world_from_rig,
    }
}

/// How far a pose is on the way from the one before `next` to that one, 0 to 1.
fn fraction_of_way(before: &[StampedPose], next: usize, pose: &StampedPose) -> f64 {
    let (gone_m, left_m) = (way_m(&before[next - 1], pose), way_m(pose, &before[next]));
    gone_m / (gone_m + left_m)
}

/// What a pose between others follows: the numbers of those before and behind it, its pose in their frames, and how far it is on the way between them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Between {
    pub ends: [usize; 2],
    pub in_ends: [Se3; 2],
    pub fraction: f64,
}

impl Between {
    /// As [`bent`] has it; `None` before the first and behind the last.
    pub fn of(pose: &StampedPose, before: &[StampedPose]) -> Option<Self> {
        let next = before.partition_point(|k| k.time < pose.time);
        let previous = next.checked_sub(1)?;
        let in_end = |k: usize| Some(before.get(k)?.world_from_rig.inverse() * pose.world_from_rig);
        Some(Self {
            ends: [previous, next],
            in_ends: [in_end(previous)?, in_end(next)?],
            fraction: fraction_of_way(before, next, pose),
        })
    }

    /// Where the pose is when the others are `after`.
    pub fn pose(&self, after: &[StampedPose]) -> Option<Se3> {
        let end = |k: usize| Some(after.get(self.ends[k])?.world_from_rig * self.in_ends[k]);
        Some(end(0)?.interpolate(&end(1)?, self.fraction))
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector3;
    use lsfb_types::Timestamp;

    use super::*;

    /// 4 s on one spot, then half a metre that is told a tenth too long.
    #[test]
    fn who_stands_stays_where_he_stood() {
        let at = |ms: i64, x_m: f64| StampedPose {
            time: Timestamp::from_nanos(ms * 1_000_000),
            world_from_rig: Se3::new(Default::default(), Vector3::x() * x_m),
        };
        let before = [at(0, 0.0), at(4500, 0.55)];
        let after = [0.0, 0.5].map(|x| Se3::new(Default::default(), Vector3::x() * x));
        let x_m = |pose: StampedPose| bent(&pose, &before, &after).translation.x;
        assert!(x_m(at(3900, 0.0)).abs() < 0.008);
        assert!((x_m(at(4250, 0.275)) - 0.25).abs() < 0.004);
        // Through the corrected poses.
        assert!(x_m(at(0, 0.0)).abs() < 1e-12);
        assert!((x_m(at(4500, 0.55)) - 0.5).abs() < 1e-12);
        assert!((x_m(at(5000, 0.66)) - 0.61).abs() < 1e-12);
        // The same by name.
        let stamped = |k: usize| StampedPose {
            time: before[k].time,
            world_from_rig: after[k],
        };
        let now = [stamped(0), stamped(1)];
        for pose in [at(3900, 0.0), at(4250, 0.275)] {
            let between = Between::of(&pose, &before).and_then(|b| b.pose(&now));
            let off_m = between.expect("between").translation.x - x_m(pose);
            assert!(off_m.abs() < 1e-12, "{off_m}");
        }
        assert!(Between::of(&at(5000, 0.66), &before).is_none());
    }
}
