//! Least squares that tell how far they are, and can be stopped.

use std::ops::ControlFlow;

use lsfb_solver::{Problem, Report, SolveConfig, Termination, solve_controlled};
use lsfb_types::{Progress, ProgressFn};

use crate::Error;

/// [`lsfb_solver::solve`] with a line of progress for each iteration.
pub(crate) fn solve_or_stop(
    stage: &'static str,
    problem: &mut Problem,
    config: &SolveConfig,
    progress: ProgressFn<'_>,
) -> Result<Report, Error> {
    let mut told = Ok(());
    let report = solve_controlled(problem, config, &mut |iteration| {
        told = progress(Progress {
            stage,
            done: iteration.number as u64,
            total: iteration.of as u64,
        });
        match told {
            Ok(()) => ControlFlow::Continue(()),
            Err(_) => ControlFlow::Break(()),
        }
    })?;
    told?;
    Ok(report)
}

/// Iterations after which a solve that still goes on is given up.
const MOST_ITERATIONS: usize = 3000;

/// [`solve_or_stop`], taken up again until it stops for another reason than the number of iterations: no result depends on that.
/// [`Error::NotConverged`] where it never does.
pub(crate) fn solve_until_converged(
    stage: &'static str,
    problem: &mut Problem,
    config: &SolveConfig,
    progress: ProgressFn<'_>,
) -> Result<Report, Error> {
    let mut report = solve_or_stop(stage, problem, config, progress)?;
    while report.termination == Termination::MaxIterations {
        if report.iterations >= MOST_ITERATIONS || config.max_iterations == 0 {
            return Err(Error::NotConverged {
                stage,
                iterations: report.iterations,
            });
        }
        let next = solve_or_stop(stage, problem, config, progress)?;
        report = Report {
            initial_cost: report.initial_cost,
            iterations: report.iterations + next.iterations,
            ..next
        };
    }
    Ok(report)
}
