//! Least squares that tell how far they are, and can be stopped.

use std::ops::ControlFlow;

use lsfb_solver::{Problem, Report, SolveConfig, solve_controlled};
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
