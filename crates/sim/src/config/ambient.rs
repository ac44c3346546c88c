//! What can be set about radio, the magnetic field, pressure and satellites.

use lsfb_types::{Bounds, OutOfBounds};
use serde::{Deserialize, Serialize};

/// Exponent of a path loss.
const PATH_LOSS: Bounds = Bounds::Within(1.0, 6.0);
/// Power of the direct wave over that of all echoes.
const RICE_DB: Bounds = Bounds::Within(-40.0, 60.0);
/// The weakest that is received.
const FLOOR_DBM: Bounds = Bounds::Within(-200.0, 0.0);
/// Standard deviations and sizes, whatever their unit.
const SIGMA: Bounds = Bounds::Within(0.0, 1e4);
/// How long something lasts, seconds.
const LASTING_S: Bounds = Bounds::Within(0.1, 1e5);

/// Wi-Fi, as an Android app gets it: lists of networks, a few times a minute.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WifiConfig {
    /// The app asks for a scan this often, seconds; 0 never asks.
    pub request_every_s: f64,
    /// Scans that the system allows in `throttle_s`; it refuses the others.
    pub throttle_scans: u32,
    /// Seconds in which no more than `throttle_scans` are allowed.
    pub throttle_s: f64,
    /// Exponent of the path loss in free air.
    pub path_loss_exponent: f64,
    /// Standard deviation of what no wall accounts for, decibel; it changes over metres.
    pub shadowing_db: f64,
    /// Distance over which that changes, metres.
    pub shadowing_m: f64,
    /// Power of the direct wave over that of all echoes, decibel; how much readings at one spot differ.
    pub rice_factor_db: f64,
    /// Loss through the body of who carries the device, decibel, when it is in the way.
    pub body_loss_db: f64,
    /// Half of the beacons this weak are missed, dBm.
    pub floor_dbm: f64,
}

/// Bluetooth beacons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BleConfig {
    /// Reports of each beacon per second; 0 does not listen.
    pub report_hz: f64,
    /// Exponent of the path loss in free air.
    pub path_loss_exponent: f64,
    /// Standard deviation of what no wall accounts for, decibel; it changes over metres.
    pub shadowing_db: f64,
    /// Distance over which that changes, metres.
    pub shadowing_m: f64,
    /// Power of the direct wave over that of all echoes, decibel. Beacons are narrow in frequency: echoes weigh more.
    pub rice_factor_db: f64,
    /// Loss through the body of who carries the device, decibel, when it is in the way.
    pub body_loss_db: f64,
    /// Half of the advertisements this weak are missed, dBm.
    pub floor_dbm: f64,
}

/// The magnetometer and the steel around it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MagneticConfig {
    /// Samples per second; 0 for none.
    pub rate_hz: u32,
    /// Magnetised pieces of steel per square metre of the place.
    pub pieces_per_m2: f64,
    /// Median magnetic moment of a piece, A m².
    pub moment_a_m2: f64,
    /// Standard deviation of each axis of the field of the device's own magnets, tesla.
    pub hard_iron_t: f64,
    /// Standard deviation of what the device's soft iron adds to each element of the identity.
    pub soft_iron: f64,
    /// White noise of a sample, tesla.
    pub noise_t: f64,
    /// Step of the digits, tesla.
    pub step_t: f64,
}

/// The barometer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BarometerConfig {
    /// Samples per second; 0 for none.
    pub rate_hz: u32,
    /// Standard deviation of the sensor's offset, pascal.
    pub offset_pa: f64,
    /// White noise of a sample, pascal.
    pub noise_pa: f64,
    /// How the weather changes the pressure, pascal per square root of an hour.
    pub weather_pa: f64,
}

/// Where the LiDAR's pulse per second comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PulseSource {
    /// A board with a good quartz, which goes on where no satellite is seen.
    #[default]
    SyncBoard,
    /// The receiver itself: pulse and time end with the fix.
    Receiver,
}

/// What a receiver tells the LiDAR.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NmeaSentence {
    /// GPRMC: time, date and position.
    #[default]
    Rmc,
    /// GPGGA: time and position.
    Gga,
}

/// Satellite receivers, of the phone and of the backpack.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GnssConfig {
    /// Positions per second of the phone: 1 or 0.
    pub rate_hz: u32,
    /// Satellites lower than this are not used, degrees.
    pub mask_deg: f64,
    /// Standard deviation of what atmosphere and orbits leave of the error of a range overhead, metres; it lasts.
    pub atmosphere_m: f64,
    /// How long that lasts, seconds.
    pub atmosphere_s: f64,
    /// White noise of a range, metres.
    pub noise_m: f64,
    /// Standard deviation of the error by echoes close to a façade, metres.
    pub multipath_m: f64,
    /// How long that lasts, seconds.
    pub multipath_s: f64,
    /// Where the LiDAR's pulse per second comes from.
    pub pulse: PulseSource,
    /// What the LiDAR is told with it.
    pub sentence: NmeaSentence,
}

