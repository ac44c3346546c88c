//! A trajectory between its poses: the cubic that fits the poses around best, rotations in the tangent of one of them.
//!
//! A curve through the poses themselves would be noisier at them than between them, and an offset of clocks that is fitted to it
//! would be drawn to where it is least noisy: by 2.6 ms for motion capture at 120 Hz beside images at 30 Hz.

use lsfb_geometry::{Se3, StampedPose, Vector3, Vector6, so3};
use lsfb_types::{Timestamp, median};
use nalgebra::{Matrix4, Vector4};

/// Steps longer than this many medians are gaps: nothing is said between their ends.
const LONGEST_STEP: f64 = 3.5;
/// Poses that a cubic needs.
const LEAST_POSES: usize = 4;
/// Poses this near are fitted, seconds: a hand's motion is a cubic for so long.
const REACH_SECS: f64 = 0.06;
/// Or this many steps, where poses come slower.
const REACH_STEPS: f64 = 3.0;
/// Velocities are differences over twice this, seconds.
const DIFFERENCE_SECS: f64 = 1e-5;
/// Weight of poses at the edge, so that four always determine a cubic.
const LEAST_WEIGHT: f64 = 1e-6;

/// A trajectory that has a pose at any time but in its gaps.
#[derive(Clone, Debug)]
pub(super) struct Continuous {
    /// Seconds since the base.
    secs: Vec<f64>,
    poses: Vec<Se3>,
    longest_step_secs: f64,
    pub median_step_secs: f64,
}

/// A pose, and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moving {
    pub pose: Se3,
    /// `[angular, linear]` velocity in the body, rad/s and m/s.
    pub twist: Vector6<f64>,
}

impl Continuous {
    /// Of poses in order of time; of equal stamps the first counts.
    pub fn new(poses: &[StampedPose], base: Timestamp) -> Self {
        let mut kept: Vec<StampedPose> = poses.to_vec();
        kept.dedup_by_key(|p| p.time);
        let secs: Vec<f64> = kept.iter().map(|p| p.time.secs_since(base)).collect();
        let steps = secs.windows(2).map(|w| w[1] - w[0]).collect();
        let median_step_secs = median(steps).unwrap_or(0.0);
        Self {
            secs,
            poses: kept.iter().map(|p| p.world_from_rig).collect(),
            longest_step_secs: LONGEST_STEP * median_step_secs,
            median_step_secs,
        }
    }

    /// First and last time, seconds since the base.
    pub fn span_secs(&self) -> Option<[f64; 2]> {
        Some([*self.secs.first()?, *self.secs.last()?])
    }

    /// Times and poses as they were given.
    pub fn samples(&self) -> impl ExactSizeIterator<Item = (f64, Se3)> + '_ {
        self.secs.iter().copied().zip(self.poses.iter().copied())
    }

    /// `None` outside, in a gap, and where too few poses without a gap are around.
    pub fn at(&self, secs: f64) -> Option<Se3> {
        let is_inside = *self.secs.first()? <= secs && secs <= *self.secs.last()?;
        if !is_inside || self.secs.len() < LEAST_POSES {
            return None;
        }
        let next = self
            .secs
            .partition_point(|s| *s < secs)
            .clamp(1, self.secs.len() - 1);
        let is_step = |i: &usize| self.secs[i + 1] - self.secs[*i] <= self.longest_step_secs;
        if !is_step(&(next - 1)) {
            return None;
        }
        let reach_secs = self.reach_secs();
        let is_near = |i: usize| (self.secs[i] - secs).abs() < reach_secs;
        let before = (0..next - 1)
            .rev()
            .take_while(|i| is_step(i) && is_near(*i))
            .count();
        let after = (next + 1..self.secs.len())
            .take_while(|i| is_step(&(i - 1)) && is_near(*i))
            .count();
        let (first, last) = (next - 1 - before, next + after);
        let weights = weights(&self.secs[first..=last], secs, reach_secs)?;
        let origin = self.poses[next - 1];
        let (mut turn, mut place) = (Vector3::zeros(), Vector3::zeros());
        for (pose, weight) in self.poses[first..=last].iter().zip(weights) {
            turn += so3::local(&origin.rotation, &pose.rotation) * weight;
            // Far from the world's origin differences keep their digits.
            place += (pose.translation - origin.translation) * weight;
        }
        Some(Se3::new(
            so3::retract(&origin.rotation, &turn),
            origin.translation + place,
        ))
    }

    /// The same with its velocity.
    pub fn moving_at(&self, secs: f64) -> Option<Moving> {
        let [before, after] = [-DIFFERENCE_SECS, DIFFERENCE_SECS].map(|step| self.at(secs + step));
        Some(Moving {
            pose: self.at(secs)?,
            twist: before?.local(&after?) / (2.0 * DIFFERENCE_SECS),
        })
    }

    fn reach_secs(&self) -> f64 {
        REACH_SECS.max(REACH_STEPS * self.median_step_secs)
    }

    /// Mean angular speed over `width_secs` around a time, rad/s.
    pub fn angular_speed(&self, secs: f64, width_secs: f64) -> Option<f64> {
        let from = self.at(secs - 0.5 * width_secs)?.rotation;
        let to = self.at(secs + 0.5 * width_secs)?.rotation;
        Some(so3::local(&from, &to).norm() / width_secs)
    }
}

