use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{BlockId, LinearSolver};

/// Why the solver stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Termination {
    /// Every entry of the gradient is small: a stationary point.
    GradientTolerance,
    /// The last step hardly lowered the cost.
    CostTolerance,
    /// The last step hardly moved.
    StepTolerance,
    /// No step lowers the cost, however short: a minimum to the precision of the numbers.
    NoDecrease,
    /// Out of iterations; more may help.
    MaxIterations,
    /// The observer said so: cancelled, or out of time.
    Stopped,
    /// No free block has a residual.
    NothingFree,
}

/// A parameter that could be anything as far as the data goes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Undetermined {
    /// The block.
    pub block: BlockId,
    /// Component of its tangent.
    pub component: usize,
    /// What [`crate::Problem::set_name`] calls the block.
    pub block_name: String,
    /// What the component is called.
    pub component_name: String,
}

impl fmt::Display for Undetermined {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} {} is not determined by this data",
            self.block_name, self.component_name
        )
    }
}

/// What the solver did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// `½ Σ ρ` at the starting values.
    pub initial_cost: f64,
    /// `½ Σ ρ` at the values it left.
    pub final_cost: f64,
    /// Linearizations.
    pub iterations: usize,
    /// Those among them that narrowed the kernels of a graduated solve.
    pub graduation_steps: usize,
    /// Steps that were tried and refused.
    pub refused_steps: usize,
    /// Why it stopped.
    pub termination: Termination,
    /// Largest entry of the gradient at the last linearization.
    pub gradient_max_norm: f64,
    /// Length of the last step, in tangent units.
    pub step_norm: f64,
    /// Residuals in the problem.
    pub residuals: usize,
    /// Residuals left out because they were undefined at the starting values.
    pub undefined_at_start: usize,
    /// Residuals that had become undefined by the last linearization.
    pub undefined_at_end: usize,
    /// Free blocks without a residual, which stayed where they were.
    pub untouched_blocks: usize,
    /// Rows of the reduced system.
    pub reduced_dimension: usize,
    /// Points eliminated.
    pub eliminated_points: usize,
    /// How the reduced system was solved; never [`LinearSolver::Auto`].
    pub linear_solver: LinearSolver,
    /// Condition of the reduced matrix, its parameters scaled by what is known of each alone. `None` where it was not
    /// asked for, or the matrix never formed.
    pub condition: Option<f64>,
    /// Parameters that the data does not determine, as far as they were asked for: one for each dimension in which
    /// the values could move at no cost, 64 at most.
    pub undetermined: Vec<Undetermined>,
}

/// State after a step, for those who watch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Number, from 1.
    pub number: usize,
    /// Iterations at most.
    pub of: usize,
    /// Cost after it.
    pub cost: f64,
    /// Damping for the next one; with dogleg the inverse of the radius.
    pub damping: f64,
    /// Largest entry of the gradient before it.
    pub gradient_max_norm: f64,
    /// Length of the step.
    pub step_norm: f64,
}
