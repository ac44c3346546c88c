//! CPU time of judging two files within one process, beside evo's of the same (`benches/eval/evo_in_process.py`, which makes the files).
//!
//! `cargo run --release --workspace --example judge_17000 -- truth.tum estimate.tum`
#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use std::path::PathBuf;

use lsfb_eval::alignment::{AlignmentMode, align, apply};
use lsfb_eval::association::{PosePair, associate};
use lsfb_eval::metrics::{RelativeSpec, absolute_errors, relative_errors};
use lsfb_eval::pairs::PairSelection;
use lsfb_eval::relation::{DeltaUnit, PoseRelation};
use lsfb_eval::{EvalConfig, Statistics, evaluate, read_poses};
use lsfb_geometry::StampedPose;
use nix::time::{ClockId, clock_gettime};

type Problem = Box<dyn std::error::Error>;

const RUNS: usize = 21;

fn main() -> Result<(), Problem> {
    let files: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [truth, estimate] = files.as_slice() else {
        return Err("usage: judge_17000 TRUTH ESTIMATE".into());
    };
    let mut runs = [Vec::new(), Vec::new(), Vec::new()];
    let mut found = [0.0; 2];
    for _ in 0..RUNS {
        let start = cpu_secs()?;
        let poses = [read_poses(truth)?, read_poses(estimate)?];
        let read = cpu_secs()?;
        found = translation_alone(&poses)?;
        let judged = cpu_secs()?;
        let both = evaluate(&poses[0], &poses[1], &EvalConfig::default())?;
        if (both.ate_translation_m.rmse - found[0]).abs() > 1e-12 {
            return Err("the two ways differ".into());
        }
        let all = cpu_secs()?;
        for (secs, own) in [read - start, judged - start, all - judged + read - start]
            .into_iter()
            .zip(&mut runs)
        {
            own.push(secs);
        }
    }
    let [read, alone, all] = runs.map(|mut secs| {
        secs.sort_by(f64::total_cmp);
        1000.0 * secs[RUNS / 2]
    });
    println!("ATE {:.9} m, RPE per metre {:.9} m", found[0], found[1]);
    println!(
        "median of {RUNS}, ms of CPU: reading {read:.1}; reading, ATE and RPE of translation {alone:.1}; reading and all figures {all:.1}"
    );
    Ok(())
}

/// ATE after SE(3) and RPE per metre, as evo is asked for them.
fn translation_alone([truth, estimate]: &[Vec<StampedPose>; 2]) -> Result<[f64; 2], Problem> {
    let pairs = associate(truth, estimate, 0.01)?;
    let alignment = align(&pairs, AlignmentMode::Se3)?;
    let aligned: Vec<PosePair> = pairs
        .iter()
        .map(|pair| {
            let mut pair = *pair;
            pair.estimate.world_from_rig = apply(&alignment, &pair.estimate.world_from_rig);
            pair
        })
        .collect();
    let relation = PoseRelation::TranslationPart;
    let spec = RelativeSpec {
        relation,
        delta: 1.0,
        unit: DeltaUnit::Metres,
        selection: PairSelection::Consecutive,
    };
    let rmse = |errors: Vec<f64>| Statistics::of(&errors).map(|s| s.rmse).ok_or("no errors");
    Ok([
        rmse(absolute_errors(&aligned, relation)?)?,
        rmse(relative_errors(&aligned, spec)?)?,
    ])
}

/// Of this process.
fn cpu_secs() -> Result<f64, Problem> {
    let spent = clock_gettime(ClockId::CLOCK_PROCESS_CPUTIME_ID)?;
    Ok(spent.tv_sec() as f64 + 1e-9 * spent.tv_nsec() as f64)
}
