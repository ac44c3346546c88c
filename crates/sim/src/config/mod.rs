//! What can be set. `Default` is the demo.

mod ambient;
mod device;
mod imu;
mod lidar;
mod light;
mod look;
mod place;

use std::path::PathBuf;

use lsfb_types::{Bounds, OutOfBounds};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::datum::DatumConfig;
use crate::timing::ClocksConfig;
pub use ambient::{
    BarometerConfig, BleConfig, GnssConfig, MagneticConfig, NmeaSentence, PulseSource, WifiConfig,
};
pub use device::Device;
pub use imu::{ImuConfig, SimulatedImu};
pub use lidar::{LidarConfig, SIMULATED_LIDARS};
pub use light::LightConfig;
pub use look::Look;
pub use place::Place;

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
    /// By how many floors the second walk is above what the scanner sees, in a building whose floors are built alike: who carries the device
    /// meets transmitters of that floor, and hears the scanner's through the slabs. What stands and hangs there is another's if
    /// `months_later` says so.
    #[serde(skip_serializing_if = "is_zero")]
    pub floors_up: u32,
    /// Whether people walk about.
    pub people: bool,
    /// People besides who always is there, on the place's ways: a crowd has a dozen and more.
    pub crowd: u32,
    /// Whether it is night: few lamps are lit, screens and most windows dark, the sky has no sun.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub night: bool,
    /// Whether a door that otherwise stands open is closed, which one by the seed: one that the scanner's way leads through, where it does. The
    /// second walk stays on one side of it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub fire_door: bool,
    /// What the second walk is recorded with.
    pub device: Device,
    /// Sequence of Table VII (`O0` … `S2`) that the second walk follows, which decides its place, length and duration;
    /// empty for a loop through the place.
    pub motion: String,
    /// How far from the scanner's way the second walk goes at most, where nothing is in the way, metres; 0 takes the place's routes
    /// as they are, which the scanner takes too.
    pub off_path_m: f64,
    /// Edge of the texels that surfaces are painted with, metres.
    pub texel_m: f32,
    /// How surfaces are painted.
    #[serde(skip_serializing_if = "Look::is_plain")]
    pub look: Look,
    /// The light of the place.
    #[serde(skip_serializing_if = "LightConfig::is_off")]
    pub light: LightConfig,
    /// What the IMU of the backpack speaks.
    pub scan_imu_family: SimulatedImu,
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
    /// Length of the recording, seconds; 0, except in the demo's place, is as long as the route or the motion takes.
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

fn is_zero(count: &u32) -> bool {
    *count == 0
}

impl Default for SimConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            place: Place::Demo,
            scene: PathBuf::new(),
            way_m: Vec::new(),
            months_later: 0,
            floors_up: 0,
            people: true,
            crowd: 0,
            night: false,
            fire_door: false,
            device: Device::Glasses,
            motion: String::new(),
            off_path_m: 0.0,
            texel_m: 0.003,
            look: Look::default(),
            light: LightConfig::default(),
            scan_imu_family: SimulatedImu::default(),
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
    /// Whether the world of these settings is that of others: they differ at most in the second walk and in what it is recorded with.
    pub(crate) fn has_world_of(&self, other: &Self) -> bool {
        *self
            == Self {
                floors_up: self.floors_up,
                device: self.device,
                motion: self.motion.clone(),
                off_path_m: self.off_path_m,
                glasses: self.glasses.clone(),
                glasses_cameras: self.glasses_cameras.clone(),
                glasses_imu: self.glasses_imu.clone(),
                ..other.clone()
            }
    }

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
        Ok(self.check_bounds("")?)
    }

    /// What a place has and what it has not.
    fn is_of_its_place(&self, _section: &str) -> Result<(), OutOfBounds> {
        // The demo's place has no route that could say how long a walk takes.
        for (section, walk) in [("scan", &self.scan), ("glasses", &self.glasses)] {
            if self.place == Place::Demo && walk.duration_s == 0.0 {
                let bounds = "0.1 to 3600 in the demo's place";
                let duration_s = &walk.duration_s;
                return Err(OutOfBounds::new(section, "duration_s", duration_s, &bounds));
            }
        }
        if !self.look.is_plain() && self.place == Place::Imported {
            let bounds = "plain in your own scenes, which define their own look";
            return Err(OutOfBounds::new("", "look", &"detailed", &bounds));
        }
        if self.night && !self.place.has_nights() {
            let bounds = "false in the demo, in the calibration place and in your own scenes";
            return Err(OutOfBounds::new("", "night", &true, &bounds));
        }
        if self.fire_door && !self.place.has_fire_doors() {
            let names = Place::ENVIRONMENTS.into_iter();
            let names: Vec<&str> = names
                .filter(|p| p.has_fire_doors())
                .map(Place::name)
                .collect();
            let bounds = format!(
                "false in {}, which has no door that could be closed; places with one: {}",
                self.place.name(),
                names.join(", ")
            );
            return Err(OutOfBounds::new("", "fire_door", &true, &bounds));
        }
        Ok(())
    }
}

