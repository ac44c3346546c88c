//! Refinement of the LiDAR's pose to two cameras on simulated walks against exact truth:
//! `simulated_refine FROM TO SECONDS SHARE KIND FOLDER` takes walks of these seeds from the folder, or simulates them into it, puts the
//! LiDAR off by that share of 2.5° and 5 cm in any direction, refines, and prints what is left, over its standard deviations.
//! `KIND` is `default`, or a place with the paper's cameras at their full rate: `demo`, `medium-office` …

use std::path::{Path, PathBuf};

use lsfb_calib::refine::{RefineConfig, Refinement, refine};
use lsfb_geometry::{Rig, Se3, Vector3, Vector6};
use lsfb_recording::Recording;
use lsfb_rigs::walk::Walk;
use lsfb_sim::{Device, Place, SimConfig};
use lsfb_types::no_progress;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

type Failure = Box<dyn std::error::Error>;

const CAMERAS: [&str; 2] = ["cam0", "cam1"];
/// How far the rig may be wrong.
const OFF: [f64; 2] = [2.5 * std::f64::consts::PI / 180.0, 0.05];
/// 95 % of a normal number lie within so many standard deviations, of six within so much of their squared sum.
const SIGMAS_95: f64 = 1.96;
const SQUARE_95: f64 = 12.5916;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let word = |k: usize, default: &str| arguments.get(k).map_or(default.into(), String::clone);
    let (from, to): (u64, u64) = (word(0, "1").parse()?, word(1, "10").parse()?);
    let (seconds, share): (f64, f64) = (word(2, "36").parse()?, word(3, "1").parse()?);
    let kind = word(4, "default");
    let folder = PathBuf::from(word(5, "walks"));
    std::fs::create_dir_all(&folder)?;
    let mut left = Left::default();
    for seed in from..=to {
        let path = folder.join(format!("{kind}-{seed}-{seconds}.mcap"));
        if !path.exists() {
            simulate(&kind, seed, seconds, &path)?;
        }
        let recording = Recording::open(&path)?;
        let truth = recording.rig()?;
        let found = refine(
            &recording,
            &disturbed(&truth, seed, share)?,
            &RefineConfig::default(),
            &no_progress,
        )?;
        for camera in &found.cameras {
            left.add(seed, camera, &truth)?;
        }
    }
    left.print();
    Ok(())
}

fn simulate(kind: &str, seed: u64, seconds: f64, path: &Path) -> Result<(), Failure> {
    let mut config = SimConfig::default();
    if kind != "default" {
        let place = Place::named(kind).ok_or("no such place")?;
        config = SimConfig::for_place(place, Device::Glasses);
    }
    config.seed = seed;
    let part = path.with_extension("part");
    Walk::simulate(&config, &CAMERAS, seconds).write(&part, 0.0);
    Ok(std::fs::rename(part, path)?)
}

fn disturbed(truth: &Rig, seed: u64, share: f64) -> Result<Rig, Failure> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut direction = || {
        let any = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        any.try_normalize(1e-3).unwrap_or_else(Vector3::x)
    };
    let (turn, shift) = (direction() * OFF[0] * share, direction() * OFF[1] * share);
    let wrong = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
    let mut rig = truth.clone();
    let lidar = rig.lidar_mut().ok_or("no LiDAR")?;
    lidar.rig_from_lidar = lidar.rig_from_lidar * Se3::exp(&wrong);
    Ok(rig)
}

/// What refinement leaves.
#[derive(Default)]
struct Left {
    cameras: usize,
    /// Numbers not determined.
    held: usize,
    turns_deg: Vec<f64>,
    shifts_mm: Vec<f64>,
    /// Squared error over covariance.
    squares: Vec<f64>,
    /// Each number over its standard deviation.
    normalized: Vec<[f64; 6]>,
}

impl Left {
    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn add(&mut self, seed: u64, found: &Refinement, rig: &Rig) -> Result<(), Failure> {
        self.cameras += 1;
        println!("seed {seed}: {}: {}", found.camera, found.sentence);
        let Some(edge) = &found.edge else {
            return Ok(());
        };
        self.held += found
            .components
            .iter()
            .filter(|c| c.change.is_none())
            .count();
        let lidar = rig.lidar().ok_or("no LiDAR")?.rig_from_lidar;
        let truth = rig.cameras[&found.camera].rig_from_camera.inverse() * lidar;
        // In the camera's axes.
        let off = edge.target_from_source.inverse().local(&truth.inverse());
        let through = edge.target_from_source.adjoint();
        let covariance = through * edge.covariance.ok_or("no covariance")? * through.transpose();
        let weighted = covariance.cholesky().ok_or("no covariance")?.solve(&off);
        let turn_deg = off.fixed_rows::<3>(0).norm().to_degrees();
        let shift_mm = off.fixed_rows::<3>(3).norm() * 1e3;
        let normalized: [f64; 6] = std::array::from_fn(|k| off[k] / covariance[(k, k)].sqrt());
        println!(
            "seed {seed}: {}: left {turn_deg:.3}° and {shift_mm:.1} mm; over σ {}; NEES {:.1}",
            found.camera,
            normalized.map(|z| format!("{z:+.2}")).join(" "),
            off.dot(&weighted)
        );
        self.turns_deg.push(turn_deg);
        self.shifts_mm.push(shift_mm);
        self.squares.push(off.dot(&weighted));
        self.normalized.push(normalized);
        Ok(())
    }

    #[allow(clippy::print_stdout, reason = "an example prints its result")]
    fn print(&self) {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
        let worst = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
        let numbers: Vec<f64> = self.normalized.iter().flatten().map(|z| z.abs()).collect();
        let share = |inside: usize, all: usize| 100.0 * inside as f64 / all.max(1) as f64;
        println!(
            "{} of {} cameras given out, {} numbers held; left mean {:.3}° and {:.1} mm, worst {:.3}° and {:.1} mm",
            self.squares.len(),
            self.cameras,
            self.held,
            mean(&self.turns_deg),
            mean(&self.shifts_mm),
            worst(&self.turns_deg),
            worst(&self.shifts_mm)
        );
        println!(
            "NEES over 6: mean {:.2}, worst {:.2}; {:.0} % of poses within their 95 % region; {:.1} % of numbers within 1.96 σ, worst {:.2} σ",
            mean(&self.squares) / 6.0,
            worst(&self.squares) / 6.0,
            share(
                self.squares.iter().filter(|s| **s < SQUARE_95).count(),
                self.squares.len()
            ),
            share(
                numbers.iter().filter(|z| **z < SIGMAS_95).count(),
                numbers.len()
            ),
            worst(&numbers)
        );
        for (k, name) in ["rotation x", "rotation y", "rotation z", "x", "y", "z"]
            .iter()
            .enumerate()
        {
            let own: Vec<f64> = self.normalized.iter().map(|z| z[k]).collect();
            let squares: Vec<f64> = own.iter().map(|z| z * z).collect();
            println!(
                "{name}: mean {:+.2} σ, rms {:.2} σ",
                mean(&own),
                mean(&squares).sqrt()
            );
        }
    }
}
