//! A start in motion. Nothing tells the velocity of the first scan until the second is there: undone with none at all, a scan at a metre a
//! second is smeared by a decimetre, and all that follows is registered to it. So the first scan is kept, and with the second
//! the walk begins again, until the velocity at its start and that at which the second scan is found agree.

use lsfb_geometry::Vector3;
use lsfb_types::{LidarScan, Stamped};

use super::motion::{Motion, StartVelocity, end_pose};
use super::{Odometry, StepOutcome};

/// Beginnings that are tried; each is wrong by a small part of the one before.
const ROUNDS: usize = 6;
/// Velocities that agree, m/s.
const AGREE_M_S: f64 = 0.01;
/// Two scans further apart than this tell a mean velocity, not that of the first, seconds.
const FAR_APART_S: f64 = 0.5;
/// Of a velocity of which nothing is known, m/s.
const UNKNOWN_M_S: f64 = 2.0;
/// How far two scans may be registered wrongly, metres.
const REGISTERED_M: f64 = 0.02;

/// Scans of which the map is drawn before it holds others: until then rings lie on rings, and a scan that sways with the carrier looks as
/// if it did not.
const UNSTEADY_SCANS: u32 = 10;
/// So many times more of their points share an error: they hold the pose to a third of a degree and some centimetres, no better than the
/// IMU does.
pub(super) const SHARED_BY: f64 = 900.0;

/// The odometry as it was before its first scan, and that scan.
#[derive(Clone, Debug)]
pub(super) struct FirstScan {
    blank: Box<Odometry>,
    scan: Stamped<LidarScan>,
}

impl FirstScan {
    pub fn keep(blank: Odometry, scan: &Stamped<LidarScan>) -> Self {
        Self {
            blank: Box::new(blank),
            scan: scan.clone(),
        }
    }

    /// The odometry after the first scan, now that the second is there. The pose at the end of the first scan stays what it was
    /// said to be. `None` where the two tell nothing of the velocity.
    pub fn begun_again(&self, after: &Odometry, second: &Stamped<LidarScan>) -> Option<Odometry> {
        let blank = self.with_samples_of(after)?;
        let apart_s = second.time.secs_since(self.scan.time);
        if !(apart_s > 0.0 && apart_s <= FAR_APART_S) {
            return None;
        }
        let mut start = StartVelocity {
            velocity_m_s: Vector3::zeros(),
            sigma_m_s: UNKNOWN_M_S,
        };
        for _ in 0..ROUNDS {
            let begun = begin(&blank, start, &self.scan)?;
            let end = begun.end_of(second).ok()?;
            let mut predicted = begun.clone();
            let path = predicted.predict(second.time, end).ok()?;
            let mut found = begun.clone();
            let step = found.take_scan(second).ok()?;
            if step.outcome != StepOutcome::Registered {
                return None;
            }
            let span_s = end.secs_since(begun.last?.time);
            let missed_m = step.by_scan_alone.translation - end_pose(&path).translation;
            let change = missed_m / span_s;
            start.velocity_m_s += change;
            start.sigma_m_s = (2.0 * change.norm()).clamp(REGISTERED_M / span_s, 0.5 * UNKNOWN_M_S);
            if change.norm() < AGREE_M_S {
                return begin(&blank, start, &self.scan);
            }
        }
        None
    }

    /// The blank one with the inertial samples that came since.
    fn with_samples_of(&self, after: &Odometry) -> Option<Odometry> {
        let mut blank = (*self.blank).clone();
        let (Motion::Inertial(own), Motion::Inertial(later)) = (&mut blank.motion, &after.motion)
        else {
            return None;
        };
        let last = own.samples.last()?.time;
        let newer = later.samples.iter().filter(|s| s.time > last);
        own.samples.extend(newer.cloned());
        Some(blank)
    }
}

/// After the first scan, with a start velocity.
fn begin(blank: &Odometry, start: StartVelocity, scan: &Stamped<LidarScan>) -> Option<Odometry> {
    let mut begun = blank.clone();
    if let Motion::Inertial(inertial) = &mut begun.motion {
        inertial.start = Some(start);
    }
    begun.take_scan(scan).ok()?;
    if start.sigma_m_s < UNKNOWN_M_S {
        // What the next scan is matched with is near: between the rings of one scan other surfaces are nearest.
        begun.corrections_m = [REGISTERED_M; 3].into();
        begun.unsteady_scans = UNSTEADY_SCANS;
    }
    Some(begun)
}
