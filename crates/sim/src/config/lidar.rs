//! What can be set about the LiDAR.

use lsfb_drivers::lidar::Returns;
use lsfb_drivers::velodyne::Model;
use lsfb_types::{Bounds, OutOfBounds};
use serde::{Deserialize, Serialize};

/// The sensors that are simulated; the others are played from recordings alone.
pub const SIMULATED_LIDARS: [Model; 2] = [Model::Vlp32c, Model::Vlp16];

/// The LiDAR.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LidarConfig {
    /// Which sensor it is.
    pub model: Model,
    /// Which echoes it sends.
    pub returns: Returns,
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
            model: Model::Vlp32c,
            returns: Returns::default(),
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
        rpm: number(Bounds::MultipleOf(60.0, 300.0, 1200.0)),
        range_noise_m: number(Bounds::NOT_NEGATIVE),
        min_range_m: number(Bounds::NOT_NEGATIVE),
        max_range_m: number(Bounds::POSITIVE),
        grazing_cosine: number(Bounds::Within(0.0, 1.0)),
        dropout: number(Bounds::Within(0.0, 1.0)),
        weakest_reflectance: number(Bounds::NOT_NEGATIVE),
        weakest_range_m: number(Bounds::NOT_NEGATIVE),
    }
    also is_simulated
}

impl LidarConfig {
    fn is_simulated(&self, section: &str) -> Result<(), OutOfBounds> {
        if SIMULATED_LIDARS.contains(&self.model) {
            return Ok(());
        }
        let bounds = SIMULATED_LIDARS.map(Model::key).join(" or ");
        let model = self.model.key();
        Err(OutOfBounds::new(section, "model", &model, &bounds))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_that_is_not_simulated_is_refused_by_name() {
        for model in Model::ALL {
            let text = serde_json::json!({ "model": model.key() });
            let config: LidarConfig = serde_json::from_value(text).expect("the name of a model");
            assert_eq!(config.model, model);
            assert_eq!(
                config.check_bounds("lidar").is_ok(),
                SIMULATED_LIDARS.contains(&model)
            );
        }
        let config = LidarConfig {
            model: Model::Hdl32e,
            ..LidarConfig::default()
        };
        assert_eq!(
            config
                .check_bounds("lidar")
                .expect_err("not simulated")
                .to_string(),
            "setting lidar.model is hdl-32e: it must be vlp-32c or vlp-16"
        );
    }
}
