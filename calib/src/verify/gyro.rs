//! The gyroscope's samples, integrated.

use lsfb_geometry::Vector3;
use lsfb_recording::Recording;

use super::{seconds, unreadable};
use crate::Error;

/// Integral of the gyroscope over time.
pub(super) struct Gyro {
    times_s: Vec<f64>,
    angles: Vec<Vector3<f64>>,
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
        let mut angle = Vector3::zeros();
        let mut times_s = Vec::with_capacity(samples.len());
        let mut angles = Vec::with_capacity(samples.len());
        for (k, (time, rate)) in samples.iter().enumerate() {
            if let Some((before, earlier)) = k.checked_sub(1).map(|b| samples[b]) {
                angle += (earlier + rate) * (0.5 * (time - before));
            }
            times_s.push(*time);
            angles.push(angle);
        }
        Self { times_s, angles }
    }

    /// Integral up to a time; `None` outside the samples.
    pub fn angle(&self, time_s: f64) -> Option<Vector3<f64>> {
        let after = self.times_s.partition_point(|t| *t <= time_s);
        let before = after.checked_sub(1)?;
        let (t0, t1) = (self.times_s[before], *self.times_s.get(after)?);
        let share = (time_s - t0) / (t1 - t0).max(1e-9);
        Some(self.angles[before] + (self.angles[after] - self.angles[before]) * share)
    }

    /// Mean angular velocity over a span, rad/s; `None` outside the samples.
    pub fn mean_rate(&self, from_s: f64, to_s: f64) -> Option<Vector3<f64>> {
        Some((self.angle(to_s)? - self.angle(from_s)?) / (to_s - from_s))
    }
}
