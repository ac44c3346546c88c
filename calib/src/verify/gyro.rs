//! The gyroscope's samples, integrated.

use lsfb_geometry::{UnitQuaternion, Vector3, so3};
use lsfb_recording::Recording;

use super::{seconds, unreadable};
use crate::Error;

/// Integral of the gyroscope over time: of its numbers, and of the rotation that they make.
pub(super) struct Gyro {
    times_s: Vec<f64>,
    angles: Vec<Vector3<f64>>,
    start_from_rig: Vec<UnitQuaternion<f64>>,
}

/// The gyroscope of a recording; `None` where it has none.
pub(super) fn gyro(recording: &Recording) -> Result<Option<Gyro>, Error> {
    let Ok(samples) = recording.imu() else {
        return Ok(None);
    };
    let mut rates = Vec::new();
    for sample in samples {
        let sample = sample.map_err(unreadable(recording))?;
        let rate = Vector3::from(sample.sample.angular_velocity_rad_s);
        rates.push((seconds(sample.time.nanos(), recording), rate));
    }
    rates.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok((rates.len() > 2).then(|| Gyro::new(&rates)))
}

impl Gyro {
    /// From times (seconds) and angular velocities in order.
    pub fn new(samples: &[(f64, Vector3<f64>)]) -> Self {
        let (mut angle, mut turn) = (Vector3::zeros(), UnitQuaternion::identity());
        let mut times_s = Vec::with_capacity(samples.len());
        let mut angles = Vec::with_capacity(samples.len());
        let mut start_from_rig = Vec::with_capacity(samples.len());
        for (k, (time, rate)) in samples.iter().enumerate() {
            if let Some((before, earlier)) = k.checked_sub(1).map(|b| samples[b]) {
                let step = (earlier + rate) * (0.5 * (time - before));
                angle += step;
                turn *= so3::exp(&step);
            }
            times_s.push(*time);
            angles.push(angle);
            start_from_rig.push(turn);
        }
        Self {
            times_s,
            angles,
            start_from_rig,
        }
    }

    /// The sample before a time, and the share of the way to the next; `None` outside the samples.
    fn place(&self, time_s: f64) -> Option<(usize, f64)> {
        let after = self.times_s.partition_point(|t| *t <= time_s);
        let before = after.checked_sub(1)?;
        let (t0, t1) = (self.times_s[before], *self.times_s.get(after)?);
        Some((before, (time_s - t0) / (t1 - t0).max(1e-9)))
    }

    /// Integral up to a time; `None` outside the samples.
    pub fn angle(&self, time_s: f64) -> Option<Vector3<f64>> {
        let (k, share) = self.place(time_s)?;
        Some(self.angles[k] + (self.angles[k + 1] - self.angles[k]) * share)
    }

    fn start_from_rig(&self, time_s: f64) -> Option<UnitQuaternion<f64>> {
        let (k, share) = self.place(time_s)?;
        let step = self.angles[k + 1] - self.angles[k];
        Some(self.start_from_rig[k] * so3::exp(&(step * share)))
    }

    /// The one rotation over a span, as an angular velocity in the rig, rad/s; `None` outside the samples.
    pub fn mean_rate(&self, from_s: f64, to_s: f64) -> Option<Vector3<f64>> {
        let turn = self.start_from_rig(from_s)?.inverse() * self.start_from_rig(to_s)?;
        Some(so3::log(&turn) / (to_s - from_s))
    }
}