lsfb_types::bounds! {
    SimConfig {
        seed: any,
        place: any,
        scene: any,
        way_m: any,
        months_later: any,
        floors_up: number(Bounds::Within(0.0, 100.0)),
        people: any,
        crowd: number(Bounds::Within(0.0, 150.0)),
        night: any,
        fire_door: any,
        device: any,
        motion: any,
        off_path_m: number(Bounds::ZeroOr(0.5, 10.0)),
        texel_m: number(Bounds::Within(0.001, 0.1)),
        look: any,
        light: section,
        scan_imu_family: any,
        scan: section,
        glasses: section,
        scan_cameras: section,
        glasses_cameras: section,
        lidar: section,
        scan_imu: section,
        glasses_imu: section,
        clocks: section,
        datum: section,
        gnss: section,
        wifi: section,
        ble: section,
        magnetic: section,
        barometer: section,
    }
    also is_of_its_place
}

lsfb_types::bounds! {
    WalkConfig {
        duration_s: number(Bounds::ZeroOr(0.1, 3600.0)),
        rest_s: number(Bounds::NOT_NEGATIVE),
        final_rest_s: number(Bounds::NOT_NEGATIVE),
        speed_m_s: number(Bounds::Within(0.1, 3.0)),
        turn_rate_rad_s: number(Bounds::Within(0.1, 6.0)),
        height_m: number(Bounds::Within(0.3, 2.0)),
    }
}

lsfb_types::bounds! {
    CameraConfig {
        width: number(Bounds::MultipleOf(8.0, 16.0, 4096.0)),
        height: number(Bounds::Within(8.0, 4096.0)),
        focal_per_width: number(Bounds::Within(0.3, 5.0)),
        rate_hz: number(Bounds::Within(1.0, 240.0)),
        lens: any,
        readout_ns: any,
        exposure_ns: number(Bounds::Within(0.0, 1e9)),
        motion_blur: any,
        auto_exposure: any,
        longest_exposure_ns: number(Bounds::Within(0.0, 1e9)),
        jpeg_quality: number(Bounds::Within(0.0, 100.0)),
        read_noise: number(Bounds::NOT_NEGATIVE),
        shot_noise: number(Bounds::NOT_NEGATIVE),
        vignetting: number(Bounds::Within(0.0, 1.0)),
    }
    also is_read_in_time
}

impl CameraConfig {
    fn is_read_in_time(&self, section: &str) -> Result<(), OutOfBounds> {
        let readout_ns = &self.readout_ns;
        if *readout_ns <= 1_000_000_000 / self.rate_hz {
            return Ok(());
        }
        let bounds = "no longer than the period of the images";
        Err(OutOfBounds::new(section, "readout_ns", readout_ns, &bounds))
    }
}
