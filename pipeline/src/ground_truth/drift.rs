//! How far the IMU may have led astray since the last localized pose that was accepted.

use lsfb_geometry::{Matrix6, Vector6};

use super::GroundTruthConfig;
use super::dead_reckoning::DeadReckoning;
use super::inertial::{ANY_ACCELERATION_M_S2, ANY_TURN_RAD_S};
use super::walk::{Frame, Walk};
use lsfb_perception::imu::standard_gravity_m_s2;

/// Accepted poses up to this long before the last one say how well velocity and biases are known there, seconds.
const MEMORY_SECS: f64 = 10.0;
/// They do so across pauses up to this long, seconds.
const PAUSE_SECS: f64 = 1.0;
/// Velocity of which nothing is known, m/s: nobody who carries a device is much faster.
const ANY_VELOCITY_M_S: f64 = 2.0;

/// Covariance of the pose of each frame by which it is more uncertain than accepted localized poses are: that of the nearer of
/// its accepted neighbours, carried on by the IMU. Zero for accepted frames.
///
/// A line through `n` poses of standard deviation `σ` over a time `T` knows its slope to `σ √(12/n) / T`, a parabola its
/// second derivative to `σ √(720/n) / T²`: so well are velocity, and the biases of gyroscope and accelerometer, known at the end of a
/// run of accepted poses, or as well as beforehand.
pub(super) fn drifts(
    walk: &Walk,
    imu: &DeadReckoning,
    accepted: &[bool],
    config: &GroundTruthConfig,
) -> Vec<Matrix6<f64>> {
    let mut drifts = vec![Matrix6::zeros(); walk.frames.len()];
    let mut smallest = vec![f64::INFINITY; walk.frames.len()];
    let count = walk.frames.len();
    for backwards in [false, true] {
        let at = |step: usize| if backwards { count - 1 - step } else { step };
        let mut run: Vec<usize> = Vec::new();
        let mut unmeasured_secs = 0.0;
        for step in 0..count {
            let k = at(step);
            let apart = |a: usize| apart_secs(&walk.frames[a], &walk.frames[k]);
            if step > 0 && !imu.is_measured(k.min(at(step - 1))) {
                unmeasured_secs += apart(at(step - 1));
            }
            if accepted[k] {
                if run.last().is_some_and(|last| apart(*last) > PAUSE_SECS) {
                    run.clear();
                }
                run.push(k);
                run.retain(|member| apart(*member) <= MEMORY_SECS);
                unmeasured_secs = 0.0;
                smallest[k] = 0.0;
                drifts[k] = Matrix6::zeros();
            } else if let (Some(first), Some(last)) = (run.first(), run.last()) {
                let spanned_secs = apart_secs(&walk.frames[*first], &walk.frames[*last]);
                let known = Known::from_run(run.len() as f64, spanned_secs, config);
                let (rotation_rad, position_m) = known.after(apart(*last), unmeasured_secs);
                if position_m < smallest[k] {
                    smallest[k] = position_m;
                    let (r, t) = (rotation_rad.powi(2), position_m.powi(2));
                    drifts[k] = Matrix6::from_diagonal(&Vector6::new(r, r, r, t, t, t));
                }
            }
        }
    }
    drifts
}

fn apart_secs(a: &Frame, b: &Frame) -> f64 {
    a.time.secs_since(b.time).abs()
}

/// Standard deviations of a state at the end of a run of accepted poses.
struct Known {
    tilt_rad: f64,
    velocity_m_s: f64,
    acceleration_m_s2: f64,
    gyro_bias_rad_s: f64,
}

impl Known {
    fn from_run(count: f64, spanned_secs: f64, config: &GroundTruthConfig) -> Self {
        let (sigma_m, sigma_rad) = (config.localization_sigma_m, config.localization_sigma_rad);
        let slope = (12.0 / count).sqrt() / spanned_secs;
        let curvature = (720.0 / count).sqrt() / spanned_secs.powi(2);
        let tilt_rad = sigma_rad / count.sqrt();
        let bias = config.accel_bias_sigma_m_s2.min(sigma_m * curvature);
        Self {
            tilt_rad,
            velocity_m_s: ANY_VELOCITY_M_S.min(sigma_m * slope),
            acceleration_m_s2: bias.hypot(standard_gravity_m_s2().norm() * tilt_rad),
            gyro_bias_rad_s: config.gyro_bias_sigma_rad_s.min(sigma_rad * slope),
        }
    }

    /// Standard deviations of rotation, radians, and position, metres, after a time of which the IMU left some unmeasured.
    fn after(&self, secs: f64, unmeasured_secs: f64) -> (f64, f64) {
        let turned = (self.gyro_bias_rad_s * secs).hypot(ANY_TURN_RAD_S * unmeasured_secs);
        let by_velocity = self.velocity_m_s * secs;
        let by_acceleration = 0.5 * self.acceleration_m_s2 * secs * secs;
        // Gravity, mistaken for acceleration by a rotation that drifts.
        let by_turn = standard_gravity_m_s2().norm() * self.gyro_bias_rad_s * secs.powi(3) / 6.0;
        let unmeasured = ANY_ACCELERATION_M_S2 * unmeasured_secs * secs;
        let position_m = by_velocity
            .hypot(by_acceleration)
            .hypot(by_turn)
            .hypot(unmeasured);
        (self.tilt_rad.hypot(turned), position_m)
    }
}
