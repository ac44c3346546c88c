//! What can be set. `Default` is the demo.

use serde::{Deserialize, Serialize};

use crate::Error;

/// A whole simulated session: a scan with the backpack and a walk with the glasses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimConfig {
    /// Seed of everything random: the building, the walks, the noise.
    pub seed: u64,
    /// Edge of the texels that surfaces are painted with, metres.
    pub texel_m: f32,
    /// The walk with the backpack.
    pub scan: WalkConfig,
    /// The walk with the glasses.
    pub glasses: WalkConfig,
    /// All cameras of the backpack.
    pub scan_cameras: CameraConfig,
    /// Both cameras of the glasses.
    pub glasses_cameras: CameraConfig,
    /// The LiDAR.
    pub lidar: LidarConfig,
    /// The IMU of the backpack.
    pub scan_imu: ImuConfig,
    /// The IMU of the glasses.
    pub glasses_imu: ImuConfig,
}

/// One walk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WalkConfig {
    /// Length of the recording, seconds.
    pub duration_s: f64,
    /// Standing still at the start, seconds.
    pub rest_s: f64,
    /// Standing still at the end, seconds.
    pub final_rest_s: f64,
    /// Speed on the straight, m/s.
    pub speed_m_s: f64,
    /// How fast one turns at most while walking round a bend, rad/s.
    pub turn_rate_rad_s: f64,
    /// Height of the rig above the floor, metres.
    pub height_m: f64,
}

/// Cameras of one rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraConfig {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Focal length as a share of the width: 0.547 gives 350 px at 640.
    pub focal_per_width: f64,
    /// Images per second; must divide a second into whole microseconds.
    pub rate_hz: u32,
    /// Exposure time, nanoseconds. Images are sharp: it moves no pixel, it only is what the device reports.
    pub exposure_ns: u32,
    /// Noise of a black pixel, grey levels.
    pub read_noise: f32,
    /// Growth of the variance with the brightness (shot noise), grey levels.
    pub shot_noise: f32,
    /// Loss of brightness at 45° off the axis, 0–1.
    pub vignetting: f32,
}

/// The LiDAR.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LidarConfig {
    /// Revolutions per minute, a multiple of 60.
    pub rpm: u32,
    /// Standard deviation of a range, metres.
    pub range_noise_m: f64,
    /// Ranges below this give no return, metres.
    pub min_range_m: f64,
    /// Ranges beyond this give no return, metres.
    pub max_range_m: f64,
    /// Cosine of the incidence below which returns begin to be lost; none comes back at zero.
    pub grazing_cosine: f64,
    /// Share of returns lost for no reason, 0–1.
    pub dropout: f64,
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
}

impl Default for SimConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            texel_m: 0.003,
            scan: WalkConfig::default(),
            glasses: WalkConfig {
                duration_s: 24.0,
                height_m: 1.62,
                ..WalkConfig::default()
            },
            scan_cameras: CameraConfig::default(),
            glasses_cameras: CameraConfig {
                // 126° over the width.
                focal_per_width: 0.4547,
                ..CameraConfig::default()
            },
            lidar: LidarConfig::default(),
            scan_imu: ImuConfig::default(),
            glasses_imu: ImuConfig {
                gyro_noise_density: 3.0 * 5.2e-4,
                accel_noise_density: 3.0 * 5.9e-4,
                gyro_bias_walk: 3.0 * 2e-5,
                accel_bias_walk: 3.0 * 2e-4,
                gyro_bias: 0.006,
                accel_bias: 0.06,
                ..ImuConfig::default()
            },
        }
    }
}

impl Default for WalkConfig {
    fn default() -> Self {
        Self {
            duration_s: 36.0,
            rest_s: 1.5,
            final_rest_s: 0.5,
            speed_m_s: 0.85,
            turn_rate_rad_s: 0.9,
            height_m: 1.25,
        }
    }
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            width: 640,
            height: 400,
            focal_per_width: 0.547,
            rate_hz: 10,
            exposure_ns: 4_000_000,
            read_noise: 1.0,
            shot_noise: 0.012,
            vignetting: 0.25,
        }
    }
}

impl Default for LidarConfig {
    fn default() -> Self {
        Self {
            rpm: 600,
            range_noise_m: 0.03,
            min_range_m: 0.5,
            max_range_m: 200.0,
            grazing_cosine: 0.12,
            dropout: 0.002,
        }
    }
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
        }
    }
}

impl SimConfig {
    /// Small and short, for tests: coarse surfaces, low resolution, five seconds each.
    pub fn tiny() -> Self {
        let mut config = Self {
            texel_m: 0.012,
            ..Self::default()
        };
        for walk in [&mut config.scan, &mut config.glasses] {
            walk.duration_s = 5.0;
            walk.rest_s = 0.5;
        }
        for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
            cameras.width = 160;
            cameras.height = 100;
        }
        config
    }

    /// Refuses what cannot be simulated.
    pub fn check(&self) -> Result<(), Error> {
        let require = |field, got: &dyn std::fmt::Display, expected, holds: bool| {
            if holds {
                Ok(())
            } else {
                Err(Error::Config {
                    field,
                    got: got.to_string(),
                    expected,
                })
            }
        };
        let texel = self.texel_m;
        require(
            "texel_m",
            &texel,
            "0.001 to 0.1",
            (0.001..=0.1).contains(&texel),
        )?;
        for walk in [&self.scan, &self.glasses] {
            let (d, rest) = (walk.duration_s, walk.rest_s + walk.final_rest_s);
            require("duration_s", &d, "0.1 to 3600", (0.1..=3600.0).contains(&d))?;
            require(
                "rest_s",
                &rest,
                "not negative",
                walk.rest_s >= 0.0 && walk.final_rest_s >= 0.0,
            )?;
            require(
                "speed_m_s",
                &walk.speed_m_s,
                "0.1 to 3",
                (0.1..=3.0).contains(&walk.speed_m_s),
            )?;
            let turn = walk.turn_rate_rad_s;
            require(
                "turn_rate_rad_s",
                &turn,
                "0.1 to 6",
                (0.1..=6.0).contains(&turn),
            )?;
            require(
                "height_m",
                &walk.height_m,
                "0.3 to 2",
                (0.3..=2.0).contains(&walk.height_m),
            )?;
        }
        for cameras in [&self.scan_cameras, &self.glasses_cameras] {
            let even = cameras.width % 8 == 0 && (16..=4096).contains(&cameras.width);
            require(
                "width",
                &cameras.width,
                "a multiple of 8 from 16 to 4096",
                even,
            )?;
            let tall = (8..=4096).contains(&cameras.height);
            require("height", &cameras.height, "8 to 4096", tall)?;
            let focal = cameras.focal_per_width;
            require(
                "focal_per_width",
                &focal,
                "0.3 to 5",
                (0.3..=5.0).contains(&focal),
            )?;
            rate(cameras.rate_hz)?;
        }
        for imu in [&self.scan_imu, &self.glasses_imu] {
            rate(imu.rate_hz)?;
        }
        let rpm = self.lidar.rpm;
        let whole = rpm.is_multiple_of(60) && (300..=1200).contains(&rpm);
        require("rpm", &rpm, "a multiple of 60 from 300 to 1200", whole)
    }
}

fn rate(rate_hz: u32) -> Result<(), Error> {
    if rate_hz > 0 && 1_000_000 % rate_hz == 0 {
        return Ok(());
    }
    Err(Error::Config {
        field: "rate_hz",
        got: rate_hz.to_string(),
        expected: "a divisor of 1000000",
    })
}