impl Default for WifiConfig {
    fn default() -> Self {
        Self {
            request_every_s: 10.0,
            throttle_scans: 4,
            throttle_s: 120.0,
            path_loss_exponent: 2.0,
            shadowing_db: 3.0,
            shadowing_m: 3.0,
            rice_factor_db: 8.0,
            body_loss_db: 5.0,
            floor_dbm: -92.0,
        }
    }
}

impl Default for BleConfig {
    fn default() -> Self {
        Self {
            report_hz: 1.0,
            path_loss_exponent: 2.0,
            shadowing_db: 3.0,
            shadowing_m: 2.0,
            rice_factor_db: 4.0,
            body_loss_db: 7.0,
            floor_dbm: -97.0,
        }
    }
}

impl Default for MagneticConfig {
    /// An AK09918 in a phone.
    fn default() -> Self {
        Self {
            rate_hz: 100,
            pieces_per_m2: 0.5,
            moment_a_m2: 40.0,
            hard_iron_t: 15e-6,
            soft_iron: 0.03,
            noise_t: 0.3e-6,
            step_t: 0.15e-6,
        }
    }
}

impl Default for BarometerConfig {
    /// A BMP390 in a phone.
    fn default() -> Self {
        Self {
            rate_hz: 20,
            offset_pa: 50.0,
            noise_pa: 2.0,
            weather_pa: 15.0,
        }
    }
}

impl Default for GnssConfig {
    fn default() -> Self {
        Self {
            rate_hz: 1,
            mask_deg: 10.0,
            atmosphere_m: 0.9,
            atmosphere_s: 400.0,
            noise_m: 0.4,
            multipath_m: 4.0,
            multipath_s: 8.0,
            pulse: PulseSource::default(),
            sentence: NmeaSentence::default(),
        }
    }
}

lsfb_types::bounds! {
    WifiConfig {
        request_every_s: number(Bounds::ZeroOr(1.0, 86_400.0)),
        throttle_scans: any,
        throttle_s: number(Bounds::Within(0.0, 86_400.0)),
        path_loss_exponent: number(PATH_LOSS),
        shadowing_db: number(SIGMA),
        shadowing_m: number(Bounds::Within(0.1, 1000.0)),
        rice_factor_db: number(RICE_DB),
        body_loss_db: number(SIGMA),
        floor_dbm: number(FLOOR_DBM),
    }
}

lsfb_types::bounds! {
    BleConfig {
        report_hz: number(Bounds::ZeroOr(0.01, 10.0)),
        path_loss_exponent: number(PATH_LOSS),
        shadowing_db: number(SIGMA),
        shadowing_m: number(Bounds::Within(0.1, 1000.0)),
        rice_factor_db: number(RICE_DB),
        body_loss_db: number(SIGMA),
        floor_dbm: number(FLOOR_DBM),
    }
}

lsfb_types::bounds! {
    MagneticConfig {
        rate_hz: number(Bounds::Within(0.0, 1000.0)),
        pieces_per_m2: number(Bounds::Within(0.0, 10.0)),
        moment_a_m2: number(SIGMA),
        hard_iron_t: number(SIGMA),
        soft_iron: number(SIGMA),
        noise_t: number(SIGMA),
        step_t: number(SIGMA),
    }
}

lsfb_types::bounds! {
    BarometerConfig {
        rate_hz: number(Bounds::Within(0.0, 1000.0)),
        offset_pa: number(SIGMA),
        noise_pa: number(SIGMA),
        weather_pa: number(SIGMA),
    }
}

lsfb_types::bounds! {
    GnssConfig {
        rate_hz: number(Bounds::Within(0.0, 1.0)),
        mask_deg: number(Bounds::Within(0.0, 60.0)),
        atmosphere_m: number(SIGMA),
        atmosphere_s: number(LASTING_S),
        noise_m: number(SIGMA),
        multipath_m: number(SIGMA),
        multipath_s: number(LASTING_S),
        pulse: any,
        sentence: any,
    }
    also has_noise
}

impl GnssConfig {
    fn has_noise(&self, section: &str) -> Result<(), OutOfBounds> {
        if self.atmosphere_m + self.noise_m > 0.0 {
            return Ok(());
        }
        let bounds = "more than 0 where atmosphere_m is 0: every receiver has noise";
        Err(OutOfBounds::new(section, "noise_m", &self.noise_m, &bounds))
    }
}
