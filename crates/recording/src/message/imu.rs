use lsfb_types::{ImuSample, Timestamp};

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// Variance of each axis of an inertial sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuVariance {
    /// Of the gyroscope, rad²/s².
    pub angular_velocity_rad2_s2: f64,
    /// Of the accelerometer, m²/s⁴.
    pub specific_force_m2_s4: f64,
}

impl ImuVariance {
    /// All zeros, as the type of the message has it.
    pub const UNKNOWN: Self = Self {
        angular_velocity_rad2_s2: 0.0,
        specific_force_m2_s4: 0.0,
    };
}

/// Alike and independent along each axis.
fn diagonal(variance: f64) -> [f64; 9] {
    let mut matrix = [0.0; 9];
    for k in [0, 4, 8] {
        matrix[k] = variance;
    }
    matrix
}

/// `sensor_msgs/msg/Imu` without orientation (`orientation_covariance[0]` is −1, as the type asks for).
pub fn encode_imu(
    time: Timestamp,
    frame: &str,
    sample: &ImuSample,
    variance: ImuVariance,
) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(336);
    w.header(time, frame);
    w.f64s(&[0.0, 0.0, 0.0, 1.0]);
    w.f64(-1.0);
    w.f64s(&[0.0; 8]);
    w.f64s(&sample.angular_velocity_rad_s);
    w.f64s(&diagonal(variance.angular_velocity_rad2_s2));
    w.f64s(&sample.specific_force_m_s2);
    w.f64s(&diagonal(variance.specific_force_m2_s4));
    w.finish()
}

/// Angular velocity and specific force of a `sensor_msgs/msg/Imu`.
pub fn decode_imu(bytes: &[u8]) -> Result<ImuSample, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    r.f64_array::<4>("orientation")?;
    r.f64_array::<9>("orientation_covariance")?;
    let angular_velocity_rad_s = r.f64_array("angular_velocity")?;
    r.f64_array::<9>("angular_velocity_covariance")?;
    let specific_force_m_s2 = r.f64_array("linear_acceleration")?;
    r.f64_array::<9>("linear_acceleration_covariance")?;
    Ok(ImuSample {
        angular_velocity_rad_s,
        specific_force_m_s2,
    })
}

/// A `sensor_msgs/msg/TimeReference`: the device's own counter at a synchronized time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TimeReference {
    /// Ticks of the device's counter, in its own unit. On the wire they are split at 10⁹ into seconds and nanoseconds.
    pub device_ticks: u64,
    /// Whose counter: the device's name.
    pub source: String,
}

const TICKS_PER_TIME_REF_SEC: u64 = 1_000_000_000;

/// `sensor_msgs/msg/TimeReference`. `None` from 2³² · 10⁹ ticks on (136 years of nanoseconds), which the message cannot hold.
pub fn encode_time_reference(
    time: Timestamp,
    frame: &str,
    reference: &TimeReference,
) -> Option<Vec<u8>> {
    let secs = u32::try_from(reference.device_ticks / TICKS_PER_TIME_REF_SEC).ok()?;
    let mut w = CdrWriter::with_capacity(64 + frame.len() + reference.source.len());
    w.header(time, frame);
    w.u32(secs);
    w.u32((reference.device_ticks % TICKS_PER_TIME_REF_SEC) as u32);
    w.string(&reference.source);
    Some(w.finish())
}

/// The counter of a `sensor_msgs/msg/TimeReference`.
pub fn decode_time_reference(bytes: &[u8]) -> Result<TimeReference, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    let secs = u64::from(r.u32("time_ref")?);
    let nanos = u64::from(r.u32("time_ref")?);
    Ok(TimeReference {
        device_ticks: secs * TICKS_PER_TIME_REF_SEC + nanos,
        source: r.string("source")?.to_owned(),
    })
}
