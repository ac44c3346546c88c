//! Inertial samples in which a sensor said once more what it had said before.
//!
//! No two readings of a sensor with noise are the same for long. An axis that repeats one reading while the device moves measures nothing:
//! believed, it bends the walk, and what comes out looks like a poor map.

use lsfb_geometry::Vector3;
use lsfb_types::{ImuSample, Stamped};

use super::frozen_images::RESTING_RAD_S;
use crate::{Error, Refusal};

/// Sensors that hold a reading until the next, and those of few digits, repeat theirs for less than this, seconds.
const LONGEST_HELD_SECS: f64 = 0.7;
/// A device at rest feels forces that stay within this, m/s².
const RESTING_M_S2: f64 = 0.5;
/// With less of its samples left a recording has no IMU.
const LEAST_LEFT: f64 = 0.5;

/// A sensor of the IMU.
#[derive(Clone, Copy)]
enum Sensor {
    Gyroscope,
    Accelerometer,
}

impl Sensor {
    const BOTH: [Self; 2] = [Self::Gyroscope, Self::Accelerometer];

    fn name(self) -> &'static str {
        match self {
            Self::Gyroscope => "gyroscope",
            Self::Accelerometer => "accelerometer",
        }
    }

    fn reading(self, sample: &ImuSample) -> Vector3<f64> {
        match self {
            Self::Gyroscope => sample.angular_velocity_rad_s.into(),
            Self::Accelerometer => sample.specific_force_m_s2.into(),
        }
    }

    /// Whether the device moved during some samples, by the axes of both sensors but the one in question.
    fn has_moved(self, samples: &[Stamped<ImuSample>], axis: usize) -> bool {
        let others = |of: Self, s: &Stamped<ImuSample>| {
            let mut reading = of.reading(&s.sample);
            let is_same = matches!(
                (self, of),
                (Self::Gyroscope, Self::Gyroscope) | (Self::Accelerometer, Self::Accelerometer)
            );
            if is_same {
                reading[axis] = 0.0;
            }
            reading
        };
        let first = others(Self::Accelerometer, &samples[0]);
        samples.iter().any(|s| {
            others(Self::Gyroscope, s).norm() > RESTING_RAD_S
                || (others(Self::Accelerometer, s) - first).norm() > RESTING_M_S2
        })
    }
}

/// Takes out the samples of which an axis repeats one reading for too long while the device moved; returns for how many seconds that was.
///
/// [`Refusal::FrozenSensor`] where hardly any are left.
pub(super) fn take_out(imu: &mut Vec<Stamped<ImuSample>>) -> Result<f64, Error> {
    let mut is_frozen = vec![false; imu.len()];
    let (mut frozen_secs, mut longest) = (0.0, None);
    for sensor in Sensor::BOTH {
        for axis in 0..3 {
            let mut first = 0;
            while first < imu.len() {
                let reading = sensor.reading(&imu[first].sample)[axis];
                let same = imu[first..].iter();
                let same = same.take_while(|s| sensor.reading(&s.sample)[axis] == reading);
                let end = first + same.count().max(1);
                let secs = imu[end - 1].time.secs_since(imu[first].time);
                if secs > LONGEST_HELD_SECS && sensor.has_moved(&imu[first..end], axis) {
                    is_frozen[first..end].fill(true);
                    if secs > longest.map_or(0.0, |(_, secs)| secs) {
                        longest = Some((sensor, secs));
                    }
                }
                first = end;
            }
        }
    }
    let Some((sensor, secs)) = longest else {
        return Ok(0.0);
    };
    let times: Vec<_> = imu.iter().map(|s| s.time).collect();
    for (pair, is_frozen) in times.windows(2).zip(&is_frozen) {
        frozen_secs += if *is_frozen {
            pair[1].secs_since(pair[0])
        } else {
            0.0
        };
    }
    let left = is_frozen.iter().filter(|frozen| !**frozen).count();
    if (left as f64) < LEAST_LEFT * imu.len() as f64 {
        return Err(Refusal::FrozenSensor {
            sensor: sensor.name(),
            secs,
            of_secs: times[times.len() - 1].secs_since(times[0]),
        }
        .into());
    }
    let mut frozen = is_frozen.iter();
    imu.retain(|_| frozen.next() != Some(&true));
    Ok(frozen_secs)
}

#[cfg(test)]
mod tests {
    use lsfb_types::Timestamp;

    use super::*;

    /// Four seconds at 200 Hz; the device turns.
    fn samples(change: impl Fn(f64, &mut ImuSample)) -> Vec<Stamped<ImuSample>> {
        let sample = |k: i64| {
            let t = k as f64 * 5e-3;
            let mut sample = ImuSample {
                angular_velocity_rad_s: [0.01, 0.4 + (5.0 * t).sin(), 0.1].map(|v| v + 1e-4 * t),
                specific_force_m_s2: [0.2, 9.7, 0.5].map(|v| v + (3.0 * t).sin()),
            };
            change(t, &mut sample);
            let time = Timestamp::from_nanos(k * 5_000_000);
            Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample,
            }
        };
        (0..800).map(sample).collect()
    }

    #[test]
    fn what_a_sensor_repeats_while_the_device_moves_is_taken_out() {
        let mut right = samples(|_, _| {});
        assert_eq!(take_out(&mut right).expect("all of it"), 0.0);
        assert_eq!(right.len(), 800);
        let mut held = samples(|t, s| {
            if (1.0..2.0).contains(&t) {
                s.specific_force_m_s2[1] = 9.0;
            }
        });
        let secs = take_out(&mut held).expect("the rest");
        assert!((secs - 1.0).abs() < 0.01 && held.len() == 600, "{secs} s");
        let error = take_out(&mut samples(|_, s| s.specific_force_m_s2 = [0.0, 9.8, 0.0]));
        let error = error.expect_err("frozen").to_string();
        assert!(
            error.contains("accelerometer repeats one reading"),
            "{error}"
        );
        let error = take_out(&mut samples(|_, s| s.angular_velocity_rad_s = [0.0; 3]));
        assert!(error.expect_err("silent").to_string().contains("gyroscope"));
    }

    /// One at rest that reads in coarse steps says the same for long, and rightly.
    #[test]
    fn a_device_at_rest_may_repeat_itself() {
        let mut still = samples(|t, s| {
            s.angular_velocity_rad_s = [0.0, 0.001, 0.0];
            s.specific_force_m_s2 = [0.1, 9.81, 0.1 * (7.0 * t).sin()];
        });
        assert_eq!(take_out(&mut still).expect("all of it"), 0.0);
        assert_eq!(still.len(), 800);
    }
}
