//! What a walk makes of its IMU: errors that its noise and biases leave out.

use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

use super::GroundTruthConfig;
use super::config::{InertialPriors, UNLIKELY_SIGMAS};
use super::imu_agreement::left_sigmas;
use super::imu_swing::{ImuSwing, LARGEST_SWING, Swinging, swing};
use super::imu_wander::{BiasChange, BiasWander, PULLED_SIGMAS};
use super::optimization::Optimized;
use super::walk::Walk;
use crate::Error;
use lsfb_perception::imu::{ImuErrors, standard_gravity_m_s2};

/// By how much gravity may be off, percent: the Earth's own differs by up to half of it, and no standard deviation has the scale in it.
const LARGEST_GRAVITY_PERCENT: f64 = 1.0;
/// Beyond so many standard deviations no IMU explains what the solve calls its errors: images that are late or of another camera do, and the
/// walk is bent by them. In right walks of real devices and of simulated ones they are at most 2; an accelerometer turned by 4°, which is solved
/// rightly, has 10; images that were 100 ms late had 13 and 19, cameras exchanged 22.
const UNEXPLAINED_SIGMAS: f64 = 12.0;

const CALIBRATE_IMU: &str =
    "calibrate the IMU's scale and axes, and stamp both of its sensors with one clock";
const CHECK_DEVICE: &str = "such IMU errors are implausible: check that each camera's images are its \
     own, that images and samples are stamped with one clock, and the IMU's axes and units";

/// Errors of an IMU that stay the same all along; the trajectory is computed without them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImuRefinement {
    /// Gravity as the accelerometer feels it, m/s²: nowhere on Earth is it far from the standard, unless the accelerometer's scale is wrong.
    pub gravity_m_s2: f64,
    /// Shares by which the gyroscope's axes read too much.
    pub gyro_scale: [f64; 3],
    /// The same of the accelerometer's.
    pub accel_scale: [f64; 3],
    /// Shares of one axis that another of the gyroscope's reads too: y and z, x and z, x and y.
    pub gyro_shear: [f64; 3],
    /// The same of the accelerometer's.
    pub accel_shear: [f64; 3],
    /// By how much the accelerometer's readings are turned on the gyroscope's axes, about each, degrees.
    pub accel_turn_deg: [f64; 3],
    /// By how much the accelerometer's readings are later than the gyroscope's, seconds.
    pub accel_delay_s: f64,
    /// Largest of these in the standard deviations that the settings give them.
    pub imu_error_sigmas: f64,
    /// The most that its biases change in a while.
    pub bias_wander: BiasWander,
    /// Root mean square of what images and IMU then still differ by, in standard deviations of its noise as the rig file states it.
    pub imu_left_sigmas: f64,
    /// At which frequency images contradict it most; nothing where that cannot be told.
    pub imu_swing: Option<ImuSwing>,
}

impl ImuRefinement {
    pub(super) fn of(
        walk: &Walk,
        solved: &Optimized,
        config: &GroundTruthConfig,
    ) -> Result<Self, Error> {
        let errors = &solved.imu_errors;
        Ok(Self {
            gravity_m_s2: felt_gravity_m_s2(solved),
            gyro_scale: errors.gyro_scale.into(),
            accel_scale: errors.accel_scale.into(),
            gyro_shear: errors.gyro_shear.into(),
            accel_shear: errors.accel_shear.into(),
            accel_turn_deg: errors.accel_turn_rad.map(f64::to_degrees).into(),
            accel_delay_s: errors.accel_delay_s,
            imu_error_sigmas: config.inertial.sigmas_of(errors),
            bias_wander: BiasWander::of(walk, &solved.estimate.states),
            imu_left_sigmas: left_sigmas(walk, solved)? * config.imu_noise_factor,
            imu_swing: swing(walk, solved, config)?,
        })
    }

    /// How many times larger the IMU's noise must be taken for standard deviations to have in them what no unknown stands for: the solve gives
    /// way to the images, so that what is left is less than what was wrong.
    pub(super) fn noise_factor(&self) -> f64 {
        self.imu_left_sigmas.max(1.0)
    }

