//! Checks of a rig on simulated walks against exact truth: `simulated_walk SEEDS [SECONDS [DEGREES]]` writes a walk of each seed with
//! the backpack and prints what `verify` says of the right rig, of one whose cameras are 5 ms late and early, and of one whose
//! cameras are turned by DEGREES about any axis. SEEDS are `8`, the first eight, or `3-5`.

use std::ops::RangeInclusive;

use lsfb_calib::verify::{Check, VerifyConfig, verify};
use lsfb_geometry::{Rig, Se3, Vector3, Vector6};
use lsfb_recording::Recording;
use lsfb_rigs::walk::Walk;
use lsfb_sim::SimConfig;
use lsfb_types::{Verdict, no_progress};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

type Failure = Box<dyn std::error::Error>;

/// By how much images are stamped wrong, seconds.
const WRONG_S: [f64; 2] = [0.005, -0.005];
const CAMERAS: [&str; 4] = ["cam0", "cam1", "cam2", "cam3"];

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let word = |k: usize, default: &str| arguments.get(k).map_or(default.into(), String::clone);
    let (seeds, seconds, degrees) = (
        seeds(&word(0, "8"))?,
        word(1, "36").parse()?,
        word(2, "1").parse()?,
    );
    let folder = tempfile::tempdir()?;
    let mut said = Said::default();
    for seed in seeds {
        let mut config = SimConfig {
            seed,
            ..SimConfig::default()
        };
        (config.scan_cameras.width, config.scan_cameras.height) = (480, 300);
        let walk = Walk::simulate(&config, &CAMERAS, seconds);
        let path = folder.path().join(format!("{seed}.mcap"));
        walk.write(&path, 0.0);
        said.add(seed, &Recording::open(&path)?, &walk.rig, degrees)?;
        std::fs::remove_file(&path)?;
    }
    said.print(degrees);
    Ok(())
}

/// `8` or `3-5`.
fn seeds(text: &str) -> Result<RangeInclusive<u64>, Failure> {
    Ok(match text.split_once('-') {
        Some((first, last)) => first.parse()?..=last.parse()?,
        None => 1..=text.parse()?,
    })
}

/// What is wrong with a rig that is verified.
#[derive(Clone, Copy, PartialEq)]
enum Wrong {
    Nothing,
    Clocks,
    Mounts,
}

/// What was said of clocks and mounting.
#[derive(Default)]
struct Said {
    /// Errors of time offsets over all rigs whose mounting is right: milliseconds, and over their stated σ; of right ones alone.
    errors_ms: Vec<f64>,
    normalized: Vec<f64>,
    failed_ms: usize,
    inserted_ms: usize,
    /// By kind of check: all on right rigs, those that warned, failed and said nothing.
    right: [[usize; 4]; KINDS.len()],
    /// By kind of check: all on turned cameras, those that at least warned, and that failed.
    turned: [[usize; 3]; KINDS.len()],
}

/// The ends of checks' names.
const KINDS: [&str; 4] = [
    "time offset",
    "rotation to the IMU",
    "rotation to the LiDAR",
    "epipolar",
];

impl Said {
    fn add(
        &mut self,
        seed: u64,
        recording: &Recording,
        rig: &Rig,
        degrees: f64,
    ) -> Result<(), Failure> {
        self.look(seed, recording, rig, (Wrong::Nothing, 0.0))?;
        for wrong_s in WRONG_S {
            let mut late = rig.clone();
            for camera in late.cameras.values_mut() {
                camera.timing.rig_from_camera_s = wrong_s;
            }
            self.look(seed, recording, &late, (Wrong::Clocks, wrong_s * 1e3))?;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut turned = rig.clone();
        for camera in turned.cameras.values_mut() {
            let any = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let turn = any.try_normalize(1e-3).unwrap_or_else(Vector3::x) * degrees.to_radians();
            let turn = Vector6::new(turn.x, turn.y, turn.z, 0.0, 0.0, 0.0);
            camera.rig_from_camera = camera.rig_from_camera * Se3::exp(&turn);
        }
        self.look(seed, recording, &turned, (Wrong::Mounts, degrees))
    }

    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn look(
        &mut self,
        seed: u64,
        recording: &Recording,
        rig: &Rig,
        (wrong, size): (Wrong, f64),
    ) -> Result<(), Failure> {
        let found = verify(recording, rig, &VerifyConfig::default(), &no_progress)?;
        let what = match wrong {
            Wrong::Nothing => "right".to_owned(),
            Wrong::Clocks => format!("{size:+.0} ms"),
            Wrong::Mounts => format!("turned {size:.1}°"),
        };
        for check in &found.checks {
            let (value, sigma) = (check.value.unwrap_or(f64::NAN), check.sigma);
            println!(
                "seed {seed}, {what}: {}: {value:.3} ± {:.3} {}, {}",
                check.name,
                sigma.unwrap_or(f64::NAN),
                check.unit,
                check.outcome.name()
            );
            self.count(check, wrong, size);
        }
        Ok(())
    }

    fn count(&mut self, check: &Check, wrong: Wrong, size: f64) {
        let Some(kind) = KINDS.iter().position(|k| check.name.ends_with(k)) else {
            return;
        };
        let outcome = check.outcome;
        match wrong {
            Wrong::Nothing => {
                self.right[kind][0] += 1;
                let place = match outcome {
                    Verdict::Pass => None,
                    Verdict::Warn => Some(1),
                    Verdict::Fail => Some(2),
                    _ => Some(3),
                };
                if let Some(place) = place {
                    self.right[kind][place] += 1;
                }
                if let (0, Some(value), Some(sigma)) = (kind, check.value, check.sigma) {
                    self.errors_ms.push(value);
                    self.normalized.push(value / sigma);
                }
            }
            Wrong::Clocks if kind == 0 => {
                // What must be added to the camera's times beyond what the rig says.
                let off_ms = check.value.unwrap_or(f64::NAN) + size;
                self.inserted_ms += 1;
                let found = outcome == Verdict::Fail && off_ms.abs() < 1.0;
                self.failed_ms += usize::from(found);
            }
            Wrong::Clocks => {}
            Wrong::Mounts => {
                self.turned[kind][0] += 1;
                self.turned[kind][1] += usize::from(outcome >= Verdict::Warn);
                self.turned[kind][2] += usize::from(outcome == Verdict::Fail);
            }
        }
    }

    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn print(&self, degrees: f64) {
        let rms = |v: &[f64]| {
            let squares = v.iter().map(|x| x * x).sum::<f64>();
            (squares / v.len().max(1) as f64).sqrt()
        };
        let worst = self.errors_ms.iter().fold(0.0, |w: f64, e| w.max(e.abs()));
        let inside = self.normalized.iter().filter(|z| z.abs() < 1.96).count();
        println!(
            "time offset: error {:.3} ms rms, worst {worst:.3} ms; {inside} of {} within 1.96 σ, {:.2} σ rms; 5 ms early or late fails and is measured in {} of {}",
            rms(&self.errors_ms),
            self.normalized.len(),
            rms(&self.normalized),
            self.failed_ms,
            self.inserted_ms
        );
        for (kind, name) in KINDS.iter().enumerate() {
            let [all, warned, failed, silent] = self.right[kind];
            let [turned, found, broken] = self.turned[kind];
            println!(
                "{name}: of {all} checks of right rigs {warned} warn, {failed} fail, {silent} say nothing; of {turned} on cameras turned by {degrees}° {found} warn or fail, {broken} fail"
            );
        }
    }
}
