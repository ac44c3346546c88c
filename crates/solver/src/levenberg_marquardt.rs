use serde::{Deserialize, Serialize};

use crate::Error;
use crate::evaluation::{Evaluation, not_finite};
use crate::layout::{Layout, Place};
use crate::problem::{Problem, Role};
use crate::reduced::Factorization;
use crate::schur::{NormalEquations, ReducedSystem, Step};

/// When to stop, and how carefully to begin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolveConfig {
    /// Linearizations at most.
    pub max_iterations: usize,
    /// Stop once a step lowers the cost by less than this share.
    pub cost_tolerance: f64,
    /// Stop once no entry of the gradient is larger.
    pub gradient_tolerance: f64,
    /// Stop once a step is shorter than this share of the values.
    pub step_tolerance: f64,
    /// First damping, as a share of the normal matrix's diagonal.
    pub initial_damping: f64,
}

impl Default for SolveConfig {
    fn default() -> Self {
        Self {
            max_iterations: 50,
            cost_tolerance: 1e-6,
            gradient_tolerance: 1e-10,
            step_tolerance: 1e-8,
            initial_damping: 1e-4,
        }
    }
}

impl SolveConfig {
    fn check(&self) -> Result<(), Error> {
        let non_negative = [
            ("cost_tolerance", self.cost_tolerance),
            ("gradient_tolerance", self.gradient_tolerance),
            ("step_tolerance", self.step_tolerance),
        ];
        for (name, value) in non_negative {
            if !(value >= 0.0) {
                return Err(Error::Config {
                    name,
                    value,
                    expected: "0 or more",
                });
            }
        }
        if !(self.initial_damping > 0.0 && self.initial_damping.is_finite()) {
            return Err(Error::Config {
                name: "initial_damping",
                value: self.initial_damping,
                expected: "more than 0",
            });
        }
        Ok(())
    }
}

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
    /// No free block has a residual.
    NothingFree,
}

/// What the solver did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// `½ Σ ρ` at the starting values.
    pub initial_cost: f64,
    /// `½ Σ ρ` at the values it left.
    pub final_cost: f64,
    /// Linearizations.
    pub iterations: usize,
    /// Steps that were tried and refused.
    pub refused_steps: usize,
    /// Why it stopped.
    pub termination: Termination,
    /// Largest entry of the gradient at the last linearization.
    pub gradient_max_norm: f64,
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
}

/// State after an iteration, for those who watch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Number, from 1.
    pub number: usize,
    /// Iterations at most.
    pub of: usize,
    /// Cost after it.
    pub cost: f64,
    /// Damping for the next one.
    pub damping: f64,
}

/// Dampings beyond which a step no longer moves anything.
const LARGEST_DAMPING: f64 = 1e20;
const SMALLEST_DAMPING: f64 = 1e-14;

/// Minimises `½ Σ ρ(‖r‖²)` over the free blocks by Levenberg–Marquardt; the problem holds the result.
///
/// The same problem gives the same bits on any number of threads. After an error the values are those of the start.
pub fn solve(problem: &mut Problem, config: &SolveConfig) -> Result<Report, Error> {
    solve_observed(problem, config, &mut |_| {})
}

/// [`solve`], telling `observe` after each iteration.
pub fn solve_observed(
    problem: &mut Problem,
    config: &SolveConfig,
    observe: &mut dyn FnMut(&Iteration),
) -> Result<Report, Error> {
    config.check()?;
    for (block, entry) in problem.blocks.iter().enumerate() {
        let stored = &problem.values[entry.start..entry.start + entry.shape.stored];
        if !stored.iter().all(|x| x.is_finite()) {
            return Err(Error::BlockNotFinite { block });
        }
    }
    let layout = Layout::new(problem)?;
    let mut evaluation = Evaluation::new(problem, &layout);
    let start = evaluation.start(problem, &layout);
    if let Some(k) = start.not_finite {
        return Err(not_finite(problem, k));
    }
    let mut report = Report {
        initial_cost: start.cost,
        final_cost: start.cost,
        iterations: 0,
        refused_steps: 0,
        termination: Termination::MaxIterations,
        gradient_max_norm: 0.0,
        residuals: problem.residuals.len(),
        undefined_at_start: evaluation.active.iter().filter(|a| !**a).count(),
        undefined_at_end: 0,
        untouched_blocks: untouched(problem, &layout),
        reduced_dimension: layout.dimension(),
        eliminated_points: layout.points.len(),
    };
    if layout.reduced.is_empty() && layout.points.is_empty() {
        report.termination = Termination::NothingFree;
        return Ok(report);
    }
    let values = minimise(problem, &layout, config, evaluation, &mut report, observe)?;
    problem.values = values;
    Ok(report)
}

