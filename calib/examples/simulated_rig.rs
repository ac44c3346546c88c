//! Cameras on an IMU against exact truth: `simulated_rig SEEDS SECONDS` prints the errors of each seed and how often they lie
//! within 1.96 of their stated standard deviations; `simulated_rig shuffle RUNS` gives the same input in other orders.

#[path = "../tests/simulated_rig/mod.rs"]
mod simulated_rig;

use std::time::Instant;

use lsfb_calib::camera::{CameraConfig, calibrate_cameras};
use lsfb_calib::camera_imu::{CameraImuCalibration, CameraImuConfig, calibrate_camera_imu};
use lsfb_types::no_progress;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use simulated_rig::{GRID, Setup, Simulated, noise, simulate};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let word = |k: usize, default: &str| arguments.get(k).map_or(default.into(), String::clone);
    match word(0, "20").as_str() {
        "shuffle" => shuffle(word(1, "100").parse()?),
        seeds => seeds_against_truth(seeds.parse()?, word(1, "60").parse()?),
    }
}

/// Lenses first, from the views alone, then all together.
fn calibrate(simulated: &Simulated) -> Result<CameraImuCalibration, lsfb_calib::Error> {
    let config = CameraConfig {
        hold_back_every: 0,
        ..CameraConfig::default()
    };
    // Their clocks differ: each for itself.
    let mut known = simulated.known();
    for camera in &mut known {
        let views = std::slice::from_ref(&camera.views);
        let lens = calibrate_cameras(&GRID, views, &config, &no_progress)?;
        camera.camera = lens.cameras[0].camera;
    }
    let config = CameraImuConfig::default();
    calibrate_camera_imu(
        &GRID,
        &known,
        &simulated.imu,
        &noise(),
        &config,
        &no_progress,
    )
}

/// Largest errors, and how many of them lie within their stated spread.
#[derive(Default)]
struct Tally {
    turn_deg: f64,
    place_m: f64,
    clock_s: f64,
    focal: f64,
    bias_rad_s: f64,
    inside: usize,
    all: usize,
}

impl Tally {
    fn count(&mut self, error: f64, sigma: f64) {
        self.all += 1;
        self.inside += usize::from(error.abs() <= 1.96 * sigma);
    }

    fn add(&mut self, simulated: &Simulated, found: &CameraImuCalibration) {
        for (found, truth) in found
            .imu
            .gyro_bias_rad_s
            .iter()
            .zip(simulated.gyro_bias.iter())
        {
            self.bias_rad_s = self.bias_rad_s.max((found - truth).abs());
        }
        for (c, truth) in found.cameras.iter().zip(&simulated.truth) {
            let off = (truth.camera_from_rig.inverse() * c.camera_from_rig).log();
            for k in 0..6 {
                self.count(off[k], c.covariance[(k, k)].sqrt());
            }
            let clock_s = c.rig_from_camera_s - truth.rig_from_camera_s;
            self.count(clock_s, c.rig_from_camera_sigma_s);
            for (p, truth) in c.lens.iter().zip(truth.camera.lens.parameters().values) {
                self.count(p.value - truth, p.sigma);
            }
            let place = c.camera_from_rig.inverse().translation
                - truth.camera_from_rig.inverse().translation;
            let focal = c.camera.focal_px()[0] / truth.camera.focal_px()[0] - 1.0;
            let turn_deg = off.fixed_rows::<3>(0).norm().to_degrees();
            self.turn_deg = self.turn_deg.max(turn_deg);
            self.place_m = self.place_m.max(place.norm());
            self.clock_s = self.clock_s.max(clock_s.abs());
            self.focal = self.focal.max(focal.abs());
        }
    }

    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn print(&self, name: &str) {
        println!(
            "{name}: rotation ≤ {:.4}°, translation ≤ {:.3} mm, clock ≤ {:.1} µs, focal length ≤ {:.4} %, gyroscope bias ≤ {:.1e} rad/s, {} of {} errors within 1.96 σ ({:.1} %)",
            self.turn_deg,
            self.place_m * 1e3,
            self.clock_s * 1e6,
            self.focal * 100.0,
            self.bias_rad_s,
            self.inside,
            self.all,
            100.0 * self.inside as f64 / self.all.max(1) as f64
        );
    }
}

fn seeds_against_truth(seeds: u64, duration_s: f64) -> Result<(), Failure> {
    let mut all = Tally::default();
    for seed in 1..=seeds {
        let simulated = simulate(&Setup {
            seed,
            duration_s,
            ..Setup::default()
        });
        let start = Instant::now();
        let found = calibrate(&simulated)?;
        let mut own = Tally::default();
        own.add(&simulated, &found);
        own.print(&format!(
            "seed {seed} ({:.1} s)",
            start.elapsed().as_secs_f64()
        ));
        all.add(&simulated, &found);
    }
    all.print(&format!("{seeds} seeds of {duration_s} s"));
    Ok(())
}

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn shuffle(runs: u64) -> Result<(), Failure> {
    let simulated = simulate(&Setup {
        duration_s: 5.0,
        view_rate_hz: 10.0,
        ..Setup::default()
    });
    let run = |simulated: &Simulated| {
        let (known, config) = (simulated.known(), CameraImuConfig::default());
        calibrate_camera_imu(
            &GRID,
            &known,
            &simulated.imu,
            &noise(),
            &config,
            &no_progress,
        )
    };
    let straight = run(&simulated)?;
    let mut largest = 0.0f64;
    for seed in 0..runs {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut other = simulated.clone();
        other.imu.shuffle(&mut rng);
        for corners in other.views.iter_mut().flat_map(|v| v.views.values_mut()) {
            corners.shuffle(&mut rng);
        }
        let found = run(&other)?;
        for (c, same) in found.cameras.iter().zip(&straight.cameras) {
            let off = (same.camera_from_rig.inverse() * c.camera_from_rig).log();
            largest = largest
                .max(off.amax())
                .max((same.rig_from_camera_s - c.rig_from_camera_s).abs());
        }
    }
    println!("{runs} runs in other orders: largest difference {largest:e} (rad, m, s)");
    Ok(())
}
