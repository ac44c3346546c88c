//! The problem that grows, solved in both ways.

use lsfb_problems::walk::{Added, Target, Walk};
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
}

impl Grown {
    /// On one thread, as the peers.
    pub fn solve(arguments: &Arguments, context: &Context) -> anyhow::Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        pool.install(|| Self::solve_here(arguments, context))
    }

    fn solve_here(arguments: &Arguments, context: &Context) -> anyhow::Result<Self> {
        let keyframes = arguments.keyframes as usize;
        let walk = Walk::new(keyframes, arguments.points as usize, arguments.seed);
        let mut growing = Incremental::new(Problem::new(), IncrementalConfig::default())?;
        let mut added = Added::default();
        let (mut incremental, mut batch) = (Run::new("incremental"), Run::new("batch"));
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
                batch.updates.push(solve_whole(&walk, &added)?);
            }
        }
        Ok(Self {
            problem: walk.to_text(),
            points: walk.points,
            observations: walk.keyframes.iter().map(|k| k.seen.len()).sum(),
            incremental,
            batch,
        })
    }
}

/// Everything so far, from the values that its blocks began with.
fn solve_whole(walk: &Walk, added: &Added) -> anyhow::Result<Update> {
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
    let report = solve(&mut problem, &config)?;
    Ok(Update {
        keyframe: added.poses.len(),
        cpu_ms: cpu_ms()? - begun,
        cost: Some(report.final_cost),
    })
}
