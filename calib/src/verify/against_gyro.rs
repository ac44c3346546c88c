//! A camera against the gyroscope: time offset and rotation.

use lsfb_geometry::IntegratedGyro;
use lsfb_geometry::{RigCamera, so3};
use lsfb_perception::image::Pair;
use lsfb_types::Verdict;

use super::judgement::{judged, unclear};
use super::time_offset::{self, Agreement, Inconclusive};
use super::{Check, VerifyConfig, rotation_name, time_offset_name};

/// Both checks.
pub(super) fn against_gyro(
    name: &str,
    mounted: &RigCamera,
    pairs: &[Pair],
    gyro: Option<&IntegratedGyro>,
    config: &VerifyConfig,
) -> Vec<Check> {
    let mut time = Check::unknown(
        "time-offset",
        time_offset_name(name),
        "ms",
        config.time_offset_ms,
    );
    let mut rotation = Check::unknown(
        "imu-rotation",
        rotation_name(name),
        "°",
        config.imu_rotation_deg,
    );
    let Some(gyro) = gyro else {
        for check in [&mut time, &mut rotation] {
            "the recording has no gyroscope: record the rig's IMU together with its cameras"
                .clone_into(&mut check.sentence);
        }
        return vec![time, rotation];
    };
    match time_offset::agree(pairs, mounted, gyro) {
        Ok(found) => {
            judge_time(&mut time, mounted, &found);
            judge_rotation(&mut rotation, mounted, &found);
        }
        Err(inconclusive) => {
            let why = match inconclusive {
                Inconclusive::TooFewPairs(n) => format!(
                    "{n} image pairs follow the gyroscope, but 30 are needed: record longer, with more to see"
                ),
                Inconclusive::TooLittleTurning(rate) => {
                    format!("rotation about a second axis is only {rate:.3} rad/s: rotate more")
                }
                Inconclusive::EndOfSearch(offset_s) => {
                    time.outcome = Verdict::Fail;
                    format!(
                        "no time offset within {:.0} ms aligns the images with the gyroscope: their clocks do not belong to one rig",
                        offset_s.abs() * 1e3
                    )
                }
            };
            time.sentence.clone_from(&why);
            rotation.sentence = why;
        }
    }
    vec![time, rotation]
}

fn judge_time(check: &mut Check, mounted: &RigCamera, found: &Agreement) {
    let offset_ms = found.offset_s * 1e3;
    let sigma_ms = found.offset_sigma_s * 1e3;
    check.outcome = judged(offset_ms.abs(), sigma_ms, check.limits);
    check.value = Some(offset_ms);
    check.sigma = Some(sigma_ms);
    // What a wrong clock moves the image by while the rig turns as it does here.
    let moved_px = |ms: f64| mounted.camera.focal_px()[0] * found.rate_rad_s * ms * 1e-3;
    check.sentence = match check.outcome {
        Verdict::Unknown => unclear(sigma_ms, "ms"),
        Verdict::Pass => format!(
            "images and gyroscope agree in time over {} image pairs; at this motion, {:.0} ms would move the image by {:.1} px",
            found.pairs,
            check.limits[0],
            moved_px(check.limits[0])
        ),
        _ => format!(
            "images were taken {:.1} ms {} than the rig says, which moves them by {:.1} px at this motion: check triggers and clocks, or calibrate camera and IMU again",
            offset_ms.abs(),
            if offset_ms > 0.0 { "later" } else { "earlier" },
            moved_px(offset_ms.abs())
        ),
    };
}

fn judge_rotation(check: &mut Check, mounted: &RigCamera, found: &Agreement) {
    let expected = mounted.rig_from_camera.rotation.inverse();
    let off = so3::local(&expected, &found.camera_from_rig);
    let (off_deg, sigma_deg) = (
        off.norm().to_degrees(),
        found.rotation_sigma_rad.to_degrees(),
    );
    check.outcome = judged(off_deg, sigma_deg, check.limits);
    check.value = Some(off_deg);
    check.sigma = Some(sigma_deg);
    check.sentence = match check.outcome {
        Verdict::Unknown => unclear(sigma_deg, "°"),
        Verdict::Pass => "the camera's rotation agrees with the gyroscope".to_owned(),
        _ => format!(
            "the camera is rotated by {off_deg:.1}° about the rig's {} axis: it was moved, or the rig belongs to another device",
            ["x", "y", "z"][off.iamax()]
        ),
    };
}