    /// Everything that was looked at, good or not.
    pub(super) fn findings(&self) -> [Finding; 5] {
        [
            self.of_gravity(),
            self.of_errors(),
            self.of_wander(),
            self.of_what_is_left(),
            self.of_swing(),
        ]
    }

    /// Biases that change more than the noise of them allows.
    fn of_wander(&self) -> Finding {
        let BiasWander { gyro, accel } = self.bias_wander;
        let at = |change: &BiasChange| {
            format!(
                "within {:.1} s about {:.1} s into the walk",
                change.within_secs, change.at_secs
            )
        };
        let what = format!(
            "the gyroscope bias changes by {:.3} °/s {}, the accelerometer bias by {:.3} m/s² {}: \
             {:.1} and {:.1} standard deviations of what their noise allows",
            gyro.change.to_degrees().abs(),
            at(&gyro),
            accel.change.abs(),
            at(&accel),
            gyro.sigmas,
            accel.sigmas
        );
        let largest = gyro.sigmas.max(accel.sigmas);
        let limit = Limit::AtMost(PULLED_SIGMAS);
        Finding::new("imu-wander", Verdict::Warn, "IMU", what)
            .judged(largest, "", limit)
            .remedy("let the device warm up and avoid shocks; or increase the bias random walk in the rig file")
    }

    /// What swings in samples and not in images.
    fn of_swing(&self) -> Finding {
        let Some(swing) = self.imu_swing else {
            let what = "the walk is too short, or its frames too irregular, for a spectrum of the differences between images and IMU";
            return Finding::new("imu-swing", Verdict::Unknown, "IMU", what);
        };
        let limit = Limit::AtMost(LARGEST_SWING);
        let does = match swing.what {
            Swinging::Forces { m_s2, path_m } => format!(
                "specific force oscillating by {m_s2:.2} m/s², and position by {:.2} mm",
                1e3 * path_m
            ),
            Swinging::Rates { rad_s, path_rad } => format!(
                "angular rate oscillating by {:.2} °/s, and attitude by {:.3}°",
                rad_s.to_degrees(),
                path_rad.to_degrees()
            ),
        };
        let what = format!(
            "images and IMU differ most at {:.1} Hz, {:.0} times as much as at neighbouring \
             frequencies: {does}; position oscillations below {:.2} mm would not be noticed",
            swing.hz,
            swing.times_usual,
            1e3 * swing.noticed_from_m
        );
        Finding::new("imu-swing", Verdict::Warn, "IMU", what)
            .judged(swing.times_usual, "", limit)
            .remedy("mount the IMU rigidly to the cameras, and enable its anti-aliasing filter against vibration")
    }

    fn of_what_is_left(&self) -> Finding {
        let limit = Limit::AtMost(1.0);
        let what = format!(
            "images and IMU differ by {:.1} standard deviations of its noise (rms); above 1, \
             covariances are computed with the noise increased by that factor",
            self.imu_left_sigmas
        );
        Finding::new("imu-agreement", Verdict::Warn, "IMU", what)
            .judged(self.imu_left_sigmas, "", limit)
            .remedy("check the IMU's noise in the rig file, its axes, its range and its stamps; with a map, also the map's scale")
    }

    /// Nowhere on Earth is gravity more than 0.03 m/s² from the standard: what is more is the accelerometer's scale, by which the path were too
    /// long or too short as well.
    fn of_gravity(&self) -> Finding {
        let standard = standard_gravity_m_s2().norm();
        let share = 100.0 * (self.gravity_m_s2 / standard - 1.0);
        let limit = Limit::AtMost(LARGEST_GRAVITY_PERCENT);
        let what = format!(
            "the accelerometer measures a gravity of {:.3} m/s², {share:+.1} % off the standard value on Earth",
            self.gravity_m_s2
        );
        Finding::new("gravity", Verdict::Warn, "IMU", what)
            .judged(share.abs(), "%", limit)
            .remedy("only most of this error can be removed from the trajectory: calibrate the accelerometer's scale")
    }

