//! Trajectories bent through some of their poses that were corrected.

use lsfb_geometry::{Se3, StampedPose};

/// A pose of a trajectory of which some poses (`before`, in order of time) are now `after`: it follows the one before it and the one
/// behind it, each with the trajectory's own motion from it, in proportion to time.
pub(crate) fn bent(pose: &StampedPose, before: &[StampedPose], after: &[Se3]) -> Se3 {
    let from = |k: usize| {
        let (before, after) = (before.get(k)?, after.get(k)?);
        Some(*after * before.world_from_rig.inverse() * pose.world_from_rig)
    };
    let next = before.partition_point(|k| k.time < pose.time);
    let previous = next.checked_sub(1);
    match (previous.and_then(from), from(next)) {
        (Some(a), Some(b)) => {
            let start = before[next - 1].time;
            let fraction = pose.time.secs_since(start) / before[next].time.secs_since(start);
            a.interpolate(&b, fraction)
        }
        (Some(only), None) | (None, Some(only)) => only,
        (None, None) => pose.world_from_rig,
    }
}
