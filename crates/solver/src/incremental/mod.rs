//! Problems that grow: each update touches what is new, what moves because of it, and nothing else.

mod factor;
mod linearized;

use std::collections::BTreeSet;

use lsfb_geometry::Vector3;
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

use crate::minimise::move_block;
use crate::problem::Role;
use crate::{
    Block, BlockId, Error, Kernel, Manifold, Problem, Residual, ResidualId, SolveConfig, solve,
};
use factor::{Factor, System};
use linearized::Linearized;

/// How exact an incremental solution is kept.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IncrementalConfig {
    /// A block is linearized anew once it has moved by more than this, in standard deviations that it would have if all
    /// else were known.
    pub relinearize_above: f64,
    /// A change is passed on to blocks that depend on it if it is more than this, in the same unit.
    pub propagate_above: f64,
    /// Rounds of an update at most.
    pub max_rounds: usize,
    /// Share of the diagonal that is added to it, so that what is not determined yet stays where it is.
    pub damping: f64,
    /// For the cold solve that takes over where a round raises the cost.
    pub solve: SolveConfig,
}

impl Default for IncrementalConfig {
    fn default() -> Self {
        Self {
            relinearize_above: 1e-2,
            propagate_above: 2e-3,
            max_rounds: 40,
            damping: 1e-9,
            solve: SolveConfig {
                cost_tolerance: 1e-9,
                diagnosis: crate::Diagnosis::Off,
                ..SolveConfig::default()
            },
        }
    }
}

lsfb_types::bounds! {
    IncrementalConfig {
        relinearize_above: number(Bounds::NOT_NEGATIVE),
        propagate_above: number(Bounds::NOT_NEGATIVE),
        max_rounds: any,
        damping: number(Bounds::NOT_NEGATIVE),
        solve: section,
    }
}

/// Blocks that took their step in a round.
struct Moved {
    /// Cost that their residuals may have now.
    limit: f64,
    /// Old numbers, and where they belong.
    saved: Vec<(usize, Vec<f64>)>,
}

/// What an update did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UpdateReport {
    /// Rounds until nothing moved any more.
    pub rounds: usize,
    /// Whether nothing moved after the last round.
    pub converged: bool,
    /// Residuals linearized, all rounds together.
    pub relinearized_residuals: usize,
    /// Columns of blocks factored, all rounds together.
    pub factored_columns: usize,
    /// Columns of the factor.
    pub columns: usize,
    /// Whether a cold solve took over.
    pub solved_cold: bool,
}

/// A problem that grows, kept solved.
///
/// The factor of the reduced system is kept in the order in which blocks were last given residuals: a new keyframe only
/// reaches the columns of those it shares something with. Eliminated points, linearizations and columns that a change
/// does not reach are used as they are. Updates are as exact as their thresholds; [`Incremental::cost`] is that of a
/// cold solve far within 1e-6 of it.
pub struct Incremental {
    problem: Problem,
    config: IncrementalConfig,
    linearized: Linearized,
    factor: Factor,
    /// Residuals to linearize, and blocks whose residuals changed, before the next update.
    new_residuals: BTreeSet<usize>,
    touched: BTreeSet<usize>,
    /// Blocks that new residuals read.
    structural: BTreeSet<usize>,
}

impl Incremental {
    /// Takes a problem over, solved or not.
    pub fn new(problem: Problem, config: IncrementalConfig) -> Result<Self, Error> {
        config.check_bounds("")?;
        let mut incremental = Self {
            linearized: Linearized::default(),
            factor: Factor::default(),
            new_residuals: BTreeSet::new(),
            touched: BTreeSet::new(),
            structural: BTreeSet::new(),
            problem,
            config,
        };
        incremental.restart();
        Ok(incremental)
    }

    /// [`Problem::add_block`].
    pub fn add_block<M: Manifold>(&mut self, value: M) -> Block<M> {
        self.problem.add_block(value)
    }

    /// [`Problem::add_eliminated_point`].
    pub fn add_eliminated_point(&mut self, point: Vector3<f64>) -> Block<Vector3<f64>> {
        self.problem.add_eliminated_point(point)
    }

    /// [`Problem::add_residual`].
    pub fn add_residual(
        &mut self,
        residual: impl Residual + 'static,
        blocks: &[BlockId],
        kernel: Kernel,
    ) -> Result<ResidualId, Error> {
        let id = self.problem.add_residual(residual, blocks, kernel)?;
        self.new_residuals.insert(id.0);
        self.structural.extend(blocks.iter().map(|b| b.0));
        Ok(id)
    }

