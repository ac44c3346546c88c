//! Solves the problems of `docs/figures.md` on one thread, and prints cost, CPU time and wall time of the solver alone:
//!
//! ```text
//! solve bal FILE[.gz] [auto|dense|sparse|iterative] [lm|dogleg]
//! solve bal-optimum FILE[.gz] OUT
//! solve pose-graph FILE.g2o[.gz]
//! solve stereo FOLDER [SUFFIX]
//! solve growing [KEYFRAMES] [POINTS] [MAP_PERCENT]
//! ```
//!
//! Peers are in `benches/solver/`.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

mod cost;
mod growing;
mod optimum;

use lsfb_problems::{bal, g2o, stereo};
use lsfb_solver::{Kernel, LinearSolver, Method, Problem, SolveConfig, solve};

type Outcome = Result<(), Box<dyn std::error::Error>>;

fn main() -> Outcome {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let argument = |k: usize| arguments.get(k).map(String::as_str);
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build_global()?;
    match (argument(0), argument(1)) {
        (Some("bal"), Some(path)) => {
            let config = SolveConfig {
                linear_solver: match argument(2) {
                    Some("dense") => LinearSolver::Dense,
                    Some("sparse") => LinearSolver::Sparse,
                    Some("iterative") => LinearSolver::Iterative,
                    _ => LinearSolver::Auto,
                },
                method: match argument(3) {
                    Some("dogleg") => Method::Dogleg,
                    _ => Method::LevenbergMarquardt,
                },
                ..SolveConfig::default()
            };
            let mut bal = bal::parse(&cost::read_text(path)?, Kernel::Squared)?;
            println!("{} cameras, {} points", bal.cameras.len(), bal.points.len());
            measure(&mut bal.problem, &config)
        }
        (Some("bal-optimum"), Some(path)) => optimum::run(
            path,
            argument(2).ok_or("usage: solve bal-optimum FILE OUT")?,
        ),
        (Some("pose-graph"), Some(path)) => {
            let mut graph = g2o::parse(&cost::read_text(path)?)?;
            println!("{} poses, {} edges", graph.poses.len(), graph.edges);
            // A pose graph starts near its optimum: full steps from the beginning.
            let config = SolveConfig {
                initial_damping: 1e-11,
                cost_tolerance: 1e-7,
                ..SolveConfig::default()
            };
            measure(&mut graph.problem, &config)
        }
        (Some("stereo"), Some(folder)) => {
            let suffix = argument(2).unwrap_or("00s.txt.gz");
            let read = |name: &str| cost::read_text(&format!("{folder}/{name}{suffix}"));
            let mut problem = stereo::parse(&stereo::Texts {
                calibration: read("VO_calibration")?,
                poses: read("VO_camera_poses")?,
                factors: read("VO_stereo_factors")?,
            })?;
            measure(&mut problem, &SolveConfig::default())
        }
        (Some("growing"), keyframes) => growing::run(
            keyframes.map_or(Ok(1000), str::parse)?,
            argument(2).map_or(Ok(60), str::parse)?,
            argument(3).map_or(Ok(0), str::parse)?,
        ),
        _ => Err("usage: solve bal|bal-optimum|pose-graph|stereo|growing INPUT ..".into()),
    }
}

fn measure(problem: &mut Problem, config: &SolveConfig) -> Outcome {
    let (began, clock) = (cost::cpu_secs(), std::time::Instant::now());
    let report = solve(problem, config)?;
    let (spent, wall) = (cost::cpu_secs() - began, clock.elapsed().as_secs_f64());
    println!(
        "lsfb {:?}: cost {:.9} -> {:.9}, {} iterations, {} refused, cpu {spent:.3} s, wall {wall:.3} s, peak {:.0} MB, condition {:.1e}",
        report.linear_solver,
        report.initial_cost,
        report.final_cost,
        report.iterations,
        report.refused_steps,
        cost::peak_mb(),
        report.condition.unwrap_or(f64::NAN),
    );
    for parameter in report.undetermined.iter().take(8) {
        println!("  {parameter}");
    }
    Ok(())
}
