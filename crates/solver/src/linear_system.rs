use crate::conjugate_gradients::ConjugateGradients;
use crate::factorization::{Dense, Factorization, Sparse};
use crate::layout::{Layout, Pattern};
use crate::normal::{NormalEquations, ReducedSystem, Step};
use crate::{Error, LinearSolver, SolveConfig};

/// The damped normal equations and the way they are solved.
pub(crate) struct LinearSystem {
    pub reduced: ReducedSystem,
    pub solver: Solver,
    /// Damping of the factor, if it is one of the present linearization.
    pub factored: Option<f64>,
}

pub(crate) enum Solver {
    Direct(Factorization),
    Iterative(ConjugateGradients),
}

impl LinearSystem {
    /// Chooses the solver, and completes the layout as it needs.
    pub fn new(layout: &mut Layout, config: &SolveConfig) -> Result<Self, Error> {
        let solver = match config.linear_solver {
            LinearSolver::Iterative => None,
            LinearSolver::Dense => {
                layout.couple(Pattern::SchurComplement)?;
                Some(Factorization::Dense(Dense::new(layout)?))
            }
            LinearSolver::Sparse => {
                layout.couple(Pattern::SchurComplement)?;
                Some(Factorization::Sparse(Box::new(Sparse::new(layout)?)))
            }
            LinearSolver::Auto => direct_within(layout, config.max_matrix_bytes)?,
        };
        let solver = match solver {
            Some(factorization) => Solver::Direct(factorization),
            None => {
                layout.couple(Pattern::Hessian)?;
                Solver::Iterative(ConjugateGradients::new(
                    layout,
                    config.iterative_tolerance,
                    config.max_iterative_steps,
                ))
            }
        };
        Ok(Self {
            reduced: ReducedSystem::new(layout),
            solver,
            factored: None,
        })
    }

    /// Whether steps solve the damped equations to the precision of the numbers.
    pub fn is_exact(&self) -> bool {
        matches!(self.solver, Solver::Direct(_))
    }

    pub fn kind(&self) -> LinearSolver {
        match &self.solver {
            Solver::Direct(Factorization::Dense(_)) => LinearSolver::Dense,
            Solver::Direct(Factorization::Sparse(_)) => LinearSolver::Sparse,
            Solver::Iterative(_) => LinearSolver::Iterative,
        }
    }

    /// Solves `(H + λ diag H) δ = −g`; `false` where the matrix is not positive definite.
    pub fn solve(
        &mut self,
        normal: &NormalEquations,
        layout: &Layout,
        lambda: f64,
        step: &mut Step,
    ) -> bool {
        self.factored = None;
        match &mut self.solver {
            Solver::Direct(factorization) => {
                normal.reduce(layout, lambda, &mut self.reduced);
                if !factorization.factor(layout, &self.reduced.matrix) {
                    return false;
                }
                step.reduced.copy_from_slice(&self.reduced.right_side);
                factorization.solve(&mut step.reduced);
                // A pivot that is not a number goes through a factorization unnoticed.
                if !step.reduced.iter().fold(true, |all, x| all & x.is_finite()) {
                    return false;
                }
                self.factored = Some(lambda);
            }
            Solver::Iterative(gradients) => {
                normal.reduce_right_side(layout, lambda, &mut self.reduced);
                let solved =
                    gradients.solve(normal, layout, lambda, &self.reduced, &mut step.reduced);
                if !solved {
                    return false;
                }
            }
        }
        normal.back_substitute(layout, &self.reduced.point_inverse, step);
        true
    }
}

/// A direct solver, if matrix and factor keep within `bytes`.
fn direct_within(layout: &mut Layout, bytes: usize) -> Result<Option<Factorization>, Error> {
    let entries = bytes / size_of::<f64>();
    if layout.count_matrix_values() > entries / 2 {
        return Ok(None);
    }
    layout.couple(Pattern::SchurComplement)?;
    if Factorization::prefers_dense(layout) {
        if layout.dimension().saturating_pow(2) <= entries {
            return Ok(Some(Factorization::Dense(Dense::new(layout)?)));
        }
        return Ok(None);
    }
    let sparse = Sparse::new_within(layout, entries)?;
    Ok(sparse.map(|sparse| Factorization::Sparse(Box::new(sparse))))
}
