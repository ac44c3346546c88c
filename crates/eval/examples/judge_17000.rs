//! How long judging takes: 17 000 poses against as many, from files, Sim(3) alignment, as PEERS measures evo.
//!
//! `cargo run --release -p lsfb-eval --example judge_17000 -- FOLDER` leaves `truth.tum` and `estimate.tum` in FOLDER for
//! `evo_ape tum truth.tum estimate.tum -as` beside it.
#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use lsfb_eval::alignment::AlignmentMode;
use lsfb_eval::{EvalConfig, Evaluation, evaluate, read_poses};
use lsfb_geometry::{Se3, Vector3, Vector6};
use lsfb_types::Timestamp;

const POSES: u32 = 17_000;
const RUNS: usize = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = PathBuf::from(
        std::env::args_os()
            .nth(1)
            .ok_or("usage: judge_17000 FOLDER")?,
    );
    std::fs::create_dir_all(&folder)?;
    let (truth, estimate) = (folder.join("truth.tum"), folder.join("estimate.tum"));
    std::fs::write(&truth, walk(0.0)?)?;
    std::fs::write(&estimate, walk(0.05)?)?;

    let config = EvalConfig {
        alignment: AlignmentMode::Sim3,
        ..EvalConfig::default()
    };
    let mut runs = Vec::new();
    for _ in 0..RUNS {
        let start = Instant::now();
        let (truth, estimate) = (read_poses(&truth)?, read_poses(&estimate)?);
        let read_secs = start.elapsed().as_secs_f64();
        let found = evaluate(&truth, &estimate, &config)?;
        runs.push((start.elapsed().as_secs_f64(), read_secs, found));
    }
    runs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (all_secs, read_secs, found): &(f64, f64, Evaluation) = &runs[RUNS / 2];
    println!(
        "{} poses matched: ATE rmse {:.6} m, RPE rmse per 1 m {:.6} m, scale {:.6}",
        found.matched_poses,
        found.ate_translation_m.rmse,
        found.rpe[0].translation_m.map_or(f64::NAN, |t| t.rmse),
        found.alignment_scale
    );
    println!("median of {RUNS}: {all_secs:.4} s in all, {read_secs:.4} s of it reading");
    Ok(())
}

/// Ten poses a second along a long curl, turned, scaled and shaken by `noise_m` where that is not zero.
fn walk(noise_m: f64) -> Result<String, std::fmt::Error> {
    let moved = Se3::exp(&Vector6::new(0.1, -0.2, 0.7, 3.0, 2.0, 1.0));
    let mut text = String::new();
    for i in 0..POSES {
        let t = f64::from(i) * 0.1;
        let turn = Vector6::new(
            0.1 * (0.3 * t).cos(),
            0.1 * (0.2 * t).sin(),
            0.02 * t,
            0.0,
            0.0,
            0.0,
        );
        let place = Vector3::new(
            20.0 * (0.02 * t).cos(),
            15.0 * (0.013 * t).sin(),
            0.5 * (0.1 * t).sin(),
        );
        let mut pose = Se3::new(Se3::exp(&turn).rotation, place);
        if noise_m > 0.0 {
            // The fractional part of a large sine: repeatable, and random enough to be averaged.
            let shake =
                |k: f64| 2.0 * ((f64::from(i) + k).sin() * 43_758.545).rem_euclid(1.0) - 1.0;
            pose = moved * pose;
            pose.translation = pose.translation * 0.97
                + Vector3::new(shake(0.1), shake(0.2), shake(0.3)) * noise_m;
        }
        let (p, q) = (pose.translation, pose.rotation);
        let time = Timestamp::from_secs_f64(1.6e9).plus_secs(t);
        writeln!(
            text,
            "{time} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
            p.x, p.y, p.z, q.i, q.j, q.k, q.w
        )?;
    }
    Ok(text)
}
