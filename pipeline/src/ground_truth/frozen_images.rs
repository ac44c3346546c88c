//! Images that a camera sent once more.
//!
//! No two images of a sensor with noise are the same. One that is the same as that before it, though the device turned, shows what was
//! seen then: used at its own stamp it would hold the device where it was.

use lsfb_geometry::Vector3;
use lsfb_types::{ImuSample, Stamped, Timestamp};

use crate::features::Features;
use crate::frames::FeatureFrame;

/// A device at rest turns no faster than this, by its gyroscope's noise and bias, rad/s.
pub(super) const RESTING_RAD_S: f64 = 0.1;

/// Takes the features from images that repeat the one before while the device turned; returns how many those are. Without an IMU all that
/// repeat are taken for such.
pub(super) fn take_out(frames: &mut [FeatureFrame], imu: &[Stamped<ImuSample>]) -> u64 {
    let cameras = frames.first().map_or(0, |frame| frame.features.len());
    let mut frozen = 0;
    for camera in 0..cameras {
        let mut last: Option<(Timestamp, Features)> = None;
        for frame in &mut *frames {
            let here = &mut frame.features[camera].features;
            if here.is_empty() {
                continue;
            }
            match &last {
                Some((since, features)) if features == here => {
                    if imu.is_empty() || has_turned(imu, *since, frame.time) {
                        *here = Features::default();
                        frozen += 1;
                    }
                }
                _ => last = Some((frame.time, here.clone())),
            }
        }
    }
    frozen
}

/// Whether the device was turned between two instants.
pub(super) fn has_turned(imu: &[Stamped<ImuSample>], from: Timestamp, to: Timestamp) -> bool {
    let first = imu.partition_point(|s| s.time < from);
    let end = imu.partition_point(|s| s.time <= to);
    let mut between = imu[first..end.max(first)].iter();
    between.any(|s| Vector3::from(s.sample.angular_velocity_rad_s).norm() > RESTING_RAD_S)
}
