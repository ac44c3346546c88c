//! Problems in BAL format with nothing left free, so that they have one optimum.

use lsfb_solver::{Diagnosis, Error, Report, SolveConfig, solve};

use crate::bal::BalProblem;

/// Holds the gauge, by the first camera's pose and the second one's translation along z, and solves until no step lowers
/// the cost any more.
pub fn solve_to_the_last_bit(bal: &mut BalProblem) -> Result<Report, Error> {
    hold_gauge(bal, 5)?;
    let config = SolveConfig {
        cost_tolerance: 0.0,
        step_tolerance: 0.0,
        gradient_tolerance: 0.0,
        max_iterations: 500,
        diagnosis: Diagnosis::Off,
        ..SolveConfig::default()
    };
    solve(&mut bal.problem, &config)
}

/// Holds the gauge by the first camera's pose and one component of the second one.
pub fn hold_gauge(bal: &mut BalProblem, component: usize) -> Result<(), Error> {
    let (first, second) = (bal.cameras[0], bal.cameras[1]);
    bal.problem
        .set_constant_components(first, &[0, 1, 2, 3, 4, 5])?;
    bal.problem.set_constant_components(second, &[component])
}
