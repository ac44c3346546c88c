//! Whether IMU and scans saw the same motion.
//!
//! Asked once the walk is over, of the poses that the scans have without the IMU's help. A wrong IMU leaves them right often enough: where scans are
//! seconds apart they are searched for, and found where they are, though the path between them is nonsense and the world lies on its head. What
//! the IMU says from scan to scan must then fit them, and in no other way nearly as well: the gyroscope by its axes, by its clock, and by
//! where the LiDAR hangs on it; then the accelerometer by its axes and by its unit.

mod axes;
mod chain;
mod clock;
mod extrinsic;
mod pairs;
mod scale;
mod scans;
mod triples;
mod turns;

#[cfg(test)]
mod tests;

use lsfb_geometry::{StampedPose, Vector3};
use lsfb_types::{ImuSample, Stamped};

use super::OdometryWarning;
use axes::Sensor;
pub(super) use pairs::lay;
pub(super) use scans::Scans;
use turns::Turns;

/// A scan that is not deskewed is turned as its carrier was some time within the sweep, not at its stamp: a clock may look so late by that alone, seconds.
const SWEEP_S: f64 = 0.12;
/// What a clock may be off without a word, seconds: the path is then off by as much as the carrier moves meanwhile.
const LATE_S: f64 = 0.02;
/// By how much a rotation must be off to be named, radians; where scans are not deskewed, by three degrees, and turns must last so many seconds.
const TURNED_RAD: f64 = 0.017_453;
const TURNED_UNDESKEWED_RAD: f64 = 0.052_360;
const UNDESKEWED_S: f64 = 2.0;

/// What IMU and scans contradict each other in: that which explains the most alone, as the others cannot be told before it is mended.
///
/// `trajectory` has the poses of the same scans with the IMU's help. `unseen` has for each the direction of the world along which the scan sees no
/// motion, if there is one.
pub(super) fn contradictions(
    by_scans: &[StampedPose],
    trajectory: &[StampedPose],
    unseen: &[Option<Vector3<f64>>],
    samples: &[Stamped<ImuSample>],
    is_deskewed: bool,
) -> Vec<OdometryWarning> {
    let Some(turns) = Turns::new(by_scans, samples) else {
        return Vec::new();
    };
    if let Some(wrong) = axes::of_gyroscope(&turns) {
        return vec![wrong.warning(Sensor::Gyroscope)];
    }
    let mut said = Vec::new();
    let clock = clock::clock_off(&turns);
    let late_s = clock.map_or(0.0, |off| off.late_s);
    let silent_s = if is_deskewed { LATE_S } else { SWEEP_S };
    said.extend(clock.filter(|off| off.late_s.abs() > silent_s).map(|off| {
        let (late_s, sigma_s) = (off.late_s, off.sigma_s);
        OdometryWarning::ImuClock { late_s, sigma_s }
    }));
    let least_rad = match is_deskewed {
        true => TURNED_RAD,
        false => TURNED_UNDESKEWED_RAD,
    };
    // One that is not deskewed is turned by what the carrier turned while it was taken: little of a turn that lasts long.
    let mut long = turns.late(late_s);
    long.retain(|turn| is_deskewed || turn.duration_s > UNDESKEWED_S);
    let turned = extrinsic::rotation_off(&long, least_rad);
    said.extend(turned.map(|off| OdometryWarning::ExtrinsicRotation {
        off_deg: off.off_rad.to_degrees(),
        sigma_deg: off.sigma_rad.to_degrees(),
    }));
    let triples = triples::triples(by_scans, unseen, samples, late_s, triples::LEAST_S);
    match axes::of_accelerometer(&triples) {
        Some(wrong) => said.push(wrong.warning(Sensor::Accelerometer)),
        // Attitudes that are off feign other units.
        None if said.is_empty() => {
            // Scans that are not deskewed are as long as the carrier moves while they are taken.
            let lengths = || {
                let far = scale::PERCENTS_S;
                let far = triples::triples(trajectory, unseen, samples, late_s, far);
                scale::lengths_off(&far).filter(|_| is_deskewed)
            };
            let off = scale::scale_off(&triples).or_else(lengths);
            said.extend(off.map(|off| {
                let (scale, sigma) = (off.scale, off.sigma);
                OdometryWarning::Scale { scale, sigma }
            }));
        }
        None => {}
    }
    said
}

/// Whether the scans tell that the accelerometer is right along a direction of the world: elsewhere on the walk, where they see motion along it.
pub(super) fn is_told_along(
    by_scans: &[StampedPose],
    unseen: &[Option<Vector3<f64>>],
    samples: &[Stamped<ImuSample>],
    along: &Vector3<f64>,
) -> bool {
    let triples = triples::triples(by_scans, unseen, samples, 0.0, triples::LEAST_S);
    axes::is_told(&triples, along)
}
