//! Clocks estimated again from a recording: what `lsfb clock` does.
#![allow(
    clippy::unwrap_used,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use lsfb_capture::clock::{ClockConfig, estimate_clocks};
use lsfb_recording::{Recording, Writer, WriterConfig};
use lsfb_types::{ImuSample, Stamped, Timestamp, no_progress};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const START: i64 = 1_772_359_200_000_000_000;
/// Ticks of 100 µs between two samples at 200 Hz.
const TICKS: u64 = 50;
const SKEW: f64 = 37e-6;
const SECS: u64 = 200;
/// The host's clock is set forward by a second here.
const STEP_AT: u64 = 130;
const STEP_NS: i64 = 1_000_000_000;
const SHORTEST_NS: i64 = 400_000;

#[test]
fn a_recorded_clock_is_estimated_again_with_its_step() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut last_arrival = 0;
    let mut stepped_at = None;
    for n in 0..SECS * 200 {
        // The unit samples by its own clock.
        let since_ns = (n * 5_000_000) as f64 * (1.0 + SKEW);
        let true_ns = START + since_ns.round() as i64;
        let delay = SHORTEST_NS + (10e6 * rng.random::<f64>()) as i64;
        let step = if n >= STEP_AT * 200 { STEP_NS } else { 0 };
        let arrival_ns = (true_ns + delay + step).max(last_arrival);
        last_arrival = arrival_ns;
        if n == STEP_AT * 200 {
            stepped_at = Some(arrival_ns);
        }
        let sample = Stamped {
            // Recorded live with a constant error of 30 µs.
            time: Timestamp::from_nanos(true_ns + SHORTEST_NS + step + 30_000),
            arrival: Timestamp::from_nanos(arrival_ns),
            device_ticks: 7_000 + n * TICKS,
            sample: ImuSample::default(),
        };
        writer.write_imu("imu0", &sample).unwrap();
    }
    writer.finish().unwrap();

    let recording = Recording::open(&path).unwrap();
    let report = estimate_clocks(&recording, &ClockConfig::default(), &no_progress).unwrap();
    assert_eq!(report.devices.len(), 1);
    let clock = &report.devices[0];
    assert_eq!((clock.device.as_str(), clock.locked), ("imu0", false));
    assert_eq!(clock.pairs, SECS * 200);
    assert_eq!(clock.epochs.len(), 2, "{:?}", clock.epochs);
    for epoch in &clock.epochs {
        let error_ppm = epoch.skew_ppm - SKEW * 1e6;
        assert!(error_ppm.abs() < 0.1, "{epoch:?}");
        assert!(error_ppm.abs() < 4.0 * epoch.sigma_skew_ppm, "{epoch:?}");
        assert!(epoch.sigma_us < 20.0, "{epoch:?}");
    }
    let step = &clock.epochs[1];
    assert_eq!(Some(step.arrival_start_ns), stepped_at);
    assert!((step.step_ns - STEP_NS).abs() < 12_000_000, "{step:?}");
    // What was recorded is off by 30 µs, and by no more than the estimate's own error around that.
    assert!(
        (clock.recorded_mean_us - 30.0).abs() < 20.0,
        "{}",
        clock.recorded_mean_us
    );
    assert!(clock.recorded_rms_us < 20.0, "{}", clock.recorded_rms_us);
    assert!(
        (clock.delay_p50_ms - 5.0).abs() < 0.3,
        "{}",
        clock.delay_p50_ms
    );
    assert!(clock.samples.len() <= 4_000 && clock.samples.len() > 1_000);
}

#[test]
fn a_counter_that_jumps_by_years_costs_no_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    for n in 0..2_000_u64 {
        let time = Timestamp::from_nanos(START + (n * 5_000_000).cast_signed());
        // Two days and a half of ticks of 100 µs.
        let device_ticks = 1 + n * TICKS + u64::from(n >= 1_000) * (1 << 31);
        let sample = Stamped {
            time,
            arrival: time,
            device_ticks,
            sample: ImuSample::default(),
        };
        writer.write_imu("imu0", &sample).unwrap();
    }
    writer.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    let config = ClockConfig { window_secs: 1.0 };
    let report = estimate_clocks(&recording, &config, &no_progress).unwrap();
    assert_eq!(report.devices[0].pairs, 2_000);
}
