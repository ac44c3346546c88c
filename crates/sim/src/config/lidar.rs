//! What can be set about the LiDAR.

use lsfb_drivers::velodyne::wire::ReturnMode;
use lsfb_types::{Bounds, OutOfBounds};
use serde::{Deserialize, Serialize};

/// Model of the LiDAR.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum LidarModel {
    /// Velodyne VLP-32C (Ultra Puck).
    #[default]
    #[serde(rename = "vlp-32c")]
    Vlp32c,
    /// Velodyne VLP-16 (Puck).
    #[serde(rename = "vlp-16")]
    Vlp16,
}

impl LidarModel {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Vlp32c, Self::Vlp16];

    /// Its name in settings.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Vlp32c => "vlp-32c",
            Self::Vlp16 => "vlp-16",
        }
    }
}

/// The LiDAR.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LidarConfig {
    /// Which sensor it is.
    pub model: LidarModel,
    /// Which echoes it sends.
    pub returns: ReturnMode,
    /// Width and height of the beam, radians: what lies inside answers together. 0 is a line.
    pub divergence_rad: [f64; 2],
    /// Surfaces in one beam that are nearer to each other than this give one echo, between them, metres.
    pub separation_m: f64,
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
    /// Reflectance that is just seen, met head-on, at `weakest_range_m`.
    pub weakest_reflectance: f64,
    /// Distance at which `weakest_reflectance` is just seen, metres.
    pub weakest_range_m: f64,
}

impl Default for LidarConfig {
    fn default() -> Self {
        Self {
            model: LidarModel::default(),
            returns: ReturnMode::default(),
            divergence_rad: [0.0; 2],
            // VLP-32C 63-9325 p. 33.
            separation_m: 1.0,
            rpm: 600,
            range_noise_m: 0.03,
            min_range_m: 0.5,
            max_range_m: 200.0,
            grazing_cosine: 0.12,
            dropout: 0.002,
            weakest_reflectance: 0.1,
            weakest_range_m: 100.0,
        }
    }
}

lsfb_types::bounds! {
    LidarConfig {
        model: any,
        returns: any,
        divergence_rad: each(Bounds::Within(0.0, 0.02)),
        separation_m: number(Bounds::NOT_NEGATIVE),
        rpm: number(Bounds::Within(300.0, 1200.0)),
        range_noise_m: number(Bounds::NOT_NEGATIVE),
        min_range_m: number(Bounds::NOT_NEGATIVE),
        max_range_m: number(Bounds::POSITIVE),
        grazing_cosine: number(Bounds::Within(0.0, 1.0)),
        dropout: number(Bounds::Within(0.0, 1.0)),
        weakest_reflectance: number(Bounds::NOT_NEGATIVE),
        weakest_range_m: number(Bounds::NOT_NEGATIVE),
    }
}

impl LidarConfig {
    pub(super) fn check(&self, section: &str) -> Result<(), OutOfBounds> {
        if self.rpm.is_multiple_of(60) {
            return Ok(());
        }
        let bounds = "a multiple of 60";
        Err(OutOfBounds::new(section, "rpm", &self.rpm, &bounds))
    }
}
