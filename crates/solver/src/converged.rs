//! Minimising until nothing is left to gain: no result depends on the number of iterations that somebody set.

use std::ops::ControlFlow;

use crate::{Error, Iteration, Problem, Report, SolveConfig, Termination, solve_controlled};

/// Iterations after which a solve that still goes on is given up.
const MOST_ITERATIONS: usize = 3000;

/// [`crate::solve`], taken up again until nothing is left to gain.
pub fn solve_until_converged(problem: &mut Problem, config: &SolveConfig) -> Result<Report, Error> {
    solve_until_converged_controlled(problem, config, &mut |_| ControlFlow::Continue(()))
}

/// [`solve_controlled`], taken up again until it ends for another reason than [`SolveConfig::max_iterations`]; the damping begins anew each time.
/// [`Error::NotConverged`] where it never does: the problem then holds the best values found, which are no minimum.
pub fn solve_until_converged_controlled(
    problem: &mut Problem,
    config: &SolveConfig,
    control: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Report, Error> {
    let mut report = solve_controlled(problem, config, control)?;
    while report.termination == Termination::MaxIterations {
        let iterations = report.iterations;
        if iterations >= MOST_ITERATIONS || config.max_iterations == 0 {
            return Err(Error::NotConverged { iterations });
        }
        let next = solve_controlled(problem, config, control)?;
        report = Report {
            initial_cost: report.initial_cost,
            iterations: iterations + next.iterations,
            ..next
        };
    }
    Ok(report)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;
    use crate::{Kernel, Linearization, Parameters, Residual, Shape, Undefined, solve};

    /// Rosenbrock's valley, `(1 − x, 10 (y − x²))`, along which steps are short.
    struct Valley;

    impl Residual for Valley {
        fn dimension(&self) -> usize {
            2
        }

        fn blocks(&self) -> &[Shape] {
            const { &[Shape::of::<Vector2<f64>>()] }
        }

        fn evaluate(
            &self,
            parameters: &Parameters<'_>,
            out: &mut Linearization<'_>,
        ) -> Result<(), Undefined> {
            let v: Vector2<f64> = parameters.get(0);
            out.set_residual(&Vector2::new(1.0 - v.x, 10.0 * (v.y - v.x * v.x)));
            out.set_jacobian(0, &Matrix2::new(-1.0, 0.0, -20.0 * v.x, 10.0));
            Ok(())
        }
    }

    #[test]
    fn the_limit_of_iterations_decides_nothing() {
        let config = SolveConfig {
            max_iterations: 3,
            ..SolveConfig::default()
        };
        let solved = |to_the_end: bool| {
            let mut problem = Problem::new();
            let block = problem.add_block(Vector2::new(-1.2, 1.0));
            let added = problem.add_residual(Valley, &[block.id()], Kernel::Squared);
            added.expect("a residual");
            let report = match to_the_end {
                true => solve_until_converged(&mut problem, &config),
                false => solve(&mut problem, &config),
            };
            (report.expect("solved"), problem.value(block))
        };
        let (report, value) = solved(false);
        assert_eq!(report.termination, Termination::MaxIterations);
        assert!((value - Vector2::new(1.0, 1.0)).norm() > 0.1, "{value}");
        let (report, value) = solved(true);
        assert!(report.iterations > 3, "{report:?}");
        assert!((value - Vector2::new(1.0, 1.0)).norm() < 1e-6, "{value}");
    }
}
