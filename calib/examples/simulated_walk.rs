//! Checks and refinement of a rig on simulated walks against exact truth: `simulated_walk SEEDS [SECONDS]` writes a walk of each
//! seed with right stamps and with images stamped 5 ms late and early, prints what `verify` says of them, then puts the LiDAR
//! 1° and 2 cm wrong and prints what `refine` leaves.

#[path = "../tests/simulated_walk/mod.rs"]
mod simulated_walk;

use lsfb_calib::verify::{Outcome, VerifyConfig, refine, verify};
use lsfb_geometry::{Rig, Se3, Vector3, Vector6};
use lsfb_recording::Recording;
use lsfb_sim::SimConfig;
use lsfb_types::no_progress;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulated_walk::Walk;

type Failure = Box<dyn std::error::Error>;

/// By how much images are stamped wrong, seconds.
const WRONG_S: [f64; 3] = [0.0, 0.005, -0.005];
const CAMERAS: [&str; 2] = ["cam0", "cam1"];

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let word = |k: usize, default: &str| arguments.get(k).map_or(default.into(), String::clone);
    let (seeds, seconds): (u64, f64) = (word(0, "8").parse()?, word(1, "30").parse()?);
    let folder = tempfile::tempdir()?;
    let (mut times, mut left) = (Times::default(), Left::default());
    for seed in 1..=seeds {
        let mut config = SimConfig {
            seed,
            ..SimConfig::default()
        };
        (config.scan_cameras.width, config.scan_cameras.height) = (480, 300);
        let walk = Walk::simulate(&config, &CAMERAS, seconds);
        let path = folder.path().join("walk.mcap");
        for wrong_s in WRONG_S {
            let _ = std::fs::remove_file(&path);
            walk.write(&path, wrong_s);
            times.add(seed, wrong_s, &Recording::open(&path)?, &walk.rig)?;
        }
        let _ = std::fs::remove_file(&path);
        walk.write(&path, 0.0);
        left.add(seed, &Recording::open(&path)?, &walk.rig)?;
    }
    times.print();
    left.print();
    Ok(())
}

/// What was said of the clocks and the mounting.
#[derive(Default)]
struct Times {
    checks: usize,
    false_alarms: usize,
    inserted: usize,
    detected: usize,
    worst_ms: f64,
    squares: f64,
    normalized: f64,
    turned_deg: f64,
}

impl Times {
    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn add(
        &mut self,
        seed: u64,
        wrong_s: f64,
        recording: &Recording,
        rig: &Rig,
    ) -> Result<(), Failure> {
        let config = VerifyConfig::default();
        let found = verify(recording, rig, &config, &no_progress)?;
        for check in &found.checks {
            let (Some(value), Some(sigma)) = (check.value, check.sigma) else {
                println!(
                    "seed {seed}, {:+.0} ms: {}: {}",
                    wrong_s * 1e3,
                    check.name,
                    check.sentence
                );
                continue;
            };
            println!(
                "seed {seed}, {:+.0} ms: {}: {value:.2} ± {sigma:.2} {}, {}",
                wrong_s * 1e3,
                check.name,
                check.unit,
                check.outcome.name()
            );
            let bad = check.outcome >= Outcome::Warn;
            if check.name.ends_with("time offset") {
                // What must be added to the camera's times.
                let off = value + wrong_s * 1e3;
                self.checks += 1;
                self.worst_ms = self.worst_ms.max(off.abs());
                self.squares += off * off;
                self.normalized += (off / sigma).powi(2);
                if wrong_s == 0.0 {
                    self.false_alarms += usize::from(bad);
                } else {
                    self.inserted += 1;
                    self.detected += usize::from(bad);
                }
            } else if check.name.ends_with("rotation to the IMU") && wrong_s == 0.0 {
                self.turned_deg = self.turned_deg.max(value);
                self.false_alarms += usize::from(bad);
            } else if wrong_s == 0.0 {
                self.false_alarms += usize::from(bad);
            }
        }
        Ok(())
    }

    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn print(&self) {
        let n = self.checks.max(1) as f64;
        println!(
            "time offset: error {:.2} ms rms, worst {:.2} ms, {:.2} of its stated σ rms; 5 ms detected in {} of {}; rotation to the IMU ≤ {:.2}°; {} false alarms of all checks",
            (self.squares / n).sqrt(),
            self.worst_ms,
            (self.normalized / n).sqrt(),
            self.detected,
            self.inserted,
            self.turned_deg,
            self.false_alarms
        );
    }
}

/// What refinement leaves of 1° and 2 cm.
#[derive(Default)]
struct Left {
    cameras: usize,
    given: usize,
    turns_deg: Vec<f64>,
    shifts_mm: Vec<f64>,
    inside: usize,
}

impl Left {
    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn add(&mut self, seed: u64, recording: &Recording, rig: &Rig) -> Result<(), Failure> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut direction = || {
            let any = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            any.try_normalize(1e-3).unwrap_or_else(Vector3::x)
        };
        let (turn, shift) = (direction() * 1f64.to_radians(), direction() * 0.02);
        let wrong = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
        let mut disturbed = rig.clone();
        if let Some(lidar) = &mut disturbed.lidar {
            lidar.rig_from_lidar = lidar.rig_from_lidar * Se3::exp(&wrong);
        }
        let lidar = rig.lidar.as_ref().ok_or("no LiDAR")?.rig_from_lidar;
        let found = refine(
            recording,
            &disturbed,
            &VerifyConfig::default(),
            &no_progress,
        )?;
        for c in &found.cameras {
            self.cameras += 1;
            println!("seed {seed}: {}: {}", c.camera, c.sentence);
            let Some(edge) = &c.edge else {
                continue;
            };
            self.given += 1;
            let truth = rig.cameras[&c.camera].rig_from_camera.inverse() * lidar;
            let off = (edge.target_from_source.inverse() * truth).log();
            let turn_deg = off.fixed_rows::<3>(0).norm().to_degrees();
            // At the camera: a turn moves the LiDAR's origin too, and what was left as it was is not in question.
            let shift_mm = off.fixed_rows::<3>(3).norm() * 1e3;
            let covariance = edge.covariance.ok_or("no covariance")?;
            let inverse = covariance.try_inverse().ok_or("no covariance")?;
            let nees = (off.transpose() * inverse * off)[0];
            self.inside += usize::from(nees < 12.5916);
            println!(
                "seed {seed}: {}: left {turn_deg:.3}° and {shift_mm:.1} mm, NEES {nees:.1}",
                c.camera
            );
            self.turns_deg.push(turn_deg);
            self.shifts_mm.push(shift_mm);
        }
        Ok(())
    }

    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn print(&self) {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
        let worst = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
        println!(
            "refinement from 1° and 20 mm off: {} of {} cameras given out; left mean {:.3}° and {:.1} mm, worst {:.3}° and {:.1} mm; {} within the 95 % region",
            self.given,
            self.cameras,
            mean(&self.turns_deg),
            mean(&self.shifts_mm),
            worst(&self.turns_deg),
            worst(&self.shifts_mm),
            self.inside
        );
    }
}
