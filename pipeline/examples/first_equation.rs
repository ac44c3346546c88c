//! Eq. (4) of the first round of a recording, solved as the mapping solves it, in turn with peers: cost after each step, CPU and wall time of
//! solving alone, set-up of the solver included.
//!
//! ```text
//! cargo run --release --workspace --example first_equation -- scan.mcap OUT THREADS TURNS ["PEER ARGUMENTS"]...
//! ```
//!
//! The terms are written to `OUT`; a peer is given `OUT THREADS` behind its own arguments. `benches/solver/README.md` has the recipe.

#![allow(clippy::print_stdout)] // a program, not a library

use std::error::Error;
use std::ops::ControlFlow;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use lsfb_pipeline::mapping::{MappingConfig, write_first_equation};
use lsfb_recording::Recording;
use lsfb_solver::{Diagnosis, Problem, SolveConfig, solve_controlled};
use lsfb_types::no_progress;
use nix::time::{ClockId, clock_gettime};

type Outcome = Result<(), Box<dyn Error>>;

fn main() -> Outcome {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [recording, out, threads, turns, peers @ ..] = arguments.as_slice() else {
        return Err("give a recording, a file, numbers of threads and turns, and peers".into());
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.parse()?);
    let pool = pool.build()?;
    let config = MappingConfig::default();
    let recording = Recording::open(Path::new(recording))?;
    let problem = write_first_equation(&recording, &config, Path::new(out), &no_progress)?;
    let config = SolveConfig {
        diagnosis: Diagnosis::Off,
        ..config.solver
    };
    for _ in 0..turns.parse::<usize>()? {
        pool.install(|| solve(problem.clone(), &config, threads))?;
        for peer in peers {
            let mut words = peer.split_whitespace();
            let program = words.next().ok_or("a peer has no name")?;
            let mut ran = Command::new(program);
            if !ran.args(words).args([out, threads]).status()?.success() {
                return Err(format!("{peer} failed").into());
            }
        }
    }
    Ok(())
}

fn solve(mut problem: Problem, config: &SolveConfig, threads: &str) -> Result<(), String> {
    let (cpu, wall) = (cpu_secs(), Instant::now());
    let mut steps = Vec::new();
    let report = solve_controlled(&mut problem, config, &mut |iteration| {
        steps.push((iteration.cost, wall.elapsed().as_secs_f64()));
        ControlFlow::Continue(())
    });
    let (cpu, wall) = (cpu_secs() - cpu, wall.elapsed().as_secs_f64());
    let report = report.map_err(|error| error.to_string())?;
    println!(
        "lsfb {:?}, {threads} threads: {} residuals, {} undefined, cost {:.9} -> {:.9}, {} steps, cpu {cpu:.3} s, wall {wall:.3} s",
        report.linear_solver,
        report.residuals,
        report.undefined_at_start,
        report.initial_cost,
        report.final_cost,
        steps.len(),
    );
    for (number, (cost, after_s)) in steps.iter().enumerate() {
        println!("  step {}: cost {cost:.9} after {after_s:.3} s", number + 1);
    }
    Ok(())
}

/// CPU time of this process, all threads, seconds.
fn cpu_secs() -> f64 {
    clock_gettime(ClockId::CLOCK_PROCESS_CPUTIME_ID)
        .map_or(f64::NAN, |t| t.tv_sec() as f64 + 1e-9 * t.tv_nsec() as f64)
}
