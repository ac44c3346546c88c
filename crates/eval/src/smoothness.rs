//! How smooth a trajectory is: what shakes is felt in glasses, however small the error.

use std::f64::consts::PI;

use lsfb_geometry::{StampedPose, Vector3};
use lsfb_types::median;
use serde::Serialize;

/// Steps longer than this many medians are gaps, across which nothing is derived.
const LONGEST_STEP: f64 = 2.5;
/// Where the fast part of a motion begins.
const FAST_HZ: f64 = 5.0;
/// Width of the filter's edge.
const EDGE_HZ: f64 = 2.0;
/// Poses that come slower than this say nothing about 5 Hz.
const LEAST_RATE_HZ: f64 = 2.0 * (FAST_HZ + EDGE_HZ);

/// Poses that come faster are none of a walk, and their filter would fill the memory.
const MOST_RATE_HZ: f64 = 10_000.0;

/// Smoothness of positions; of a real walk none of these is zero, so that an estimate is compared with its truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Smoothness {
    /// Poses per second, by the median step.
    pub rate_hz: f64,
    /// Root mean square of the second difference of neighbouring positions, metres.
    pub second_difference_rms_m: f64,
    /// Root mean square of the acceleration, m/s².
    pub acceleration_rms_m_s2: f64,
    /// Root mean square of the jerk, m/s³.
    pub jerk_rms_m_s3: f64,
    /// Root mean square of the motion faster than 5 Hz, metres: its energy's root. Absent where poses come slower than 14 Hz or too
    /// few without a gap.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub above_5_hz_rms_m: Option<f64>,
}

/// Of poses in order of time; `None` where there are not four without a gap.
pub(crate) fn smoothness(poses: &[StampedPose]) -> Option<Smoothness> {
    let first = poses.first()?;
    let mut places: Vec<(f64, Vector3<f64>)> = poses
        .iter()
        .map(|p| (p.time.secs_since(first.time), p.world_from_rig.translation))
        .collect();
    places.dedup_by_key(|p| p.0);
    let step_secs = median(places.windows(2).map(|w| w[1].0 - w[0].0).collect())?;
    let (mut accelerations, mut jerks) = (Vec::new(), Vec::new());
    let (mut fast, mut fast_samples) = (0.0, 0);
    for piece in places.chunk_by(|a, b| b.0 - a.0 <= LONGEST_STEP * step_secs) {
        let found: Vec<Vector3<f64>> = piece.windows(3).map(acceleration).collect();
        for (pair, four) in found.windows(2).zip(piece.windows(4)) {
            let apart_secs = (four[3].0 - four[0].0) / 3.0;
            jerks.push(((pair[1] - pair[0]) / apart_secs).norm_squared());
        }
        accelerations.extend(found.iter().map(Vector3::norm_squared));
        for value in above_edge(piece, step_secs) {
            fast += value;
            fast_samples += 1;
        }
    }
    if jerks.is_empty() {
        return None;
    }
    let rms = |squares: &[f64]| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let acceleration_rms_m_s2 = rms(&accelerations);
    Some(Smoothness {
        rate_hz: 1.0 / step_secs,
        second_difference_rms_m: acceleration_rms_m_s2 * step_secs * step_secs,
        acceleration_rms_m_s2,
        jerk_rms_m_s3: rms(&jerks),
        above_5_hz_rms_m: (fast_samples > 0).then(|| (fast / f64::from(fast_samples)).sqrt()),
    })
}

/// Second derivative of the parabola through three places.
fn acceleration(three: &[(f64, Vector3<f64>)]) -> Vector3<f64> {
    let [a, b, c] = [three[0], three[1], three[2]];
    let (before, after) = ((b.1 - a.1) / (b.0 - a.0), (c.1 - b.1) / (c.0 - b.0));
    (after - before) * 2.0 / (c.0 - a.0)
}

/// Squares of what is left of a piece above the edge, m², where the filter lies wholly within it.
fn above_edge(piece: &[(f64, Vector3<f64>)], step_secs: f64) -> Vec<f64> {
    let rate_hz = 1.0 / step_secs;
    if !(LEAST_RATE_HZ..=MOST_RATE_HZ).contains(&rate_hz) {
        return Vec::new();
    }
    let low_pass = low_pass(rate_hz);
    let even = evenly(piece, step_secs);
    let half = low_pass.len() / 2;
    even.windows(low_pass.len())
        .map(|window| {
            let weighted = window
                .iter()
                .zip(&low_pass)
                .map(|(place, weight)| place * *weight);
            (window[half] - weighted.sum::<Vector3<f64>>()).norm_squared()
        })
        .collect()
}