    /// Beyond what calibrated parts have, the IMU is not what its recording says.
    fn of_errors(&self) -> Finding {
        let percent = |axes: &[f64; 3]| axes.map(|share| format!("{:+.1}", 1e2 * share)).join(", ");
        let what = format!(
            "scale of the gyroscope {} %, of the accelerometer {} %, shear {} and {} %, the latter \
             rotated by {:.2}° and delayed by {:+.1} ms: the motion is computed with these corrected",
            percent(&self.gyro_scale),
            percent(&self.accel_scale),
            percent(&self.gyro_shear),
            percent(&self.accel_shear),
            nalgebra::Vector3::from(self.accel_turn_deg).norm(),
            1e3 * self.accel_delay_s
        );
        let (verdict, limit, remedy) = match self.imu_error_sigmas {
            usual if usual <= UNLIKELY_SIGMAS => (Verdict::Pass, UNLIKELY_SIGMAS, CALIBRATE_IMU),
            odd if odd <= UNEXPLAINED_SIGMAS => (Verdict::Warn, UNLIKELY_SIGMAS, CALIBRATE_IMU),
            _ => (Verdict::Fail, UNEXPLAINED_SIGMAS, CHECK_DEVICE),
        };
        Finding::new("imu-errors", verdict, "IMU", what)
            .value(self.imu_error_sigmas, "")
            .limit(Limit::AtMost(limit))
            .remedy(remedy)
    }
}

/// Gravity in the accelerometer's own, wrong units, in the middle of all attitudes.
fn felt_gravity_m_s2(solved: &Optimized) -> f64 {
    let gravity = &solved.gravity_m_s2;
    let states = &solved.estimate.states;
    let felt = states.iter().map(|state| {
        let true_m_s2 = state.nav.world_from_rig.rotation.inverse() * gravity;
        let read = true_m_s2.component_div(&solved.imu_errors.accel_scale.map(|s| 1.0 - s));
        read.norm()
    });
    felt.sum::<f64>() / states.len().max(1) as f64
}

impl InertialPriors {
    /// The largest of an IMU's errors in the standard deviations of what is known beforehand.
    pub(super) fn sigmas_of(&self, errors: &ImuErrors) -> f64 {
        [
            errors.gyro_scale.amax() / self.gyro_scale_sigma,
            errors.accel_scale.amax() / self.accel_scale_sigma,
            errors.gyro_shear.amax().max(errors.accel_shear.amax()) / self.shear_sigma,
            errors.accel_turn_rad.amax() / self.accel_turn_sigma_rad,
            errors.accel_delay_s.abs() / self.accel_delay_sigma_s,
        ]
        .into_iter()
        .fold(0.0, f64::max)
    }

    /// What is to be taken for known of IMU and map with such errors instead, where these are unlikely: as large as they are. What was said of it
    /// is not true then, would draw the errors back, bend the walk, and not show in its covariances. `None` where all is likely.
    pub(super) fn allowing(&self, errors: &ImuErrors) -> Option<Self> {
        let of_map = errors.world_scale.abs() / self.map_scale_sigma;
        (self.sigmas_of(errors).max(of_map) > UNLIKELY_SIGMAS).then(|| Self {
            map_scale_sigma: errors.world_scale.abs().max(self.map_scale_sigma),
            gyro_scale_sigma: errors.gyro_scale.amax().max(self.gyro_scale_sigma),
            accel_scale_sigma: errors.accel_scale.amax().max(self.accel_scale_sigma),
            shear_sigma: errors
                .gyro_shear
                .amax()
                .max(errors.accel_shear.amax())
                .max(self.shear_sigma),
            accel_turn_sigma_rad: errors.accel_turn_rad.amax().max(self.accel_turn_sigma_rad),
            accel_delay_sigma_s: errors.accel_delay_s.abs().max(self.accel_delay_sigma_s),
            ..self.clone()
        })
    }
}
