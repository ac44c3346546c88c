//! Visual-inertial bundle adjustment of stereo tracks, keyframe by keyframe: CPU time of each, and how far the cost is from
//! that of a cold solve.
//!
//! ```text
//! cargo run --release --workspace --example incremental_tracks -- vi_tracks_seq90.tar.gz
//! ```
//!
//! The peer on the same tracks with the same factors is `benches/solver/isam2_tracks.py`.

#![allow(clippy::print_stdout)] // a program, not a library

mod growing;
mod tracks;

use std::error::Error;

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::{StampedPose, Trajectory, Vector3};
use lsfb_solver::{Diagnosis, IncrementalConfig, SolveConfig, UpdateReport, solve};

use growing::Growing;
use nix::time::{ClockId, clock_gettime};
use tracks::Tracks;

/// Limits for tracks that no map holds. Each keyframe turns all earlier ones by a little, and with the limits of
/// [`IncrementalConfig::default`], which keep poses in a map within a micrometre, most of an update is spent on linearizing what was seen
/// long ago once more for it. With these the cost stays within 1e-7 of a batch solve.
fn limits() -> IncrementalConfig {
    IncrementalConfig {
        relinearize_above: 3e-3,
        kernel_error_above: 3e-4,
        turn_above: 3e-4,
        turn_alone_above: 1e-4,
        look_above: 3e-3,
        propagate_above: 2e-4,
        ..IncrementalConfig::default()
    }
}

/// Keyframes between two comparisons with a cold solve.
const COLD_EVERY: usize = 20;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments
        .next()
        .ok_or("give the file vi_tracks_seq90.tar.gz")?;
    // This thread is the pool, so that cold solves count as well.
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()?;
    let tracks = Tracks::read(&path)?;
    println!(
        "{} frames, {} keyframes",
        tracks.frame_count,
        tracks.keyframes.len()
    );
    let mut growing = Growing::new(&tracks, limits())?;
    let mut times_ms = Vec::new();
    let mut live = Vec::new();
    let mut worst = Apart::default();
    for k in 0..tracks.keyframes.len() {
        growing.add(k)?;
        let begun = cpu_ms()?;
        let report = growing.problem.update()?;
        times_ms.push(cpu_ms()? - begun);
        live.push(StampedPose {
            time: tracks.keyframes[k].time,
            world_from_rig: growing.pose(k),
        });
        if (k + 1) % COLD_EVERY == 0 || k + 1 == tracks.keyframes.len() {
            worst = worst.max(compare(&growing, k, &report)?);
        }
    }
    let all: Vec<StampedPose> = live
        .iter()
        .enumerate()
        .map(|(k, pose)| StampedPose {
            world_from_rig: growing.pose(k),
            ..*pose
        })
        .collect();
    let total_ms: f64 = times_ms.iter().sum();
    times_ms.sort_by(f64::total_cmp);
    let share = |s: f64| times_ms[((times_ms.len() - 1) as f64 * s).round() as usize];
    println!(
        "lsfb: cpu {total_ms:.0} ms in all, median {:.2}, p95 {:.2}, most {:.2} ms per keyframe; cost at most {:.1e} \
         above a cold solve's, poses at most {:.1e} m from its",
        share(0.5),
        share(0.95),
        share(1.0),
        worst.cost,
        worst.position_m,
    );
    println!(
        "ATE of keyframes {:.2} cm at the end, {:.2} cm as each was when it was new",
        100.0 * ate_m(&all, &tracks.truth)?,
        100.0 * ate_m(&live, &tracks.truth)?
    );
    Ok(())
}

/// CPU time of this thread so far, which does not count what else runs on the machine.
fn cpu_ms() -> Result<f64, Box<dyn Error>> {
    let time = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID)?;
    Ok(1e3 * time.tv_sec() as f64 + 1e-6 * time.tv_nsec() as f64)
}

/// How far an incremental solution is from a cold one.
#[derive(Clone, Copy, Default)]
struct Apart {
    /// Share of the cost that a cold solve takes away.
    cost: f64,
    /// Largest distance of a keyframe from where the cold solve has it.
    position_m: f64,
}

impl Apart {
    fn max(self, other: Self) -> Self {
        Self {
            cost: self.cost.max(other.cost),
            position_m: self.position_m.max(other.position_m),
        }
    }
}

/// Solves what has grown so far from where it is, to the last digit.
fn compare(
    growing: &Growing<'_>,
    keyframe: usize,
    report: &UpdateReport,
) -> Result<Apart, Box<dyn Error>> {
    let mut problem = growing.problem.snapshot();
    let config = SolveConfig {
        cost_tolerance: 1e-13,
        max_iterations: 200,
        diagnosis: Diagnosis::Off,
        ..SolveConfig::default()
    };
    let begun = cpu_ms()?;
    let cold = solve(&mut problem, &config)?;
    let cold_ms = cpu_ms()? - begun;
    let distances_m = (0..=keyframe).map(|k| {
        let from = growing.pose(k).translation;
        (growing.pose_in(&problem, k).translation - from).norm()
    });
    let apart = Apart {
        cost: growing.problem.cost() / cold.final_cost - 1.0,
        position_m: distances_m.fold(0.0, f64::max),
    };
    println!(
        "{:4} keyframes: cost {:.6}, {:.1e} above a cold solve's, {:.1e} m apart; cold {cold_ms:.1} ms, {} iterations; {report:?}",
        keyframe + 1,
        cold.final_cost,
        apart.cost,
        apart.position_m,
        cold.iterations,
    );
    Ok(apart)
}

/// Root mean square distance of poses from the truth after alignment.
fn ate_m(poses: &[StampedPose], truth: &Trajectory) -> Result<f64, Box<dyn Error>> {
    let (found, truth): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) = poses
        .iter()
        .filter_map(|pose| {
            let truth = truth.at(pose.time)?;
            Some((pose.world_from_rig.translation, truth.translation))
        })
        .unzip();
    let alignment = umeyama(&found, &truth, Scale::Fixed).ok_or("truth and poses do not meet")?;
    let squares = found
        .iter()
        .zip(&truth)
        .map(|(f, t)| (alignment.apply(f) - t).norm_squared());
    Ok((squares.sum::<f64>() / found.len() as f64).sqrt())
}