/// The cubic that best fits values at some times, as weights of these values. `None` where the times do not determine a cubic.
fn weights(times: &[f64], at: f64, reach_secs: f64) -> Option<Vec<f64>> {
    let terms: Vec<(Vector4<f64>, f64)> = times
        .iter()
        .map(|time| {
            let s = (time - at) / reach_secs;
            let near = 1.0 - s.abs().min(1.0).powi(3);
            let weight = near.powi(3).max(LEAST_WEIGHT);
            (Vector4::new(1.0, s, s * s, s * s * s), weight)
        })
        .collect();
    let normal: Matrix4<f64> = terms.iter().map(|(x, w)| x * x.transpose() * *w).sum();
    let value = normal.cholesky()?.solve(&Vector4::x());
    let weights: Vec<f64> = terms.iter().map(|(x, w)| w * x.dot(&value)).collect();
    weights.iter().all(|w| w.is_finite()).then_some(weights)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A walk with all rotations in it.
    pub fn motion(t: f64) -> Se3 {
        let turn = Vector3::new(
            0.5 * (0.9 * t).sin() + 0.1 * (3.1 * t).sin(),
            0.4 * (0.7 * t + 1.0).sin(),
            0.6 * (0.4 * t).sin() + 0.2 * t,
        );
        Se3::new(
            so3::exp(&turn),
            Vector3::new(
                2.0 * (0.5 * t).sin(),
                1.5 * (0.3 * t).cos() + 0.1 * t,
                0.2 * (1.7 * t).sin(),
            ),
        )
    }

    pub fn sampled(rate_hz: f64, seconds: f64, pose: impl Fn(f64) -> Se3) -> Vec<StampedPose> {
        (0..(seconds * rate_hz) as usize)
            .map(|i| {
                let t = i as f64 / rate_hz;
                StampedPose {
                    time: Timestamp::from_nanos((t * 1e9).round() as i64),
                    world_from_rig: pose(t),
                }
            })
            .collect()
    }

    #[test]
    fn poses_between_poses_are_those_of_the_motion() {
        let zero = Timestamp::from_nanos(0);
        let motion_at = Continuous::new(&sampled(30.0, 10.0, motion), zero);
        for i in 0..90 {
            let t = 0.011 + 0.1 * f64::from(i);
            let found = motion_at.moving_at(t).expect("inside");
            let off = found.pose.local(&motion(t));
            assert!(off.norm() < 3e-5, "{t}: {off}");
            let h = 1e-5;
            let twist = motion(t - h).local(&motion(t + h)) / (2.0 * h);
            assert!(
                (found.twist - twist).norm() < 3e-3,
                "{t}: {}",
                found.twist - twist
            );
        }
        assert!(motion_at.at(-0.01).is_none() && motion_at.at(10.1).is_none());
        let mut gap = sampled(30.0, 10.0, motion);
        gap.drain(100..130);
        let motion_at = Continuous::new(&gap, zero);
        assert!(motion_at.at(3.8).is_none());
        assert!(motion_at.at(3.29).is_some() && motion_at.at(4.34).is_some());
    }
}
