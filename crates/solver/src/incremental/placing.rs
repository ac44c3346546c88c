//! Where what is new begins: where what it shares with what is known has it, which stays where it is meanwhile.
//!
//! A keyframe comes where somebody foretold it. Linearized there, all that it sees, and all residuals of what it sees, would be linearized
//! again once it has moved to where it belongs; that is found for a hundredth of the work of a round.

use crate::Error;
use crate::problem::Problem;
use crate::residual::{CONSTANT, Slot};

use super::factor::solve_dense;
use super::models::Models;
use super::steps::Steps;

/// Components that are placed together at most, those of two keyframes: more is not foretold, but a problem of its own.
const MOST_COMPONENTS: usize = 30;

/// Gauss–Newton steps at most.
const MOST_STEPS: usize = 3;

/// A step that lowers the cost by less is the last one.
const LEAST_GAIN: f64 = 1e-3;

/// Places blocks by Gauss–Newton steps.
#[derive(Default)]
pub(super) struct Placing {
    /// Of the blocks that are placed: first component of each among those of all.
    starts: Vec<usize>,
    /// Normal matrix of them all, its lower triangle, columns first; right side; and the move that they lead to.
    normal: Vec<f64>,
    right_side: Vec<f64>,
    step: Vec<f64>,
    /// Steps of the blocks before the last move.
    before: Vec<f64>,
    /// One residual and its Jacobians.
    record: Vec<f64>,
    moved: Vec<f64>,
}

impl Placing {
    /// Moves blocks to where the cost of some residuals is least, all others staying where they are. Where it would rise, and where the
    /// residuals do not determine the blocks, these stay as well.
    pub fn place(
        &mut self,
        problem: &mut Problem,
        steps: &mut Steps,
        models: &Models,
        blocks: &[usize],
        residuals: &[usize],
    ) -> Result<(), Error> {
        self.starts.clear();
        let mut components = 0;
        for block in blocks {
            self.starts.push(components);
            components += steps.dimension(*block);
        }
        if components == 0 || components > MOST_COMPONENTS {
            return Ok(());
        }
        self.right_side.resize(components, 0.0);
        let mut least = f64::INFINITY;
        for moves_left in (0..=MOST_STEPS).rev() {
            match self.sum_up(problem, steps, models, blocks, residuals) {
                Ok(cost) if cost < least => least = cost,
                Err(error) if least == f64::INFINITY => return Err(error),
                _ => {
                    if least.is_finite() {
                        self.move_to_before(problem, steps, blocks);
                    }
                    return Ok(());
                }
            }
            self.step.clone_from(&self.right_side);
            if moves_left == 0 || !solve_dense(&mut self.normal, &mut self.step) {
                return Ok(());
            }
            let along = self.step.iter().zip(&self.right_side);
            let gain = 0.5 * along.map(|(s, r)| s * r).sum::<f64>();
            self.move_by_step(problem, steps, blocks);
            if gain < LEAST_GAIN {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Forms the normal equations of the blocks where everything is now. Returns the cost.
    fn sum_up(
        &mut self,
        problem: &Problem,
        steps: &Steps,
        models: &Models,
        blocks: &[usize],
        residuals: &[usize],
    ) -> Result<f64, Error> {
        let n = self.right_side.len();
        self.right_side.fill(0.0);
        self.normal.clear();
        self.normal.resize(n * n, 0.0);
        let mut cost = 0.0;
        for k in residuals {
            let Some(robust) = models.evaluate(problem, steps, *k, &mut self.record)? else {
                continue;
            };
            cost += robust.cost;
            let (dimension, slots, _) = models.model(*k);
            let jacobian_of = |block: usize| {
                let is_of =
                    |slot: &&Slot| slot.block as usize == block && slot.jacobian != CONSTANT;
                let slot = slots.iter().find(is_of)?;
                let length = dimension * steps.dimension(block);
                Some(&self.record[slot.jacobian as usize..][..length])
            };
            for (block, start) in blocks.iter().zip(&self.starts) {
                let Some(own) = jacobian_of(*block) else {
                    continue;
                };
                let width = steps.dimension(*block).max(1);
                for (row, r) in own.chunks_exact(width).zip(&self.record) {
                    let target = self.right_side[*start..].iter_mut().zip(row);
                    target.for_each(|(t, j)| *t -= robust.weight * j * r);
                }
                for (other, other_start) in blocks.iter().zip(&self.starts) {
                    let Some(below) = jacobian_of(*other).filter(|_| other_start >= start) else {
                        continue;
                    };
                    let height = steps.dimension(*other).max(1);
                    for (row, by) in own.chunks_exact(width).zip(below.chunks_exact(height)) {
                        for (c, j) in row.iter().enumerate() {
                            let column = (start + c) * n + other_start;
                            let target = self.normal[column..].iter_mut().zip(by);
                            target.for_each(|(t, b)| *t += robust.weight * j * b);
                        }
                    }
                }
            }
        }
        Ok(cost)
    }

    fn move_by_step(&mut self, problem: &mut Problem, steps: &mut Steps, blocks: &[usize]) {
        self.before.clear();
        for (block, start) in blocks.iter().zip(&self.starts) {
            let old = steps.of(*block);
            self.before.extend_from_slice(old);
            self.moved.clear();
            let moves = old.iter().zip(&self.step[*start..]);
            self.moved.extend(moves.map(|(old, step)| old + step));
            steps.set(problem, *block, &self.moved);
        }
    }

    fn move_to_before(&mut self, problem: &mut Problem, steps: &mut Steps, blocks: &[usize]) {
        for (block, start) in blocks.iter().zip(&self.starts) {
            let length = steps.dimension(*block);
            steps.set(problem, *block, &self.before[*start..][..length]);
        }
    }
}
