//! What an IMU says at one time.

use lsfb_geometry::Vector3;
use lsfb_types::{ImuSample, Stamped, Timestamp};

/// Angular velocity and specific force at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// When.
    pub time: Timestamp,
    /// rad/s.
    pub angular_velocity: Vector3<f64>,
    /// m/s².
    pub specific_force: Vector3<f64>,
}

impl From<&Stamped<ImuSample>> for Reading {
    fn from(s: &Stamped<ImuSample>) -> Self {
        Self {
            time: s.time,
            angular_velocity: s.sample.angular_velocity_rad_s.into(),
            specific_force: s.sample.specific_force_m_s2.into(),
        }
    }
}

impl Reading {
    /// On the straight line between two, the nearer one outside them.
    pub fn between(a: &Self, b: &Self, time: Timestamp) -> Self {
        let span = b.time.secs_since(a.time);
        let fraction = if span > 0.0 {
            (time.secs_since(a.time) / span).clamp(0.0, 1.0)
        } else {
            1.0
        };
        Self {
            time,
            angular_velocity: a.angular_velocity.lerp(&b.angular_velocity, fraction),
            specific_force: a.specific_force.lerp(&b.specific_force, fraction),
        }
    }
}

/// Reading at `time`, linear between samples, the nearest one outside them.
pub fn reading_at(samples: &[Stamped<ImuSample>], time: Timestamp) -> Option<Reading> {
    let next = samples.partition_point(|s| s.time < time);
    match (
        next.checked_sub(1).and_then(|i| samples.get(i)),
        samples.get(next),
    ) {
        (Some(a), Some(b)) => Some(Reading::between(&a.into(), &b.into(), time)),
        (Some(only), None) | (None, Some(only)) => Some(Reading {
            time,
            ..only.into()
        }),
        (None, None) => None,
    }
}
