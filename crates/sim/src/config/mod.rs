//! What can be set. `Default` is the demo.

mod imu;
mod lidar;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::ambient::{
    BarometerConfig, BleConfig, DatumConfig, GnssConfig, MagneticConfig, WifiConfig,
};
use crate::place::Place;
use crate::timing::ClocksConfig;
use crate::walk::{Device, PaperMotion};
use crate::{Error, ambient};
pub use imu::{ImuConfig, ImuFamily};
pub use lidar::{LidarConfig, LidarModel, LidarReturns};

/// A whole simulated session: a scan with the backpack and a walk with the glasses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimConfig {
    /// Seed of everything random: the building, the walks, the noise.
    pub seed: u64,
    /// Where it takes place.
    pub place: Place,
    /// Binary glTF file (`.glb`, metres) for the place `imported`.
    pub scene: PathBuf,
    /// Corners of the closed way through an imported scene: x, y and z of the floor, metres, z up. Without, around its
    /// middle.
    pub way_m: Vec<[f64; 3]>,
    /// How often people have moved things about since the place was built; 0 is as built.
    pub months_later: u32,
    /// Whether people walk about.
    pub people: bool,
    /// What the second walk is recorded with.
    pub device: Device,
    /// Sequence of Table VII (`O0` … `S2`) that the second walk follows, which decides its place, length and duration;
    /// empty for a loop through the place.
    pub motion: String,
    /// Edge of the texels that surfaces are painted with, metres.
    pub texel_m: f32,
    /// What the IMU of the backpack speaks.
    pub scan_imu_family: ImuFamily,
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
    /// The clocks of all devices, and the ways to their hosts.
    pub clocks: ClocksConfig,
    /// Where on Earth the place is.
    pub datum: DatumConfig,
    /// Satellite receivers.
    pub gnss: GnssConfig,
    /// Wi-Fi heard by the second walk's device.
    pub wifi: WifiConfig,
    /// Beacons heard by the second walk's device.
    pub ble: BleConfig,
    /// The magnetometer of the second walk's device.
    pub magnetic: MagneticConfig,
    /// The barometer of the second walk's device.
    pub barometer: BarometerConfig,
}

/// One walk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WalkConfig {
    /// Length of the recording, seconds; 0, except in the demo's place, is as long as the route takes.
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
    /// Images per second.
    pub rate_hz: u32,
    /// The lens.
    pub lens: LensKind,
    /// Time from the first row to the last, nanoseconds; 0 is a global shutter.
    pub readout_ns: u32,
    /// Exposure time in nominal light, nanoseconds.
    pub exposure_ns: u32,
    /// Whether motion during the exposure blurs the image. Without, the exposure only is what the device reports.
    pub motion_blur: bool,
    /// Whether exposure time, then gain, follow the light.
    pub auto_exposure: bool,
    /// Longest exposure that the automatic chooses, nanoseconds.
    pub longest_exposure_ns: u32,
    /// Quality 1–100 of JPEG compression that the image has been through; 0 for none.
    pub jpeg_quality: u8,
    /// Noise of a black pixel, grey levels.
    pub read_noise: f32,
    /// Growth of the variance with the brightness (shot noise), grey levels.
    pub shot_noise: f32,
    /// Loss of brightness at 45° off the axis, 0–1.
    pub vignetting: f32,
}

/// Kind of lens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LensKind {
    /// Kannala and Brandt's model, for wide lenses.
    #[default]
    KannalaBrandt,
    /// Pinhole with radial and tangential distortion.
    PinholeRadtan,
}

impl Default for SimConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            place: Place::Demo,
            scene: PathBuf::new(),
            way_m: Vec::new(),
            months_later: 0,
            people: true,
            device: Device::Glasses,
            motion: String::new(),
            texel_m: 0.003,
            scan_imu_family: ImuFamily::default(),
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
            clocks: ClocksConfig::default(),
            datum: DatumConfig::default(),
            gnss: GnssConfig::default(),
            wifi: WifiConfig::default(),
            ble: BleConfig::default(),
            magnetic: MagneticConfig::default(),
            barometer: BarometerConfig::default(),
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
            lens: LensKind::KannalaBrandt,
            readout_ns: 0,
            exposure_ns: 4_000_000,
            motion_blur: false,
            auto_exposure: false,
            longest_exposure_ns: 20_000_000,
            jpeg_quality: 0,
            read_noise: 1.0,
            shot_noise: 0.012,
            vignetting: 0.25,
        }
    }
}

