//! What the recorder says itself: clock models, camera groups, health.

use lsfb_types::Timestamp;

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// `lsfb_msgs/msg/ClockModel`: how a device's counter is read, as it was known at the header's stamp.
///
/// `time = reference_time + (1 + skew) · (device − reference_device)`, all in nanoseconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClockModel {
    /// Name of the device.
    pub device: String,
    /// `locked`: the device names the second itself; `fitted`: its counter is fitted to arrival from below.
    pub kind: String,
    /// Counts the times the counter, or the host's clock, began anew; from 1.
    pub epoch: u32,
    /// The counter at the reference, nanoseconds; unwrapped.
    pub reference_device_ns: i64,
    /// Recording time at the reference, nanoseconds.
    pub reference_time_ns: i64,
    /// Recording seconds per device second, less one.
    pub skew: f64,
    /// Standard deviation of the time at the reference, nanoseconds. The constant part of the transport delay, which no
    /// one-way method sees, is not in it.
    pub sigma_ns: f64,
    /// Standard deviation of the skew.
    pub sigma_skew: f64,
    /// Pairs of stamps behind the model.
    pub pairs: u64,
    /// One tick of the recorded counter, nanoseconds.
    pub tick_ns: u64,
    /// Ticks after which the recorded counter wraps; 0 where it does not.
    pub period_ticks: u64,
}

/// `lsfb_msgs/msg/ClockModel`.
pub fn encode_clock_model(time: Timestamp, frame: &str, model: &ClockModel) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(160 + frame.len() + model.device.len());
    w.header(time, frame);
    w.string(&model.device);
    w.string(&model.kind);
    w.u32(model.epoch);
    w.u64(model.reference_device_ns.cast_unsigned());
    w.u64(model.reference_time_ns.cast_unsigned());
    w.f64(model.skew);
    w.f64(model.sigma_ns);
    w.f64(model.sigma_skew);
    w.u64(model.pairs);
    w.u64(model.tick_ns);
    w.u64(model.period_ticks);
    w.finish()
}

/// A `lsfb_msgs/msg/ClockModel`.
pub fn decode_clock_model(bytes: &[u8]) -> Result<ClockModel, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    Ok(ClockModel {
        device: r.string("device")?.to_owned(),
        kind: r.string("kind")?.to_owned(),
        epoch: r.u32("epoch")?,
        reference_device_ns: r.u64("reference_device_ns")?.cast_signed(),
        reference_time_ns: r.u64("reference_time_ns")?.cast_signed(),
        skew: r.f64("skew")?,
        sigma_ns: r.f64("sigma_ns")?,
        sigma_skew: r.f64("sigma_skew")?,
        pairs: r.u64("pairs")?,
        tick_ns: r.u64("tick_ns")?,
        period_ticks: r.u64("period_ticks")?,
    })
}

/// `lsfb_msgs/msg/CameraGroup`: which images of one trigger there are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CameraGroup {
    /// Number of the trigger, by the first unit's frame counter, continued beyond its wrap.
    pub trigger: u64,
    /// Cameras in the rig.
    pub expected: u32,
    /// Images that came.
    pub present: u32,
    /// Cameras without image, by name, separated by blanks; empty where the group is complete.
    pub missing: String,
}

/// `lsfb_msgs/msg/CameraGroup`.
pub fn encode_camera_group(time: Timestamp, frame: &str, group: &CameraGroup) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(64 + frame.len() + group.missing.len());
    w.header(time, frame);
    w.u64(group.trigger);
    w.u32(group.expected);
    w.u32(group.present);
    w.string(&group.missing);
    w.finish()
}

/// A `lsfb_msgs/msg/CameraGroup`.
pub fn decode_camera_group(bytes: &[u8]) -> Result<CameraGroup, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    Ok(CameraGroup {
        trigger: r.u64("trigger")?,
        expected: r.u32("expected")?,
        present: r.u32("present")?,
        missing: r.string("missing")?.to_owned(),
    })
}

/// `lsfb_msgs/msg/HealthValue`: one quantity of one device at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HealthValue {
    /// Name of the device.
    pub device: String,
    /// The quantity; its unit is in `FORMAT.md`, by topic.
    pub value: f64,
    /// 0 as it should be, 1 worth a look, 2 data is being lost.
    pub level: u8,
    /// What is wrong, for people; empty where nothing is.
    pub text: String,
}

/// `lsfb_msgs/msg/HealthValue`.
pub fn encode_health_value(time: Timestamp, frame: &str, health: &HealthValue) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(64 + frame.len() + health.device.len());
    w.header(time, frame);
    w.string(&health.device);
    w.f64(health.value);
    w.u8(health.level);
    w.string(&health.text);
    w.finish()
}

/// A `lsfb_msgs/msg/HealthValue`.
pub fn decode_health_value(bytes: &[u8]) -> Result<HealthValue, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    Ok(HealthValue {
        device: r.string("device")?.to_owned(),
        value: r.f64("value")?,
        level: r.u8("level")?,
        text: r.string("text")?.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_recorder_says_comes_back() {
        let time = Timestamp::from_nanos(1_772_359_200_000_000_007);
        let model = ClockModel {
            device: "imu0".to_owned(),
            kind: "fitted".to_owned(),
            epoch: 2,
            reference_device_ns: -5,
            reference_time_ns: time.nanos(),
            skew: -3.25e-5,
            sigma_ns: 1_250.0,
            sigma_skew: 2.5e-8,
            pairs: 77,
            tick_ns: 100_000,
            period_ticks: 1 << 32,
        };
        let bytes = encode_clock_model(time, "imu0", &model);
        assert_eq!(decode_clock_model(&bytes).unwrap(), model);
        let group = CameraGroup {
            trigger: 70_000,
            expected: 4,
            present: 3,
            missing: "cam2".to_owned(),
        };
        let bytes = encode_camera_group(time, "rig", &group);
        assert_eq!(decode_camera_group(&bytes).unwrap(), group);
        let health = HealthValue {
            device: "lidar".to_owned(),
            value: 1_507.5,
            level: 1,
            text: "3 lost in all".to_owned(),
        };
        let bytes = encode_health_value(time, "lidar", &health);
        assert_eq!(decode_health_value(&bytes).unwrap(), health);
        for cut in 0..bytes.len() {
            assert!(decode_health_value(&bytes[..cut]).is_err(), "{cut}");
        }
    }
}
