//! What can be set about an IMU.

use lsfb_drivers::ImuFamily;
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

/// What the backpack's inertial unit speaks: the families that are simulated, the others are played from recordings alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SimulatedImu {
    /// Xsens MTData2, with UTC.
    #[default]
    Xsens,
    /// MicroStrain MIP, with the time since power-up.
    Microstrain,
}

impl SimulatedImu {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Xsens, Self::Microstrain];

    /// The family, as drivers know it.
    pub const fn family(self) -> ImuFamily {
        match self {
            Self::Xsens => ImuFamily::Xsens,
            Self::Microstrain => ImuFamily::Microstrain,
        }
    }
}

/// An IMU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuConfig {
    /// Samples per second; must divide a second into whole microseconds.
    pub rate_hz: u32,
    /// Gyroscope white noise, rad/s/√Hz.
    pub gyro_noise_density: f64,
    /// Accelerometer white noise, m/s²/√Hz.
    pub accel_noise_density: f64,
    /// Gyroscope bias random walk, rad/s²/√Hz.
    pub gyro_bias_walk: f64,
    /// Accelerometer bias random walk, m/s³/√Hz.
    pub accel_bias_walk: f64,
    /// Standard deviation of each axis of the gyroscope bias at the start, rad/s.
    pub gyro_bias: f64,
    /// Standard deviation of each axis of the accelerometer bias at the start, m/s².
    pub accel_bias: f64,
    /// Bias instability of the gyroscope (1/f noise), rad/s.
    pub gyro_bias_instability: f64,
    /// Bias instability of the accelerometer, m/s².
    pub accel_bias_instability: f64,
    /// Standard deviation of the scale error of each axis.
    pub scale_error: f64,
    /// Standard deviation of each angle by which an axis leans towards another, radians.
    pub misalignment_rad: f64,
    /// Largest angular velocity that is measured, rad/s.
    pub gyro_range_rad_s: f64,
    /// Largest specific force that is measured, m/s².
    pub accel_range_m_s2: f64,
}

impl Default for ImuConfig {
    /// An Xsens MTi-30: datasheet densities, bias walks as commonly fitted.
    fn default() -> Self {
        Self {
            rate_hz: 200,
            gyro_noise_density: 5.2e-4,
            accel_noise_density: 5.9e-4,
            gyro_bias_walk: 2e-5,
            accel_bias_walk: 2e-4,
            gyro_bias: 0.003,
            accel_bias: 0.03,
            gyro_bias_instability: 0.0,
            accel_bias_instability: 0.0,
            scale_error: 0.0,
            misalignment_rad: 0.0,
            // 2000 °/s and 16 g.
            gyro_range_rad_s: 34.9,
            accel_range_m_s2: 156.9,
        }
    }
}

lsfb_types::bounds! {
    ImuConfig {
        rate_hz: number(Bounds::DivisorOf(1e6)),
        gyro_noise_density: number(Bounds::NOT_NEGATIVE),
        accel_noise_density: number(Bounds::NOT_NEGATIVE),
        gyro_bias_walk: number(Bounds::NOT_NEGATIVE),
        accel_bias_walk: number(Bounds::NOT_NEGATIVE),
        gyro_bias: number(Bounds::NOT_NEGATIVE),
        accel_bias: number(Bounds::NOT_NEGATIVE),
        gyro_bias_instability: number(Bounds::NOT_NEGATIVE),
        accel_bias_instability: number(Bounds::NOT_NEGATIVE),
        scale_error: number(Bounds::NOT_NEGATIVE),
        misalignment_rad: number(Bounds::NOT_NEGATIVE),
        gyro_range_rad_s: number(Bounds::POSITIVE),
        accel_range_m_s2: number(Bounds::POSITIVE),
    }
}
