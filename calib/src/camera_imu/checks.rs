//! Input that cannot give a good answer, found before and after the first guess, and named.

use lsfb_geometry::{ImuNoiseModel, Rig, Se3, Vector3};
use lsfb_types::{Bounds, Finding, ImuSample, OutOfBounds, Timestamp, Verdict};

use super::state::Sample;
use super::{CameraImuCalibration, CameraImuConfig, KnownCamera};
use crate::board::Target;
use crate::camera::expect_different_images;
use crate::stamps::{CAMERA_HZ, IMU_HZ, expect_nanoseconds};
use crate::{BadImu, Error, JoinProblem, WrongUnit};

/// Samples at the end of a range that make it one, and how many of them in a row.
const SATURATED: usize = 5;
const SATURATED_RUN: usize = 3;
/// Difference between the rig's and the seen pose of two cameras that is an error: radians and metres.
const MAX_TURN_RAD: f64 = 0.1;
const MAX_SHIFT_M: f64 = 0.05;
/// Mean of an accelerometer as a share of gravity: between these its unit is right, and around this it counts in g.
const RIGHT_UNIT: std::ops::Range<f64> = 0.7..1.5;
const IN_G: std::ops::Range<f64> = 0.08..0.13;
/// End of the range of the fastest gyroscopes that a person carries, 2000 °/s.
const FASTEST_RAD_S: f64 = 35.0;
/// A camera is another one of the rig where it stands so much nearer to that one's place than to its own.
const NEARER: f64 = 0.25;

/// Settings and sensors that are impossible.
pub(super) fn before(
    target: &Target,
    cameras: &[KnownCamera],
    noise: &ImuNoiseModel,
    config: &CameraImuConfig,
) -> Result<(), Error> {
    if let Some(problem) = target.problem() {
        return Err(problem.into());
    }
    config.check_bounds("camera_imu")?;
    for (name, density) in [
        ("gyro_noise_density", noise.gyro_noise_density),
        ("accel_noise_density", noise.accel_noise_density),
        ("gyro_bias_walk", noise.gyro_bias_walk),
        ("accel_bias_walk", noise.accel_bias_walk),
    ] {
        let bounds = Bounds::POSITIVE;
        if !bounds.hold(density) {
            return Err(OutOfBounds::new("imu", name, &density, &bounds).into());
        }
    }
    let mut names: Vec<&str> = cameras.iter().map(|c| c.views.name.as_str()).collect();
    names.sort_unstable();
    if let Some(twice) = names.windows(2).find(|w| w[0] == w[1]) {
        return Err(Error::NotJoined {
            first: twice[0].into(),
            second: twice[1].into(),
            cause: JoinProblem::NamedTwice,
        });
    }
    Ok(())
}

/// Fails where stamps or angular velocities are right in other units only, or two cameras were given the same images.
pub(super) fn units(cameras: &[KnownCamera], imu: &[(Timestamp, ImuSample)]) -> Result<(), Error> {
    expect_different_images(cameras.iter().map(|c| &c.views))?;
    for known in cameras {
        let what = format!("images of {}", known.views.name);
        expect_nanoseconds(&what, known.views.views.keys().copied(), CAMERA_HZ)?;
    }
    expect_nanoseconds(
        "samples of the IMU",
        imu.iter().map(|s| s.0.nanos()),
        IMU_HZ,
    )?;
    let mut rates: Vec<f64> = imu
        .iter()
        .map(|(_, s)| Vector3::from(s.angular_velocity_rad_s).norm())
        .collect();
    rates.sort_by(f64::total_cmp);
    let fast = rates.get(rates.len() * 9 / 10).copied().unwrap_or(0.0);
    if fast > FASTEST_RAD_S {
        return Err(Error::Unit {
            what: "the gyroscope".to_owned(),
            problem: WrongUnit::Degrees { rate_rad_s: fast },
        });
    }
    Ok(())
}