impl SimConfig {
    /// A scan and a walk in a place, with the sensors of Table III: the cameras' full resolution and rate, blur by
    /// exposure, automatic exposure, rolling shutters on phones.
    pub fn for_place(place: Place, device: Device) -> Self {
        let real = CameraConfig {
            motion_blur: true,
            auto_exposure: true,
            read_noise: 1.3,
            shot_noise: 0.02,
            rate_hz: 30,
            ..CameraConfig::default()
        };
        let phone = |focal_per_width: f64, readout_ns: u32| CameraConfig {
            width: 640,
            height: 480,
            focal_per_width,
            lens: LensKind::PinholeRadtan,
            readout_ns,
            exposure_ns: 10_000_000,
            longest_exposure_ns: 33_000_000,
            vignetting: 0.35,
            jpeg_quality: 92,
            ..real.clone()
        };
        let mut config = Self {
            place,
            device,
            texel_m: 0.003,
            scan_cameras: CameraConfig {
                width: 1280,
                height: 800,
                focal_per_width: 0.547,
                rate_hz: 20,
                ..real.clone()
            },
            glasses_cameras: match device {
                // 67°, 68° and 126° over the width.
                Device::Android => phone(0.7555, 24_000_000),
                Device::Iphone => phone(0.7413, 21_000_000),
                Device::Glasses => CameraConfig {
                    focal_per_width: 0.4547,
                    ..real.clone()
                },
            },
            ..Self::default()
        };
        // The spot that the manuals draw, about.
        config.lidar.divergence_rad = [3e-3, 1.5e-3];
        // Factory-calibrated, as phones and glasses are; the datasheet's bias stability for the backpack's.
        config.scan_imu.gyro_bias_instability = 8.7e-5;
        config.scan_imu.accel_bias_instability = 1.5e-4;
        config.glasses_imu.gyro_bias_instability = 1.5e-4;
        config.glasses_imu.accel_bias_instability = 4e-4;
        config.glasses_imu.scale_error = 5e-4;
        config.glasses_imu.misalignment_rad = 5e-4;
        for walk in [&mut config.scan, &mut config.glasses] {
            (walk.duration_s, walk.speed_m_s) = (0.0, 1.0);
        }
        if place == Place::Demo {
            (config.scan.duration_s, config.glasses.duration_s) = (36.0, 24.0);
        }
        if place == Place::Calibration {
            (config.scan.duration_s, config.glasses.duration_s) = (80.0, 60.0);
            config.texel_m = 0.003;
        }
        config
    }

    /// [`SimConfig::for_place`] with the second walk of a sequence of Table VII.
    pub fn for_motion(motion: &PaperMotion, device: Device) -> Self {
        let mut config = Self::for_place(motion.place, device);
        config.motion = motion.name.to_owned();
        config
    }

    /// The sequence of Table VII that the second walk follows.
    pub fn paper_motion(&self) -> Result<Option<&'static PaperMotion>, Error> {
        if self.motion.is_empty() {
            return Ok(None);
        }
        let found = PaperMotion::named(&self.motion).filter(|m| m.place == self.place);
        found.map(Some).ok_or_else(|| Error::Config {
            field: "motion",
            got: self.motion.clone(),
            expected: "a sequence of Table VII that belongs to the place",
        })
    }

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
        self.clocks.check()?;
        ambient::check(self)?;
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
            let route = d == 0.0 && self.place != Place::Demo;
            require(
                "duration_s",
                &d,
                "0.1 to 3600",
                route || (0.1..=3600.0).contains(&d),
            )?;
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
            let frames = cameras.rate_hz;
            require("rate_hz", &frames, "1 to 240", (1..=240).contains(&frames))?;
            let period_ns = 1_000_000_000 / cameras.rate_hz;
            let readout = cameras.readout_ns;
            require(
                "readout_ns",
                &readout,
                "no longer than the period of the images",
                readout <= period_ns,
            )?;
            let exposure = cameras.exposure_ns.max(cameras.longest_exposure_ns);
            require(
                "exposure_ns",
                &exposure,
                "up to 1000000000",
                exposure <= 1_000_000_000,
            )?;
            let quality = cameras.jpeg_quality;
            require("jpeg_quality", &quality, "0 to 100", quality <= 100)?;
        }
        for imu in [&self.scan_imu, &self.glasses_imu] {
            rate(imu.rate_hz)?;
        }
        let [width, height] = self.lidar.divergence_rad;
        let narrow = |angle: f64| (0.0..=0.02).contains(&angle);
        require(
            "divergence_rad",
            &format!("{width}, {height}"),
            "0 to 0.02",
            narrow(width) && narrow(height),
        )?;
        let apart = self.lidar.separation_m;
        require("separation_m", &apart, "not negative", apart >= 0.0)?;
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
