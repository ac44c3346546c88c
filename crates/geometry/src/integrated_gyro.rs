//! A gyroscope's samples, integrated over time.

use nalgebra::{UnitQuaternion, Vector3};

use crate::so3;

/// Integral of a gyroscope over time: of its numbers, and of the rotation that they make.
#[derive(Clone, Debug)]
pub struct IntegratedGyro {
    times_s: Vec<f64>,
    angles: Vec<Vector3<f64>>,
    start_from_rig: Vec<UnitQuaternion<f64>>,
}

/// A time between two samples: the one before, and the share of the way to the next.
struct Between {
    before: usize,
    share: f64,
}

impl IntegratedGyro {
    /// From times (seconds) and angular velocities (rad/s) in order of time.
    pub fn new(samples: impl IntoIterator<Item = (f64, Vector3<f64>)>) -> Self {
        let mut out = Self {
            times_s: Vec::new(),
            angles: Vec::new(),
            start_from_rig: Vec::new(),
        };
        let (mut angle, mut turn) = (Vector3::zeros(), UnitQuaternion::identity());
        let mut last: Option<(f64, Vector3<f64>)> = None;
        for (time_s, rate) in samples {
            if let Some((before_s, earlier)) = last {
                let step = (earlier + rate) * (0.5 * (time_s - before_s));
                angle += step;
                turn = so3::retract(&turn, &step);
            }
            last = Some((time_s, rate));
            out.times_s.push(time_s);
            out.angles.push(angle);
            out.start_from_rig.push(turn);
        }
        out
    }

    /// `None` outside the samples.
    fn between(&self, time_s: f64) -> Option<Between> {
        let after = self.times_s.partition_point(|t| *t <= time_s);
        let before = after.checked_sub(1)?;
        let (t0, t1) = (self.times_s[before], *self.times_s.get(after)?);
        Some(Between {
            before,
            share: (time_s - t0) / (t1 - t0).max(1e-9),
        })
    }

    /// Time of the first and the last sample, seconds; `None` without samples.
    pub fn span_s(&self) -> Option<[f64; 2]> {
        Some([*self.times_s.first()?, *self.times_s.last()?])
    }

    /// Time of each sample, seconds, and `start_from_rig` then.
    pub fn rotations(&self) -> impl ExactSizeIterator<Item = (f64, UnitQuaternion<f64>)> + '_ {
        let times_s = self.times_s.iter().copied();
        times_s.zip(self.start_from_rig.iter().copied())
    }

    /// Number of the last sample at or before a time; `None` outside the samples.
    pub fn sample_before(&self, time_s: f64) -> Option<usize> {
        Some(self.between(time_s)?.before)
    }

    /// Integral of the numbers up to a time, radians; `None` outside the samples.
    pub fn angle(&self, time_s: f64) -> Option<Vector3<f64>> {
        let Between { before: k, share } = self.between(time_s)?;
        Some(self.angles[k] + (self.angles[k + 1] - self.angles[k]) * share)
    }

    fn start_from_rig(&self, time_s: f64) -> Option<UnitQuaternion<f64>> {
        let Between { before: k, share } = self.between(time_s)?;
        let step = self.angles[k + 1] - self.angles[k];
        Some(so3::retract(&self.start_from_rig[k], &(step * share)))
    }

    /// The one rotation over a span, as an angular velocity in the rig, rad/s; `None` outside the samples.
    pub fn mean_rate(&self, from_s: f64, to_s: f64) -> Option<Vector3<f64>> {
        let turn = so3::local(&self.start_from_rig(from_s)?, &self.start_from_rig(to_s)?);
        Some(turn / (to_s - from_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_about_changing_axes_is_that_of_the_motion() {
        // Yaw, then roll in the rig's own axes.
        let rate = |t: f64| {
            if t < 0.5 {
                Vector3::new(0.0, 0.0, 1.0)
            } else {
                Vector3::new(2.0, 0.0, 0.0)
            }
        };
        let times = (0..=1000).map(|k| f64::from(k) * 1e-3);
        let gyro = IntegratedGyro::new(times.map(|t| (t, rate(t))));
        let yaw = so3::exp(&Vector3::new(0.0, 0.0, 0.5));
        let expected = so3::log(&(yaw * so3::exp(&Vector3::new(0.8, 0.0, 0.0))));
        let found = gyro.mean_rate(0.0, 0.9).expect("inside") * 0.9;
        assert!((found - expected).norm() < 2e-3, "{found} {expected}");
        let angle = gyro.angle(0.9).expect("inside");
        assert!((angle - Vector3::new(0.8, 0.0, 0.5)).norm() < 2e-3);
        assert!(gyro.angle(-0.1).is_none() && gyro.mean_rate(0.5, 1.1).is_none());
        assert_eq!(gyro.span_s(), Some([0.0, 1.0]));
        let (end_s, turned) = gyro.rotations().last().expect("samples");
        let whole = gyro.mean_rate(0.0, 0.999_999).expect("inside");
        assert!(end_s == 1.0 && (so3::log(&turned) - whole).norm() < 1e-5);
    }
}
