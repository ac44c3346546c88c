//! An IMU whose frame is the rig frame: white noise, biases that walk and flicker, axes that are not quite at right
//! angles and not quite to scale, and an end to its range, on top of the exact motion.

use nalgebra::{Matrix3, Vector3};

use lsfb_geometry::Se3;
use lsfb_types::ImuSample;

use crate::config::ImuConfig;
use crate::noise::{Dice, next_gaussian, stream};
use crate::walk::{Motion, Walk};

/// Magnitude of gravity in the world, m/s²; it points along −z. The standard value, that of the drivers.
pub const GRAVITY_M_S2: f64 = lsfb_drivers::mynt_s::model::STANDARD_GRAVITY_M_S2;

/// Correlation times of the parts of a flickering bias, seconds: one per decade makes its Allan deviation flat.
const FLICKER_S: [f64; 4] = [1.0, 10.0, 100.0, 1000.0];
/// Deviation of each part for a bias instability of 1, by IEEE 952: the flat of the Allan deviation is 0.664 of it, and
/// parts a decade apart have a flat of 0.77 of theirs.
const FLICKER_SHARE: f64 = 0.664 / 0.77;

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

/// What is wrong with the axes of one triad: `measured = matrix * true`.
pub fn axes(scale_error: f64, misalignment_rad: f64, seed: u64, triad: u64) -> Matrix3<f64> {
    let rng = stream(seed, "imu axes", triad);
    Matrix3::from_fn(|row, column| match row == column {
        true => 1.0 + scale_error * next_gaussian(&rng),
        false => misalignment_rad * next_gaussian(&rng),
    })
}

/// A bias that flickers, axis by axis.
struct Flicker {
    parts: [Vector3<f64>; FLICKER_S.len()],
    sigma: f64,
    keep: [f64; FLICKER_S.len()],
    rng: Dice,
}

impl Flicker {
    fn new(instability: f64, rate_hz: f64, rng: Dice) -> Self {
        let sigma = FLICKER_SHARE * instability;
        let parts = std::array::from_fn(|_| sigma * draw(&rng));
        Self {
            parts,
            sigma,
            keep: FLICKER_S.map(|tau| (-1.0 / (rate_hz * tau)).exp()),
            rng,
        }
    }

    fn next(&mut self) -> Vector3<f64> {
        if self.sigma == 0.0 {
            return Vector3::zeros();
        }
        for (part, keep) in self.parts.iter_mut().zip(self.keep) {
            let fresh = self.sigma * (1.0 - keep * keep).sqrt();
            *part = *part * keep + fresh * draw(&self.rng);
        }
        self.parts.iter().sum()
    }
}

fn draw(rng: &Dice) -> Vector3<f64> {
    Vector3::from_fn(|_, _| next_gaussian(rng))
}

/// All samples of a walk, from its start to its end.
pub fn simulate(walk: &Walk, config: &ImuConfig, seed: u64) -> Vec<BiasedSample> {
    measure(walk.duration_s(), |time_s| walk.at(time_s), config, seed)
}

/// Samples of a rig that lies level and still: what an Allan variance is made of.
pub fn at_rest(duration_s: f64, config: &ImuConfig, seed: u64) -> Vec<BiasedSample> {
    let still = Motion {
        world_from_rig: Se3::identity(),
        velocity_m_s: Vector3::zeros(),
        acceleration_m_s2: Vector3::zeros(),
        angular_velocity_rad_s: Vector3::zeros(),
    };
    measure(duration_s, |_| still, config, seed)
}

fn measure(
    duration_s: f64,
    motion_at: impl Fn(f64) -> Motion,
    config: &ImuConfig,
    seed: u64,
) -> Vec<BiasedSample> {
    let rng = stream(seed, "imu", 0);
    let draw = |sigma: f64| sigma * draw(&rng);
    let rate = f64::from(config.rate_hz);
    let step_ns = 1_000_000_000 / i64::from(config.rate_hz);
    let mut gyro_walk = draw(config.gyro_bias);
    let mut accel_walk = draw(config.accel_bias);
    let mut gyro_flicker = Flicker::new(
        config.gyro_bias_instability,
        rate,
        stream(seed, "gyro flicker", 0),
    );
    let mut accel_flicker = Flicker::new(
        config.accel_bias_instability,
        rate,
        stream(seed, "accel flicker", 0),
    );
    let [gyro_axes, accel_axes] =
        [0, 1].map(|triad| axes(config.scale_error, config.misalignment_rad, seed, triad));
    (0..=(duration_s * rate) as i64)
        .map(|k| {
            let offset_ns = k * step_ns;
            let exact = exact_sample(&motion_at(offset_ns as f64 * 1e-9));
            let gyro_bias = gyro_walk + gyro_flicker.next();
            let accel_bias = accel_walk + accel_flicker.next();
            // White noise of density n sampled at rate f has deviation n √f; a walk of density b grows by b/√f.
            let gyro = gyro_axes * Vector3::from(exact.angular_velocity_rad_s)
                + gyro_bias
                + draw(config.gyro_noise_density * rate.sqrt());
            let accel = accel_axes * Vector3::from(exact.specific_force_m_s2)
                + accel_bias
                + draw(config.accel_noise_density * rate.sqrt());
            let within = |v: Vector3<f64>, range: f64| v.map(|x| x.clamp(-range, range));
            let sample = BiasedSample {
                offset_ns,
                sample: ImuSample {
                    angular_velocity_rad_s: within(gyro, config.gyro_range_rad_s).into(),
                    specific_force_m_s2: within(accel, config.accel_range_m_s2).into(),
                },
                gyro_bias_rad_s: gyro_bias.into(),
                accel_bias_m_s2: accel_bias.into(),
            };
            gyro_walk += draw(config.gyro_bias_walk / rate.sqrt());
            accel_walk += draw(config.accel_bias_walk / rate.sqrt());
            sample
        })
        .collect()
}

#[cfg(test)]
mod tests;
