//! The problem that grows, solved in both ways.

use lsfb_geometry::Se3;
use lsfb_problems::walk::{Added, Target, Walk, farthest_m, solve_to_the_last_digit};
use lsfb_solver::{Diagnosis, Incremental, IncrementalConfig, Problem, SolveConfig, solve};
use lsfb_types::Progress;

use super::Arguments;
use super::runs::{Run, Update};
use crate::commands::bench::cpu_time::cpu_ms;
use crate::context::Context;

/// What was solved, and what it cost.
pub struct Grown {
    /// The problem for other programs.
    pub problem: String,
    pub points: usize,
    pub observations: usize,
    pub incremental: Run,
    pub batch: Run,
    /// Largest distance of a pose from where the optimum has it, wherever all was solved from scratch.
    pub poses_apart_m: f64,
}

impl Grown {
    /// On one thread, as the peers.
    pub fn solve(arguments: &Arguments, context: &Context) -> anyhow::Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        pool.install(|| Self::solve_here(arguments, context))
    }

    fn solve_here(arguments: &Arguments, context: &Context) -> anyhow::Result<Self> {
        let keyframes = arguments.keyframes as usize;
        let points = arguments.points as usize;
        let walk = Walk::in_map(keyframes, points, arguments.map_percent, arguments.seed);
        let mut growing = Incremental::new(Problem::new(), IncrementalConfig::default())?;
        let mut added = Added::default();
        let (mut incremental, mut batch) = (Run::new("incremental"), Run::new("batch"));
        let mut poses_apart_m = 0.0_f64;
        for k in 0..keyframes {
            context.show(Progress {
                stage: "solving keyframe by keyframe",
                done: k as u64,
                total: keyframes as u64,
            })?;
            added.add(&walk, &mut Target::Growing(&mut growing), None)?;
            let begun = cpu_ms()?;
            growing.update()?;
            let cpu_ms_of_update = cpu_ms()? - begun;
            incremental.updates.push(Update {
                keyframe: k + 1,
                cpu_ms: cpu_ms_of_update,
                cost: Some(growing.cost()),
            });
            if (k + 1) % arguments.batch_every as usize == 0 || k + 1 == keyframes {
                let (update, poses) = solve_whole(&walk, &added)?;
                batch.updates.push(update);
                let ours = added.poses.iter().map(|block| growing.value(*block));
                poses_apart_m = poses_apart_m.max(farthest_m(ours.zip(poses)));
            }
        }
        anyhow::ensure!(
            poses_apart_m.is_finite(),
            "the incremental solution, or that from scratch, has a pose that is not a number"
        );
        Ok(Self {
            problem: walk.to_text(),
            points: walk.points,
            observations: walk.keyframes.iter().map(|k| k.seen.len()).sum(),
            incremental,
            batch,
            poses_apart_m,
        })
    }
}

/// Everything so far, from the values that its blocks began with; and, which is not timed, where the optimum has the poses.
fn solve_whole(walk: &Walk, added: &Added) -> anyhow::Result<(Update, Vec<Se3>)> {
    let mut problem = Problem::new();
    let mut again = Added::default();
    for _ in 0..added.poses.len() {
        again.add(walk, &mut Target::Whole(&mut problem), Some(added))?;
    }
    let config = SolveConfig {
        cost_tolerance: 1e-12,
        max_iterations: 100,
        diagnosis: Diagnosis::Off,
        ..SolveConfig::default()
    };
    let begun = cpu_ms()?;
    solve(&mut problem, &config)?;
    let cpu_ms = cpu_ms()? - begun;
    let optimum = solve_to_the_last_digit(&mut problem)?;
    let update = Update {
        keyframe: added.poses.len(),
        cpu_ms,
        cost: Some(optimum),
    };
    let poses = again.poses.iter().map(|pose| problem.value(*pose));
    Ok((update, poses.collect()))
}