/// Whether each sample is at the end of the axis's range: values that repeat the largest one, some of them in a row.
pub(super) fn saturated(values: &[f64]) -> Vec<bool> {
    let largest = values.iter().fold(0.0f64, |a, v| a.max(v.abs()));
    let at_end: Vec<bool> = values
        .iter()
        .map(|v| largest > 0.0 && v.abs() >= largest * (1.0 - 1e-9))
        .collect();
    let count = at_end.iter().filter(|a| **a).count();
    let in_a_row = at_end.windows(SATURATED_RUN).any(|w| w.iter().all(|a| *a));
    if count >= SATURATED && in_a_row {
        at_end
    } else {
        vec![false; values.len()]
    }
}

/// Fails where what the accelerometer reads is not about gravity.
pub(super) fn unit_of_accelerometer(
    samples: &[Sample],
    config: &CameraImuConfig,
) -> Result<(), Error> {
    let sum: f64 = samples.iter().map(|s| s.accel.norm()).sum();
    let mean_m_s2 = sum / samples.len().max(1) as f64;
    let share = mean_m_s2 / config.gravity_m_s2;
    if RIGHT_UNIT.contains(&share) {
        return Ok(());
    }
    let bad = BadImu::Gravity {
        mean_m_s2,
        gravity_m_s2: config.gravity_m_s2,
        is_in_g: IN_G.contains(&share),
    };
    Err(bad.into())
}

impl CameraImuCalibration {
    /// Compares the result with the rig it started from: a camera that is found where that has another one is added to the
    /// findings.
    pub fn compare_with(&mut self, rig: &Rig) {
        for c in &self.cameras {
            let off = |name: &str| {
                let off = c.camera_from_rig * rig.cameras.get(name)?.rig_from_camera;
                let turn = off.rotation.angle() / MAX_TURN_RAD;
                Some(turn + off.translation.norm() / MAX_SHIFT_M)
            };
            let Some(own) = off(&c.name) else {
                continue;
            };
            let others = rig.cameras.keys().filter(|name| **name != c.name);
            let nearest = others
                .filter_map(|name| Some((name, off(name)?)))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((other, distance)) = nearest
                && distance < NEARER * own
                && distance < 1.0
            {
                let what = format!(
                    "was found where the rig has {other}: their images or their names are swapped"
                );
                let finding = Finding::new("swapped", Verdict::Warn, &*c.name, what);
                let remedy = "check which images belong to which camera";
                self.findings.push(finding.remedy(remedy));
            }
        }
    }
}

/// Fails where the poses of two cameras to each other, seen and from the rig, cannot both be true.
pub(super) fn agree(first: &str, second: &str, seen: &Se3, from_rig: &Se3) -> Result<(), Error> {
    let apart = |a: &Se3, b: &Se3| {
        let off = a.inverse() * *b;
        (off.rotation.angle(), off.translation.norm())
    };
    let (turn_rad, shift_m) = apart(from_rig, seen);
    if turn_rad < MAX_TURN_RAD && shift_m < MAX_SHIFT_M {
        return Ok(());
    }
    let (back_rad, back_m) = apart(&from_rig.inverse(), seen);
    let cause = match back_rad < MAX_TURN_RAD && back_m < MAX_SHIFT_M {
        true => JoinProblem::Swapped,
        false => JoinProblem::Misplaced { turn_rad, shift_m },
    };
    Err(Error::NotJoined {
        first: first.into(),
        second: second.into(),
        cause,
    })
}

/// A board that hangs upside down.
pub(super) fn upside_down(target: &Target, gravity_in_target: &Vector3<f64>) -> Option<Finding> {
    let up = match target {
        Target::AprilGrid { .. } => Vector3::y(),
        Target::Checkerboard { .. } | Target::Charuco { .. } => -Vector3::y(),
    };
    let share = gravity_in_target.try_normalize(1e-9)?.dot(&up);
    (share > 0.5).then(|| {
        let what = "the board hangs upside down: the calibration is valid, but wherever the board is used as a landmark, its top is now its bottom";
        Finding::new("upside-down", Verdict::Warn, "board", what).remedy("turn the board")
    })
}
