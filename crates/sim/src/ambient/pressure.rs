//! The barometer: height, weather, and a sensor's offset.

use lsfb_recording::message::PressureSample;

use super::message::{AmbientMessage, AmbientSample};
use crate::config::BarometerConfig;
use crate::datum::DatumConfig;
use crate::noise::{next_gaussian, stream};
use crate::walk::Walk;

/// From one floor of a building to the next, metres.
const STOREY_M: f64 = 3.5;

/// Pressure of the standard atmosphere at a height above the sea, pascal (ISO 2533, troposphere).
pub(super) fn standard_pressure_pa(height_m: f64) -> f64 {
    101_325.0 * (1.0 - 2.255_77e-5 * height_m).powf(5.255_88)
}

/// All samples of a walk so many floors above its place.
pub(super) fn samples(
    config: &BarometerConfig,
    datum: &DatumConfig,
    walk: &Walk,
    floors_up: u32,
    seed: u64,
) -> Vec<AmbientMessage> {
    let dice = stream(seed, "barometer", 0);
    let offset_pa = config.offset_pa * next_gaussian(&dice);
    let rate_hz = f64::from(config.rate_hz.max(1));
    let step_pa = config.weather_pa / (3600.0 * rate_hz).sqrt();
    let mut weather_pa = 0.0;
    let floor_m = datum.altitude_m + STOREY_M * f64::from(floors_up);
    let count = (walk.duration_s() * f64::from(config.rate_hz)) as i64;
    (0..count)
        .map(|k| {
            let measured_ns = (2 * k + 1) * 500_000_000 / i64::from(config.rate_hz.max(1));
            let height_m = walk
                .at(measured_ns as f64 * 1e-9)
                .world_from_rig
                .translation
                .z;
            weather_pa += step_pa * next_gaussian(&dice);
            let pressure_pa = standard_pressure_pa(floor_m + height_m)
                + offset_pa
                + weather_pa
                + config.noise_pa * next_gaussian(&dice);
            AmbientMessage {
                measured_ns,
                ready_ns: measured_ns,
                sample: AmbientSample::Pressure(PressureSample {
                    pressure_pa,
                    variance_pa2: config.noise_pa.powi(2),
                }),
            }
        })
        .collect()
}
