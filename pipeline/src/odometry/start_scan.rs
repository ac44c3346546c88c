//! The scan that a walk starts with: where it draws too little of the place, nothing after it finds itself there.
//!
//! A recording begins wherever the rotor stands, so its first scan may be a part of a turn, and a whole turn agrees with that part only in a few
//! of its points. A scan that finds no place takes no part in the map, so such a walk would never begin. Until some scan has found its place,
//! the fullest of those that came is the start.

use lsfb_types::{ImuSample, LidarScan, Stamped};

use super::first_second::FirstSecond;
use super::{Odometry, OdometryStep, StepOutcome};
use crate::Error;

/// A scan with fewer of another's keypoints than this share draws a part of what that one draws.
const PART: f64 = 0.75;
/// Scans without a place after which the start stands: what is wrong is something else.
const SCANS: usize = 10;

/// The odometry as it was before its first scan, while no other has found its place.
#[derive(Clone, Debug)]
pub(super) struct StartScan {
    blank: Box<Odometry>,
    keypoints: usize,
    /// Scans that found no place.
    lost: usize,
}

impl StartScan {
    /// Takes the first scan.
    pub fn begin(
        odometry: &mut Odometry,
        scan: &Stamped<LidarScan>,
    ) -> Result<OdometryStep, Error> {
        let blank = Box::new(odometry.clone());
        let step = FirstSecond::begin(odometry, scan)?;
        odometry.start_scan = Some(Self {
            blank,
            keypoints: step.keypoints_in_rig.len(),
            lost: 0,
        });
        Ok(step)
    }

    /// Takes a sample that came after the first scan.
    pub fn push_imu(&mut self, sample: &Stamped<ImuSample>) {
        self.blank.push_imu(sample);
    }

    /// Looks at what another scan gave: the walk may have to start with that one.
    pub fn go_on(
        mut self,
        odometry: &mut Odometry,
        scan: &Stamped<LidarScan>,
        step: OdometryStep,
    ) -> OdometryStep {
        self.lost += 1;
        if step.outcome != StepOutcome::Lost || self.lost > SCANS {
            return step;
        }
        if (self.keypoints as f64) < PART * step.keypoints_in_rig.len() as f64 {
            let mut begun = (*self.blank).clone();
            if let Ok(first) = Self::begin(&mut begun, scan)
                && first.outcome == StepOutcome::First
            {
                *odometry = begun;
                return first;
            }
        }
        odometry.start_scan = Some(self);
        step
    }
}