    /// [`Problem::remove_residual`].
    pub fn remove_residual(&mut self, residual: ResidualId) {
        if self
            .problem
            .residuals
            .get(residual.0)
            .is_none_or(|entry| entry.residual.is_none())
        {
            return;
        }
        self.problem.remove_residual(residual);
        self.new_residuals.remove(&residual.0);
        for block in self.problem.blocks_of(residual) {
            self.linearized.forget(residual.0, block.0);
            self.touched.insert(block.0);
        }
    }

    /// [`Problem::remove_block`].
    pub fn remove_block<M>(&mut self, block: Block<M>) {
        let pending = self.new_residuals.iter().copied();
        let residuals: Vec<usize> = self
            .linearized
            .residuals_of(block.id().0)
            .iter()
            .copied()
            .chain(pending.filter(|k| {
                let blocks = self.problem.blocks_of(ResidualId(*k));
                blocks.contains(&block.id())
            }))
            .collect();
        for k in residuals {
            self.remove_residual(ResidualId(k));
        }
        self.problem.retire(block.id());
    }

    /// [`Problem::set_constant`]; the next update starts anew.
    pub fn set_constant<M>(&mut self, block: Block<M>) {
        self.commit();
        self.problem.set_constant(block);
        self.restart();
    }

    /// [`Problem::set_free`]; the next update starts anew.
    pub fn set_free<M>(&mut self, block: Block<M>) {
        self.commit();
        self.problem.set_free(block);
        self.restart();
    }

    /// The present estimate of a block.
    pub fn value<M: Manifold>(&self, block: Block<M>) -> M {
        let mut stored = vec![0.0; M::STORED];
        let entry = &self.problem.blocks[block.id().0];
        let values = &self.problem.values[entry.start..entry.start + M::STORED];
        match self.linearized.step.get(block.id().0) {
            Some(step) if !step.is_empty() => {
                let mut delta = vec![0.0; M::TANGENT];
                for (k, d) in step.iter().enumerate() {
                    delta[entry.component(k)] = *d;
                }
                (entry.plus)(values, &delta, &mut stored);
            }
            _ => stored.copy_from_slice(values),
        }
        M::load(&stored)
    }

    /// `½ Σ ρ` at the present estimate: looks at every residual.
    pub fn cost(&self) -> f64 {
        let values = self.estimate();
        (0..self.problem.residuals.len())
            .filter_map(|k| self.linearized.cost_at(&self.problem, k, &values))
            .sum()
    }

    /// A copy of the problem at the present estimate.
    pub fn snapshot(&self) -> Problem {
        let mut problem = self.problem.clone();
        problem.values = self.estimate();
        problem
    }

    /// The problem at the present estimate.
    pub fn into_problem(mut self) -> Problem {
        self.commit();
        self.problem
    }

    fn estimate(&self) -> Vec<f64> {
        let mut values = self.problem.values.clone();
        for (block, step) in self.linearized.step.iter().enumerate() {
            if !step.is_empty() {
                move_block(
                    &self.problem,
                    block,
                    step,
                    &self.problem.values,
                    &mut values,
                );
            }
        }
        values
    }

    fn commit(&mut self) {
        self.problem.values = self.estimate();
        self.linearized.step.iter_mut().for_each(|s| s.fill(0.0));
    }

    /// Forgets everything but the problem.
    fn restart(&mut self) {
        self.linearized = Linearized::default();
        self.factor = Factor::default();
        self.touched.clear();
        self.new_residuals = (0..self.problem.residuals.len())
            .filter(|k| self.problem.residuals[*k].residual.is_some())
            .collect();
        self.structural = (0..self.problem.blocks.len())
            .filter(|b| matches!(self.problem.blocks[*b].role, Role::Free | Role::Eliminated))
            .collect();
    }

    /// Takes in what was added and removed since the last update, and solves.
    ///
    /// After an error all of it is still to be taken in: the next update ends with the same one unless its cause was removed.
    pub fn update(&mut self) -> Result<UpdateReport, Error> {
        let mut report = UpdateReport::default();
        if !self.problem.bounds.is_empty() {
            // Rounds know no bounds: every update is a cold solve.
            self.commit();
            self.solve_cold(&mut report)?;
            return Ok(report);
        }
        let updated = self.run_rounds(&mut report);
        if updated.is_err() {
            self.commit();
            self.restart();
        }
        updated.map(|()| report)
    }

