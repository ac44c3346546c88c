//! Where the IMU measured nothing, or said one thing again and again, while the carrier went on.
//!
//! What is held of the last sample predicts the motion there, and scans are deskewed by it: a turn that was going on when the cable came out goes on for
//! ever. Scans may find their places all the same, or not.

use lsfb_geometry::StampedPose;
use lsfb_perception::statistics::median;
use lsfb_types::{ImuSample, Stamped, Timestamp};

/// A pause is bridged up to this, seconds: a prediction is off by a few centimetres then; and up to so many times what samples are usually apart.
const BRIDGED_S: f64 = 0.25;
const BRIDGED_INTERVALS: f64 = 5.0;
/// No sensor with noise repeats all its six numbers for so long, seconds; one without noise does where the carrier stands.
const REPEATS_S: f64 = 0.7;
/// Further, or turned more, the carrier did not stand, metres and radians.
const STANDS_M: f64 = 0.1;
const STANDS_RAD: f64 = 0.05;

/// From and until when, seconds after the first scan of the walk.
pub(crate) fn imu_pauses(samples: &[Stamped<ImuSample>], walk: &[StampedPose]) -> Vec<[f64; 2]> {
    let [first, .., last] = walk else {
        return Vec::new();
    };
    let intervals = samples.windows(2).map(|w| w[1].time.secs_since(w[0].time));
    let usual_s = median(intervals.collect()).unwrap_or_default();
    let bridged_s = BRIDGED_S.max(BRIDGED_INTERVALS * usual_s);
    let mut felt = vec![first.time];
    for same in samples.chunk_by(|a, b| a.sample == b.sample) {
        let [begin, .., end] = same else {
            felt.extend(same.iter().map(|s| s.time));
            continue;
        };
        let is_held = end.time.secs_since(begin.time) > REPEATS_S;
        match is_held && moves(walk, begin.time, end.time) {
            true => felt.push(begin.time),
            false => felt.extend(same.iter().map(|s| s.time)),
        }
    }
    felt.push(last.time);
    felt.retain(|time| (first.time..=last.time).contains(time));
    felt.sort_unstable();
    let pairs = felt.windows(2);
    let pauses = pairs.filter(|w| w[1].secs_since(w[0]) > bridged_s);
    pauses
        .map(|w| [0, 1].map(|k| w[k].secs_since(first.time)))
        .collect()
}

/// Whether scans say that the carrier moved or turned between two times.
fn moves(walk: &[StampedPose], from: Timestamp, to: Timestamp) -> bool {
    let begin = walk.partition_point(|pose| pose.time < from);
    let mut inside = walk[begin..].iter().take_while(|pose| pose.time <= to);
    let Some(start) = inside.next() else {
        return false;
    };
    inside.any(|pose| {
        let moved = start.world_from_rig.inverse() * pose.world_from_rig;
        moved.translation.norm() > STANDS_M || moved.rotation.angle() > STANDS_RAD
    })
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Se3, Vector3};

    use super::*;

    fn at(secs: f64) -> Timestamp {
        Timestamp::from_nanos((secs * 1e9) as i64)
    }

    /// Ten seconds with ten scans a second, at a metre a second or at rest, and two hundred samples a second where `feels` says so.
    fn found(speed_m_s: f64, reading: impl Fn(f64) -> Option<f64>) -> Vec<[f64; 2]> {
        let walk: Vec<_> = (0..=100)
            .map(|k| StampedPose {
                time: at(0.1 * f64::from(k)),
                world_from_rig: Se3::new(
                    Default::default(),
                    Vector3::x() * (0.1 * f64::from(k) * speed_m_s),
                ),
            })
            .collect();
        let samples = (-20..=2020).filter_map(|k| {
            let time = at(0.005 * f64::from(k));
            Some(Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: ImuSample {
                    angular_velocity_rad_s: [reading(0.005 * f64::from(k))?, 0.0, 0.0],
                    specific_force_m_s2: [0.0, 0.0, 9.81],
                },
            })
        });
        imu_pauses(&samples.collect::<Vec<_>>(), &walk)
    }

    #[test]
    fn pauses_and_readings_that_stand_are_found() {
        assert_eq!(found(1.0, Some), Vec::<[f64; 2]>::new());
        let near = |found: Vec<[f64; 2]>, expected: [f64; 2]| {
            assert_eq!(found.len(), 1, "{found:?}");
            let off = (found[0][0] - expected[0]).abs() + (found[0][1] - expected[1]).abs();
            assert!(off < 0.02, "{found:?}");
        };
        // Its cable comes out, or has a bad contact for a second.
        near(found(1.0, |t| (t < 4.0).then_some(t)), [4.0, 10.0]);
        near(
            found(1.0, |t| (!(4.0..5.0).contains(&t)).then_some(t)),
            [4.0, 5.0],
        );
        assert!(found(1.0, |t| (!(4.0..4.045).contains(&t)).then_some(t)).is_empty());
        // It says one thing for two seconds; of a simulated one at rest that is right.
        let stands = |t: f64| Some(if (4.0..6.0).contains(&t) { 0.5 } else { t });
        near(found(1.0, stands), [4.0, 6.0]);
        assert!(found(0.0, stands).is_empty());
    }
}