fn untouched(problem: &Problem, layout: &Layout) -> usize {
    problem
        .blocks
        .iter()
        .zip(&layout.places)
        .filter(|(block, place)| block.role != Role::Constant && **place == Place::Constant)
        .count()
}

fn minimise(
    problem: &Problem,
    layout: &Layout,
    config: &SolveConfig,
    mut evaluation: Evaluation,
    report: &mut Report,
    observe: &mut dyn FnMut(&Iteration),
) -> Result<Vec<f64>, Error> {
    let mut normal = NormalEquations::new(layout);
    let mut system = ReducedSystem::new(layout);
    let mut factorization = Factorization::new(layout)?;
    let mut step = Step::new(layout);
    let mut values = problem.values.clone();
    let mut trial_values = values.clone();
    let mut trial_costs = evaluation.costs.clone();
    // Nielsen's rule: damping falls smoothly with the quality of the step, and grows ever faster while steps fail.
    let (mut damping, mut growth) = (config.initial_damping, 2.0);

    while report.iterations < config.max_iterations {
        evaluation.linearize(problem, layout, &values)?;
        normal.assemble(problem, layout, &evaluation.records);
        report.iterations += 1;
        report.undefined_at_end = evaluation.undefined;
        report.gradient_max_norm = normal.gradient_max_norm();
        if report.gradient_max_norm <= config.gradient_tolerance {
            report.termination = Termination::GradientTolerance;
            return Ok(values);
        }
        loop {
            if damping > LARGEST_DAMPING {
                report.termination = Termination::NoDecrease;
                return Ok(values);
            }
            normal.reduce(layout, damping, &mut system);
            if factorization.factor(layout, &system.matrix) {
                step.reduced.copy_from_slice(&system.right_side);
                factorization.solve(&mut step.reduced);
                normal.back_substitute(layout, &system, &mut step);
                let length = step.length();
                if length <= config.step_tolerance * (norm(&values) + config.step_tolerance) {
                    // Short from the start of this iteration, or only after longer steps were refused?
                    report.termination = if growth > 2.0 {
                        Termination::NoDecrease
                    } else {
                        Termination::StepTolerance
                    };
                    return Ok(values);
                }
                step.apply(problem, layout, &values, &mut trial_values);
                let trial = evaluation.total(problem, layout, &trial_values, &mut trial_costs);
                let decrease = report.final_cost - trial.cost;
                let quality = decrease / normal.predicted_decrease(&step, damping);
                if decrease > 0.0 && quality > 1e-3 {
                    let share = decrease / report.final_cost;
                    std::mem::swap(&mut values, &mut trial_values);
                    std::mem::swap(&mut evaluation.costs, &mut trial_costs);
                    report.final_cost = trial.cost;
                    let factor = (1.0 - (2.0 * quality - 1.0).powi(3)).clamp(1.0 / 3.0, 2.0);
                    damping = (damping * factor).max(SMALLEST_DAMPING);
                    growth = 2.0;
                    observe(&Iteration {
                        number: report.iterations,
                        of: config.max_iterations,
                        cost: trial.cost,
                        damping,
                    });
                    if share <= config.cost_tolerance {
                        report.termination = Termination::CostTolerance;
                        return Ok(values);
                    }
                    break;
                }
            }
            report.refused_steps += 1;
            damping *= growth;
            growth *= 2.0;
        }
    }
    Ok(values)
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|x| x * x).sum::<f64>().sqrt()
}

impl Step {
    fn new(layout: &Layout) -> Self {
        Self {
            reduced: vec![0.0; layout.dimension()],
            points: vec![Default::default(); layout.points.len()],
        }
    }

    fn length(&self) -> f64 {
        let points: f64 = self.points.iter().map(|p| p.norm_squared()).sum();
        (self.reduced.iter().map(|x| x * x).sum::<f64>() + points).sqrt()
    }

    fn apply(&self, problem: &Problem, layout: &Layout, values: &[f64], moved: &mut [f64]) {
        let mut move_block = |block: usize, delta: &[f64]| {
            let entry = &problem.blocks[block];
            let range = entry.start..entry.start + entry.shape.stored;
            (entry.plus)(&values[range.clone()], delta, &mut moved[range]);
        };
        for (i, block) in layout.reduced.iter().enumerate() {
            let rows = layout.row_start[i]..layout.row_start[i + 1];
            move_block(*block, &self.reduced[rows]);
        }
        for (block, delta) in layout.points.iter().zip(&self.points) {
            move_block(*block, delta.as_slice());
        }
    }
}
