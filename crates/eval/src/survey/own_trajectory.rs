//! Whether a trajectory is the one that a map was written with.

use lsfb_geometry::{StampedPose, Trajectory};

use crate::Error;

/// A trajectory that a map was written with passes through its keyframes, but for the digits of files: metres and degrees.
const SAME_M: f64 = 0.005;
const SAME_DEG: f64 = 0.1;

/// Refuses a trajectory that is not the map's: by its poses, its own distances would be judged, and a bent map would pass.
pub fn expect_own_trajectory(
    keyframes: impl Iterator<Item = StampedPose>,
    trajectory: &Trajectory,
) -> Result<(), Error> {
    let moves = keyframes.filter_map(|keyframe| {
        let moved = keyframe.world_from_rig.inverse() * trajectory.at(keyframe.time)?;
        Some([
            moved.translation.norm(),
            moved.rotation.angle().to_degrees(),
        ])
    });
    let largest = moves.reduce(|most, moved| [0, 1].map(|i| f64::max(most[i], moved[i])));
    let [far_m, far_deg] = largest.ok_or(Error::NoKeyframe)?;
    match far_m <= SAME_M && far_deg <= SAME_DEG {
        true => Ok(()),
        false => Err(Error::AnotherTrajectory {
            far_cm: 100.0 * far_m,
            far_deg,
        }),
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Se3, UnitQuaternion, Vector3};
    use lsfb_types::Timestamp;

    use super::*;

    /// The true trajectory of a map that was bent by decimetres: FAIL became WARN, exit code 0.
    #[test]
    fn a_trajectory_that_is_not_the_maps_is_refused() {
        let along = |stretch: f64, secs: std::ops::Range<i64>| -> Vec<StampedPose> {
            secs.map(|secs| StampedPose {
                time: Timestamp::from_nanos(secs * 1_000_000_000),
                world_from_rig: Se3::new(
                    UnitQuaternion::identity(),
                    Vector3::new(stretch * secs as f64, 0.0, 0.0),
                ),
            })
            .collect()
        };
        let keyframes: Vec<_> = along(1.0, 0..9).into_iter().step_by(3).collect();
        let said = |trajectory| {
            let trajectory = Trajectory::new(trajectory);
            expect_own_trajectory(keyframes.iter().copied(), &trajectory)
                .err()
                .map(|error| error.to_string())
        };
        assert_eq!(said(along(1.0, 0..9)), None);
        assert_eq!(said(along(1.0, 0..5)), None, "it need not reach all");
        let other = said(along(1.01, 0..9)).expect("refused");
        assert!(other.contains("up to 6.0 cm and 0.00°"), "{other}");
        let later = said(along(1.0, 20..30)).expect("refused");
        assert!(later.contains("no keyframe"), "{later}");
    }
}