/// A sinc under Blackman's window: it passes what is slower than 5 Hz, and straight lines unchanged.
fn low_pass(rate_hz: f64) -> Vec<f64> {
    // Blackman's window: the edge is 5.5 rates wide over the number of its weights.
    let half = (0.5 * 5.5 * rate_hz / EDGE_HZ).ceil();
    let count = half as i64;
    let weights: Vec<f64> = (-count..=count)
        .map(|i| {
            let i = i as f64;
            let angle = 2.0 * PI * FAST_HZ / rate_hz * i;
            let sinc = if i == 0.0 { 1.0 } else { angle.sin() / angle };
            let turn = PI * i / half;
            sinc * (0.42 + 0.5 * turn.cos() + 0.08 * (2.0 * turn).cos())
        })
        .collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|w| w / sum).collect()
}

/// Places at even times, on the straight lines between those there are.
fn evenly(piece: &[(f64, Vector3<f64>)], step_secs: f64) -> Vec<Vector3<f64>> {
    let (Some(first), Some(last)) = (piece.first(), piece.last()) else {
        return Vec::new();
    };
    let count = ((last.0 - first.0) / step_secs).floor() as usize + 1;
    let mut next = 1;
    (0..count)
        .map(|i| {
            let at = first.0 + i as f64 * step_secs;
            while next + 1 < piece.len() && piece[next].0 < at {
                next += 1;
            }
            let Some(end) = piece.get(next) else {
                return first.1;
            };
            let start = piece[next - 1];
            start.1 + (end.1 - start.1) * ((at - start.0) / (end.0 - start.0)).clamp(0.0, 1.0)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Se3;
    use lsfb_types::Timestamp;

    fn poses(rate_hz: f64, seconds: f64, place: impl Fn(f64) -> f64) -> Vec<StampedPose> {
        (0..(seconds * rate_hz) as usize)
            .map(|i| {
                let t = i as f64 / rate_hz;
                StampedPose {
                    time: Timestamp::from_secs_f64(t),
                    world_from_rig: Se3::new(
                        Default::default(),
                        Vector3::new(place(t), 2.0 * t, 0.0),
                    ),
                }
            })
            .collect()
    }

    #[test]
    fn a_sine_has_the_derivatives_of_a_sine() {
        let omega = 2.0 * PI * 8.0;
        let found = smoothness(&poses(200.0, 20.0, |t| 0.001 * (omega * t).sin())).expect("poses");
        let rms = 0.001 / 2.0f64.sqrt();
        assert!((found.rate_hz - 200.0).abs() < 1e-6);
        assert!((found.acceleration_rms_m_s2 / (rms * omega * omega) - 1.0).abs() < 0.01);
        assert!((found.jerk_rms_m_s3 / (rms * omega.powi(3)) - 1.0).abs() < 0.02);
        let fast = found.above_5_hz_rms_m.expect("fast enough");
        assert!((fast / rms - 1.0).abs() < 0.01, "{fast}");
    }

    #[test]
    fn a_walk_is_not_fast() {
        let slow =
            smoothness(&poses(200.0, 20.0, |t| 0.3 * (2.0 * PI * 1.5 * t).sin())).expect("poses");
        assert!(slow.above_5_hz_rms_m.expect("fast enough") < 3e-4);
        let line = smoothness(&poses(100.0, 20.0, |t| t)).expect("poses");
        assert!(line.above_5_hz_rms_m.expect("fast enough") < 1e-9 && line.jerk_rms_m_s3 < 1e-3);
    }

    #[test]
    fn what_cannot_be_said_is_left_out() {
        assert_eq!(
            smoothness(&poses(10.0, 20.0, |t| t)).and_then(|s| s.above_5_hz_rms_m),
            None
        );
        assert!(smoothness(&poses(10.0, 0.3, |t| t)).is_none());
        assert!(smoothness(&[]).is_none());
        // Stamps a nanosecond apart.
        let mut dense = poses(100.0, 1.0, |t| t);
        for (i, pose) in dense.iter_mut().enumerate() {
            pose.time = Timestamp::from_nanos(i as i64);
        }
        assert_eq!(smoothness(&dense).and_then(|s| s.above_5_hz_rms_m), None);
        let one = poses(10.0, 0.1, |t| t);
        assert!(smoothness(&vec![one[0]; 9]).is_none());
        // A jump over a gap is no acceleration.
        let mut gap = poses(100.0, 4.0, |t| t);
        for pose in gap.iter_mut().skip(200) {
            pose.time = pose.time.plus_secs(10.0);
            pose.world_from_rig.translation.x += 50.0;
        }
        assert!(smoothness(&gap).expect("poses").acceleration_rms_m_s2 < 1e-3);
    }
}
