//! An IMU whose frame is the rig frame: white noise and random-walk biases on top of the exact motion.

use nalgebra::Vector3;

use lsfb_types::ImuSample;

use crate::config::ImuConfig;
use crate::noise::{next_gaussian, stream};
use crate::walk::{Motion, Walk};

/// Magnitude of gravity in the world, m/s²; it points along −z.
pub const GRAVITY_M_S2: f64 = 9.81;

/// One sample with the biases it contains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BiasedSample {
    /// Nanoseconds after the start of the walk.
    pub offset_ns: i64,
    /// What the IMU says.
    pub sample: ImuSample,
    /// Bias of the gyroscope, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
    /// Bias of the accelerometer, m/s².
    pub accel_bias_m_s2: [f64; 3],
}

/// Angular velocity and specific force of a motion, without error.
pub fn exact_sample(motion: &Motion) -> ImuSample {
    let gravity = Vector3::new(0.0, 0.0, -GRAVITY_M_S2);
    let force = motion.world_from_rig.rotation.inverse() * (motion.acceleration_m_s2 - gravity);
    ImuSample {
        angular_velocity_rad_s: motion.angular_velocity_rad_s.into(),
        specific_force_m_s2: force.into(),
    }
}

/// All samples of a walk, from its start to its end.
pub fn simulate(walk: &Walk, config: &ImuConfig, seed: u64) -> Vec<BiasedSample> {
    let rng = stream(seed, "imu", 0);
    let draw =
        |sigma: f64| -> Vector3<f64> { Vector3::from_fn(|_, _| sigma * next_gaussian(&rng)) };
    let rate = f64::from(config.rate_hz);
    let step_ns = 1_000_000_000 / i64::from(config.rate_hz);
    let mut gyro_bias = draw(config.gyro_bias);
    let mut accel_bias = draw(config.accel_bias);
    (0..=(walk.duration_s() * rate) as i64)
        .map(|k| {
            let offset_ns = k * step_ns;
            let exact = exact_sample(&walk.at(offset_ns as f64 * 1e-9));
            // White noise of density n sampled at rate f has deviation n √f; a walk of density b grows by b/√f.
            let gyro = Vector3::from(exact.angular_velocity_rad_s)
                + gyro_bias
                + draw(config.gyro_noise_density * rate.sqrt());
            let accel = Vector3::from(exact.specific_force_m_s2)
                + accel_bias
                + draw(config.accel_noise_density * rate.sqrt());
            let sample = BiasedSample {
                offset_ns,
                sample: ImuSample {
                    angular_velocity_rad_s: gyro.into(),
                    specific_force_m_s2: accel.into(),
                },
                gyro_bias_rad_s: gyro_bias.into(),
                accel_bias_m_s2: accel_bias.into(),
            };
            gyro_bias += draw(config.gyro_bias_walk / rate.sqrt());
            accel_bias += draw(config.accel_bias_walk / rate.sqrt());
            sample
        })
        .collect()
}

#[cfg(test)]
mod tests;
