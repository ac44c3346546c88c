//! Least squares that tell how far they are, and can be stopped.

use std::ops::ControlFlow;

use lsfb_solver::{
    Diagnosis, Iteration, Problem, Report, SolveConfig, solve_controlled,
    solve_until_converged_controlled,
};
use lsfb_types::{Progress, ProgressFn, Stopped};

use crate::{Error, Refusal};

/// Tells progress, and remembers the answer.
struct Told<'a> {
    stage: &'static str,
    progress: ProgressFn<'a>,
    answer: Result<(), Stopped>,
}

impl<'a> Told<'a> {
    fn new(stage: &'static str, progress: ProgressFn<'a>) -> Self {
        Self {
            stage,
            progress,
            answer: Ok(()),
        }
    }

    fn iteration(&mut self, iteration: &Iteration) -> ControlFlow<()> {
        self.answer = (self.progress)(Progress {
            stage: self.stage,
            done: iteration.number as u64,
            total: iteration.of as u64,
        });
        match self.answer {
            Ok(()) => ControlFlow::Continue(()),
            Err(_) => ControlFlow::Break(()),
        }
    }
}

/// What is determined by how much is asked by whoever computes covariances; of a long walk it takes longer than to solve it.
fn undiagnosed(config: &SolveConfig) -> SolveConfig {
    SolveConfig {
        diagnosis: Diagnosis::Off,
        ..*config
    }
}

/// [`lsfb_solver::solve`] with a line of progress for each iteration.
pub(crate) fn solve_or_stop(
    stage: &'static str,
    problem: &mut Problem,
    config: &SolveConfig,
    progress: ProgressFn<'_>,
) -> Result<Report, Error> {
    let mut told = Told::new(stage, progress);
    let report = solve_controlled(problem, &undiagnosed(config), &mut |i| told.iteration(i))?;
    told.answer?;
    Ok(report)
}

/// [`lsfb_solver::solve_until_converged`], likewise. [`Refusal::NotConverged`] where it never does.
pub(crate) fn solve_until_converged(
    stage: &'static str,
    problem: &mut Problem,
    config: &SolveConfig,
    progress: ProgressFn<'_>,
) -> Result<Report, Error> {
    let mut told = Told::new(stage, progress);
    let config = undiagnosed(config);
    let report = solve_until_converged_controlled(problem, &config, &mut |i| told.iteration(i));
    told.answer?;
    report.map_err(|error| match error {
        lsfb_solver::Error::NotConverged { iterations } => {
            Error::Refused(Refusal::NotConverged { stage, iterations })
        }
        other => other.into(),
    })
}
