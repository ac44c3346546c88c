//! A device at rest: which way is up, and the gyroscope's bias, from the samples alone.

use lsfb_geometry::{Se3, UnitQuaternion, Vector3};
use lsfb_perception::statistics::median;
use lsfb_types::STANDARD_GRAVITY_M_S2;

use super::sights::Tracks;
use crate::ground_truth::walk::{FrameState, Walk};
use lsfb_perception::imu::{ImuBias, NavState};

/// Shortest rest that counts, seconds.
const SHORTEST_SECS: f64 = 0.4;
/// Tracks of a device at rest move less than this in the median, pixels.
const LARGEST_SHIFT_PX: f64 = 0.7;
/// How far the mean of the accelerometer may be from gravity, m/s²: more is no rest, or no unit of that kind.
const LARGEST_ERROR_M_S2: f64 = 0.7;
/// Tracks that tell.
const FEWEST_TRACKS: usize = 15;

/// States of the frames during which the walk begins at rest; `None` where it does not.
pub(super) fn states(walk: &Walk, tracks: &Tracks) -> Option<Vec<FrameState>> {
    let count = (1..walk.frames.len()).take_while(|k| rests(walk, tracks, *k));
    let last = count.last()?;
    let (start, end) = (walk.frames[0].time, walk.frames[last].time);
    if end.secs_since(start) < SHORTEST_SECS {
        return None;
    }
    let first = walk.imu.partition_point(|s| s.time < start);
    let samples = &walk.imu[first..walk.imu.partition_point(|s| s.time <= end)];
    if samples.is_empty() {
        return None;
    }
    let mean = |value: fn(&lsfb_types::ImuSample) -> [f64; 3]| {
        let sum: Vector3<f64> = samples
            .iter()
            .map(|s| Vector3::from(value(&s.sample)))
            .sum();
        sum / samples.len() as f64
    };
    let force = mean(|s| s.specific_force_m_s2);
    if (force.norm() - STANDARD_GRAVITY_M_S2).abs() > LARGEST_ERROR_M_S2 {
        return None;
    }
    let upright = UnitQuaternion::rotation_between(&force, &Vector3::z())?;
    let state = FrameState {
        nav: NavState {
            world_from_rig: Se3::new(upright, Vector3::zeros()),
            velocity_m_s: Vector3::zeros(),
        },
        bias: ImuBias {
            gyro_rad_s: mean(|s| s.angular_velocity_rad_s),
            accel_m_s2: Vector3::zeros(),
        },
    };
    Some(vec![state; last + 1])
}

/// Whether a frame still shows what the first did, where it did.
fn rests(walk: &Walk, tracks: &Tracks, frame: usize) -> bool {
    let cameras = 0..walk.cameras.len();
    let pairs: Vec<_> = cameras.flat_map(|c| tracks.shared(c, 0, frame)).collect();
    let shifts = pairs.iter().map(|[a, b]| (b - a).norm()).collect();
    pairs.len() >= FEWEST_TRACKS && median(shifts).is_some_and(|px| px < LARGEST_SHIFT_PX)
}