    fn run_rounds(&mut self, report: &mut UpdateReport) -> Result<(), Error> {
        self.linearized.grow(&self.problem);
        let mut residuals = std::mem::take(&mut self.new_residuals);
        let mut touched = std::mem::take(&mut self.touched);
        self.linearized.check_new(&self.problem, &residuals)?;
        let mut order = self.next_order();
        let mut before: Option<Moved> = None;
        while report.rounds < self.config.max_rounds {
            report.rounds += 1;
            report.relinearized_residuals += residuals.len();
            let cost = self.linearized.linearize(&self.problem, &residuals)?;
            if let Some(moved) = before.take()
                && !(cost <= moved.limit)
            {
                for (start, values) in moved.saved {
                    self.problem.values[start..start + values.len()].copy_from_slice(&values);
                }
                return self.solve_cold(report);
            }
            let affected = self
                .linearized
                .eliminate(&self.problem, &residuals, &touched);
            touched.clear();
            let system = System {
                matrix: &self.linearized.matrix,
                right_side: &self.linearized.right_side,
                damping: self.config.damping,
            };
            let kept = std::mem::take(&mut order);
            let kept = if report.rounds == 1 {
                kept
            } else {
                self.factor.order().to_vec()
            };
            let Some(first) = self
                .factor
                .update(&system, kept, affected.blocks.iter().copied())
            else {
                return self.solve_cold(report);
            };
            report.columns = self.factor.order().len();
            report.factored_columns += report.columns - first;
            let limit = self.config.propagate_above;
            let Linearized { step, diagonal, .. } = &mut self.linearized;
            let moved = self.factor.solve(first, step, |block, old, new| {
                let parts = old.iter().zip(new).zip(&diagonal[block]);
                parts.fold(false, |m, ((a, b), h)| {
                    m | ((a - b).abs() * h.sqrt() > limit)
                })
            });
            let mut candidates = self.linearized.move_points(&affected.points, &moved);
            candidates.extend(moved);
            candidates.retain(|block| {
                self.linearized
                    .has_moved(*block, self.config.relinearize_above)
            });
            if candidates.is_empty() {
                report.converged = true;
                break;
            }
            residuals = self.linearized.residuals_of_all(&candidates);
            let limit = self.linearized.cost_of(&residuals);
            let saved = self.advance(&candidates);
            before = Some(Moved {
                limit: limit * (1.0 + 1e-6) + 1e-12,
                saved,
            });
        }
        if !report.converged {
            // The values have moved since they were linearized last.
            self.new_residuals = residuals;
        }
        Ok(())
    }

    /// Moves the values of some blocks by their steps; returns the old values.
    fn advance(&mut self, blocks: &[usize]) -> Vec<(usize, Vec<f64>)> {
        let mut saved = Vec::with_capacity(blocks.len());
        let mut moved = Vec::new();
        for &block in blocks {
            let entry = &self.problem.blocks[block];
            let range = entry.start..entry.start + entry.shape.stored;
            saved.push((range.start, self.problem.values[range.clone()].to_vec()));
            let mut whole = vec![0.0; entry.shape.tangent];
            for (k, d) in self.linearized.step[block].iter().enumerate() {
                whole[entry.component(k)] = *d;
            }
            moved.resize(entry.shape.stored, 0.0);
            (entry.plus)(&self.problem.values[range.clone()], &whole, &mut moved);
            self.problem.values[range].copy_from_slice(&moved);
            self.linearized.step[block].fill(0.0);
        }
        saved
    }

    /// Blocks read by new residuals go last; the others keep their order.
    fn next_order(&mut self) -> Vec<usize> {
        let structural = std::mem::take(&mut self.structural);
        let linearized = &self.linearized;
        let is_reduced = |block: &usize| linearized.is_reduced(*block);
        let mut order: Vec<usize> = self
            .factor
            .order()
            .iter()
            .copied()
            .filter(|block| !structural.contains(block) && is_reduced(block))
            .collect();
        order.extend(structural.iter().copied().filter(is_reduced));
        order
    }

    /// Where a round went wrong: from the last values that were good, by a method that never raises the cost.
    fn solve_cold(&mut self, report: &mut UpdateReport) -> Result<(), Error> {
        solve(&mut self.problem, &self.config.solve)?;
        // Linearizations and factor are made anew by the next update.
        self.restart();
        report.solved_cold = true;
        report.converged = true;
        Ok(())
    }
}
