//! Noise of the simulated IMU, read from two hours at rest.

use lsfb_calib::imu_noise::{ImuNoiseConfig, Noise, imu_noise};
use lsfb_sim::{ImuConfig, SimConfig, at_rest};
use lsfb_types::{Timestamp, no_progress};

fn check(name: &str, found: &Noise, truth: [Option<f64>; 3]) {
    let found = [found.density, found.instability, found.walk];
    for (found, truth) in found.into_iter().zip(truth) {
        let Some(truth) = truth else { continue };
        assert!(
            (found / truth - 1.0).abs() < 0.1,
            "{name}: {found:e}, put in {truth:e}"
        );
    }
}

/// Where a walk is strong it hides the instability, and the other way round: two hours tell either from white noise.
#[test]
fn two_hours_at_rest_give_the_noise_that_was_put_in() {
    let white = ImuConfig {
        rate_hz: 100,
        gyro_noise_density: 2e-4,
        gyro_bias_instability: 0.0,
        gyro_bias_walk: 0.0,
        accel_noise_density: 2e-3,
        accel_bias_instability: 0.0,
        accel_bias_walk: 0.0,
        ..SimConfig::default().glasses_imu
    };
    let walking = ImuConfig {
        gyro_bias_walk: 5e-5,
        accel_bias_walk: 4e-4,
        ..white
    };
    let flickering = ImuConfig {
        gyro_bias_instability: 1.5e-4,
        accel_bias_instability: 1.2e-3,
        ..white
    };
    for truth in [walking, flickering] {
        let samples: Vec<_> = at_rest(7200.0, &truth, 4)
            .into_iter()
            .map(|s| (Timestamp::from_nanos(s.offset_ns), s.sample))
            .collect();
        let found = imu_noise(&samples, &ImuNoiseConfig::default(), &no_progress).expect("noise");
        assert!((found.rate_hz - 100.0).abs() < 1e-6 && found.samples == samples.len());
        let put_in = |value: f64| (value > 0.0).then_some(value);
        check(
            "gyroscope",
            &found.gyro,
            [
                Some(truth.gyro_noise_density),
                put_in(truth.gyro_bias_instability),
                put_in(truth.gyro_bias_walk),
            ],
        );
        check(
            "accelerometer",
            &found.accel,
            [
                Some(truth.accel_noise_density),
                put_in(truth.accel_bias_instability),
                put_in(truth.accel_bias_walk),
            ],
        );
    }
}
