//! Clocks of cameras as images and gyroscope have them, put into the rig: for cameras that do not say which clock stamps their images.

use lsfb_geometry::Rig;
use lsfb_types::Verdict;
use serde::Serialize;

use super::{Check, Verification, rotation_name, time_drift_name, time_offset_name};

/// A standard deviation above which a clock is not put into a rig, milliseconds: what a good calibration knows it to (`judgement.rs`).
const MAX_SIGMA_MS: f64 = 0.5;

/// The clock of a camera, as a recording's images and gyroscope have it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasuredClock {
    /// The camera.
    pub camera: String,
    /// Added to the camera's stamps it gives the time of the IMU, seconds.
    pub rig_from_camera_s: f64,
    /// Its standard deviation, seconds.
    pub sigma_s: f64,
    /// What the rig said before, seconds.
    pub stated_s: f64,
}

impl Verification {
    /// The rig that was verified, with the clocks that were measured in place of those it states. A camera keeps its clock where it was
    /// measured to no better than half a millisecond or changes on the way, and where the camera does not turn as the gyroscope does: then it may be another's.
    pub fn with_measured_clocks(&self, rig: &Rig) -> (Rig, Vec<MeasuredClock>) {
        let mut corrected = rig.clone();
        let mut clocks = Vec::new();
        let check = |name: &str| self.checks.iter().find(|check| check.name == name);
        for (camera, mounted) in &mut corrected.cameras {
            let turns = check(&rotation_name(camera));
            let is_its_own =
                turns.is_some_and(|c| !matches!(c.outcome, Verdict::Fail | Verdict::Unknown));
            // One that drifts has no offset that is right all along.
            let drifts = check(&time_drift_name(camera));
            let drifts = drifts.is_some_and(|c| c.outcome > Verdict::Pass);
            let found = check(&time_offset_name(camera)).filter(|_| is_its_own && !drifts);
            let Some(Check {
                value: Some(offset_ms),
                sigma: Some(sigma_ms),
                ..
            }) = found
            else {
                continue;
            };
            let is_known = *sigma_ms <= MAX_SIGMA_MS;
            if !is_known {
                continue;
            }
            let stated_s = mounted.timing.rig_from_camera_s;
            mounted.timing.rig_from_camera_s = stated_s + offset_ms * 1e-3;
            clocks.push(MeasuredClock {
                camera: camera.clone(),
                rig_from_camera_s: mounted.timing.rig_from_camera_s,
                sigma_s: sigma_ms * 1e-3,
                stated_s,
            });
        }
        (corrected, clocks)
    }
}
