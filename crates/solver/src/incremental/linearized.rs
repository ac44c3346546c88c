#![allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]

use std::collections::BTreeSet;

use nalgebra::{Matrix3, Vector3};

use super::factor::Neighbours;
use crate::evaluation::squared_norm;
use crate::kernels::{add_product, subtract_product, vectorized};
use crate::layout::POINT;
use crate::normal::inverse_of_symmetric;
use crate::problem::{Problem, ResidualId, Role};
use crate::residual::{CONSTANT, Linearization, NO_PAIR, Parameters, Slot};
use crate::{Error, Undefined};

/// Damping of a point that its observations do not determine yet, as a share of its diagonal.
const POINT_DAMPING: f64 = 1e-9;

/// Everything that is kept of residuals, points and the reduced system, by the numbers they have in the problem.
#[derive(Default)]
pub(super) struct Linearized {
    residuals: Vec<LinearizedResidual>,
    blocks: Vec<BlockState>,
    /// Steps from the values at which the problem is linearized; empty for blocks that are held.
    pub step: Vec<Vec<f64>>,
    /// Diagonal of the normal matrix.
    pub diagonal: Vec<Vec<f64>>,
    /// The reduced system.
    pub matrix: Vec<Neighbours>,
    pub right_side: Vec<Vec<f64>>,
}

#[derive(Default)]
struct LinearizedResidual {
    slots: Vec<Slot>,
    /// Residual and Jacobians, weighted.
    record: Vec<f64>,
    cost: f64,
}

#[derive(Clone, Copy, Default, PartialEq, Eq)]
enum Part {
    #[default]
    Held,
    Reduced,
    Point,
}

#[derive(Default)]
struct BlockState {
    part: Part,
    /// Residuals that read it.
    residuals: Vec<usize>,
    /// Of a reduced block: points it shares residuals with.
    points: BTreeSet<usize>,
    point: PointState,
}

#[derive(Default)]
struct PointState {
    gradient: Vector3<f64>,
    inverse: Matrix3<f64>,
    /// Reduced blocks, and the normal matrix between each and the point, columns first.
    pairs: Vec<(usize, Vec<f64>)>,
}

/// What an elimination reached.
pub(super) struct Affected {
    pub points: BTreeSet<usize>,
    pub blocks: BTreeSet<usize>,
}

impl Linearized {
    /// Makes room for what the problem has more.
    pub fn grow(&mut self, problem: &Problem) {
        self.residuals
            .resize_with(problem.residuals.len(), LinearizedResidual::default);
        for block in self.blocks.len()..problem.blocks.len() {
            let entry = &problem.blocks[block];
            let part = match entry.role {
                Role::Eliminated if entry.free() == POINT => Part::Point,
                Role::Free | Role::Eliminated => Part::Reduced,
                Role::Constant | Role::Removed => Part::Held,
            };
            let free = if part == Part::Held { 0 } else { entry.free() };
            let reduced = if part == Part::Reduced { free } else { 0 };
            self.blocks.push(BlockState {
                part,
                ..BlockState::default()
            });
            self.step.push(vec![0.0; free]);
            self.diagonal.push(vec![0.0; free]);
            self.matrix.push(Neighbours::new());
            self.right_side.push(vec![0.0; reduced]);
        }
    }

    pub fn residuals_of(&self, block: usize) -> &[usize] {
        self.blocks.get(block).map_or(&[], |b| &b.residuals)
    }

    /// Whether the block has a place in the reduced system: free, and read by a residual.
    pub fn is_reduced(&self, block: usize) -> bool {
        self.blocks
            .get(block)
            .is_some_and(|b| b.part == Part::Reduced && !b.residuals.is_empty())
    }

    /// A residual does not read a block any more.
    pub fn forget(&mut self, residual: usize, block: usize) {
        if let Some(state) = self.blocks.get_mut(block) {
            state.residuals.retain(|k| *k != residual);
        }
        if let Some(state) = self.residuals.get_mut(residual) {
            *state = LinearizedResidual::default();
        }
    }

    /// Registers new residuals with the blocks they read, whose values are checked.
    pub fn check_new(&mut self, problem: &Problem, new: &BTreeSet<usize>) -> Result<(), Error> {
        for &k in new {
            if !self.residuals[k].slots.is_empty() {
                continue;
            }
            let mut slots = Vec::new();
            let dimension = problem.residuals[k].dimension;
            let mut next = dimension;
            for block in problem.blocks_of(ResidualId(k)) {
                let entry = &problem.blocks[block.0];
                let stored = &problem.values[entry.start..entry.start + entry.shape.stored];
                if !stored.iter().all(|x| x.is_finite()) {
                    return Err(Error::BlockNotFinite { block: block.0 });
                }
                let state = &mut self.blocks[block.0];
                let jacobian = if state.part == Part::Held {
                    CONSTANT
                } else {
                    next += dimension * entry.free();
                    (next - dimension * entry.free()) as u32
                };
                state.residuals.push(k);
                slots.push(Slot {
                    value: entry.start,
                    mask: entry.mask,
                    block: block.0 as u32,
                    jacobian,
                    pair: NO_PAIR,
                    couplings: [0; 2],
                });
            }
            self.residuals[k] = LinearizedResidual {
                slots,
                record: vec![0.0; next],
                cost: 0.0,
            };
        }
        Ok(())
    }

    /// Linearizes residuals at the problem's values; returns the sum of their costs.
    pub fn linearize(
        &mut self,
        problem: &Problem,
        residuals: &BTreeSet<usize>,
    ) -> Result<f64, Error> {
        let mut total = 0.0;
        for &k in residuals {
            let entry = &problem.residuals[k];
            let state = &mut self.residuals[k];
            let Some(residual) = &entry.residual else {
                continue;
            };
            let parameters = Parameters {
                values: &problem.values,
                slots: &state.slots,
            };
            let mut out = Linearization {
                record: &mut state.record,
                slots: &state.slots,
                with_jacobians: true,
            };
            if residual.evaluate(&parameters, &mut out) == Err(Undefined) {
                // It keeps the cost it had, and pulls at nothing.
                state.record.fill(0.0);
                total += state.cost;
                continue;
            }
            if !state.record.iter().all(|x| x.is_finite()) {
                return Err(Error::ResidualNotFinite {
                    residual: k,
                    blocks: problem
                        .blocks_of(ResidualId(k))
                        .iter()
                        .map(|b| b.0)
                        .collect(),
                });
            }
            let robust = entry
                .kernel
                .at(squared_norm(&state.record[..entry.dimension]));
            let root = robust.weight.sqrt();
            state.record.iter_mut().for_each(|x| *x *= root);
            state.cost = 0.5 * robust.cost;
            total += state.cost;
        }
        Ok(total)
    }

    /// Cost of a residual at other values; `None` where it is undefined or removed.
    pub fn cost_at(&self, problem: &Problem, k: usize, values: &[f64]) -> Option<f64> {
        let entry = &problem.residuals[k];
        let slots: Vec<Slot> = problem
            .blocks_of(ResidualId(k))
            .iter()
            .map(|block| Slot {
                value: problem.blocks[block.0].start,
                mask: 0,
                block: block.0 as u32,
                jacobian: CONSTANT,
                pair: NO_PAIR,
                couplings: [0; 2],
            })
            .collect();
        let mut record = vec![0.0; entry.dimension];
        let mut out = Linearization {
            record: &mut record,
            slots: &slots,
            with_jacobians: false,
        };
        let parameters = Parameters {
            values,
            slots: &slots,
        };
        let residual = entry.residual.as_ref()?;
        residual.evaluate(&parameters, &mut out).ok()?;
        Some(0.5 * entry.kernel.at(squared_norm(&record)).cost)
    }

    /// Sum of the costs of residuals where they were linearized last.
    pub fn cost_of(&self, residuals: &BTreeSet<usize>) -> f64 {
        residuals.iter().map(|k| self.residuals[*k].cost).sum()
    }

    pub fn residuals_of_all(&self, blocks: &[usize]) -> BTreeSet<usize> {
        blocks
            .iter()
            .flat_map(|block| self.residuals_of(*block).iter().copied())
            .collect()
    }

    /// Brings points and reduced system up to date after some residuals were linearized, and blocks lost some.
    pub fn eliminate(
        &mut self,
        problem: &Problem,
        residuals: &BTreeSet<usize>,
        touched: &BTreeSet<usize>,
    ) -> Affected {
        let mut affected = Affected {
            points: BTreeSet::new(),
            blocks: BTreeSet::new(),
        };
        let read = residuals.iter().flat_map(|k| &self.residuals[*k].slots);
        let read = read.map(|slot| slot.block as usize);
        for block in read.chain(touched.iter().copied()) {
            match self.blocks[block].part {
                Part::Point => affected.points.insert(block),
                Part::Reduced => affected.blocks.insert(block),
                Part::Held => false,
            };
        }
        for &point in &affected.points {
            for (block, _) in &self.blocks[point].point.pairs {
                affected.blocks.insert(*block);
            }
            self.eliminate_point(problem, point);
            for (block, _) in &self.blocks[point].point.pairs {
                affected.blocks.insert(*block);
            }
        }
        for &block in &affected.blocks {
            self.reduce(problem, block, &affected.blocks);
        }
        affected.blocks.retain(|block| self.is_reduced(*block));
        affected
    }

    fn eliminate_point(&mut self, problem: &Problem, point: usize) {
        let old = std::mem::take(&mut self.blocks[point].point.pairs);
        for (block, _) in &old {
            self.blocks[*block].points.remove(&point);
        }
        let mut hessian = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        let mut pairs: Vec<(usize, Vec<f64>)> = Vec::new();
        for &k in &self.blocks[point].residuals {
            let state = &self.residuals[k];
            let dimension = problem.residuals[k].dimension;
            let own = state.slots.iter().find(|slot| slot.block as usize == point);
            let Some(own) = own else {
                continue;
            };
            let by_point = &state.record[own.jacobian as usize..][..dimension * POINT];
            for (row, r) in by_point.chunks_exact(POINT).zip(&state.record) {
                let row = Vector3::from_column_slice(row);
                hessian += row * row.transpose();
                gradient += row * *r;
            }
            for slot in &state.slots {
                let block = slot.block as usize;
                if self.blocks[block].part != Part::Reduced {
                    continue;
                }
                let n = self.step[block].len();
                let found = pairs.iter().position(|(b, _)| *b == block);
                let at = found.unwrap_or_else(|| {
                    pairs.push((block, vec![0.0; POINT * n]));
                    pairs.len() - 1
                });
                let jacobian = &state.record[slot.jacobian as usize..][..dimension * n];
                add_jacobians(&mut pairs[at].1, jacobian, n, by_point, POINT);
            }
        }
        for (block, _) in &pairs {
            self.blocks[*block].points.insert(point);
        }
        for d in 0..POINT {
            self.diagonal[point][d] = hessian[(d, d)];
            hessian[(d, d)] *= 1.0 + POINT_DAMPING;
        }
        self.blocks[point].point = PointState {
            gradient,
            inverse: inverse_of_symmetric(&hessian).unwrap_or_else(Matrix3::zeros),
            pairs,
        };
    }

    /// Sums up the reduced system between one block and those of the affected ones that are not before it.
    fn reduce(&mut self, problem: &Problem, block: usize, affected: &BTreeSet<usize>) {
        let n = self.step[block].len();
        let mut right_side = vec![0.0; n];
        let mut found = Neighbours::new();
        found.insert(block, vec![0.0; n * n]);
        for &k in &self.blocks[block].residuals {
            let state = &self.residuals[k];
            let dimension = problem.residuals[k].dimension;
            let own = state.slots.iter().find(|slot| slot.block as usize == block);
            let Some(own) = own else {
                continue;
            };
            let own = &state.record[own.jacobian as usize..][..dimension * n];
            for (row, r) in own.chunks_exact(n.max(1)).zip(&state.record) {
                right_side
                    .iter_mut()
                    .zip(row)
                    .for_each(|(t, j)| *t -= j * r);
            }
            for slot in &state.slots {
                let other = slot.block as usize;
                if other < block
                    || self.blocks[other].part != Part::Reduced
                    || !affected.contains(&other)
                {
                    continue;
                }
                let m = self.step[other].len();
                let target = found.entry(other).or_insert_with(|| vec![0.0; m * n]);
                let jacobian = &state.record[slot.jacobian as usize..][..dimension * m];
                add_jacobians(target, jacobian, m, own, n);
            }
        }
        for k in 0..n {
            self.diagonal[block][k] = found[&block][k * n + k];
        }
        let mut gain = vec![0.0; POINT * n];
        for &point in &self.blocks[block].points {
            let state = &self.blocks[point].point;
            let Some((_, own)) = state.pairs.iter().find(|(b, _)| *b == block) else {
                continue;
            };
            for c in 0..POINT {
                for r in 0..n {
                    gain[c * n + r] = (0..POINT)
                        .map(|k| own[k * n + r] * state.inverse[(k, c)])
                        .sum();
                }
            }
            for (column, g) in gain.chunks_exact(n.max(1)).zip(state.gradient.iter()) {
                right_side
                    .iter_mut()
                    .zip(column)
                    .for_each(|(t, v)| *t += v * g);
            }
            let (steps, gain) = (&self.step[..], &gain[..]);
            vectorized!(subtract_point(
                state, block, affected, steps, gain, &mut found
            ));
        }
        self.right_side[block] = right_side;
        for other in affected.range(block..) {
            match found.remove(other) {
                Some(values) => {
                    if *other != block {
                        let m = self.step[*other].len();
                        self.matrix[*other].insert(block, transposed(&values, m, n));
                    }
                    self.matrix[block].insert(*other, values);
                }
                None => {
                    self.matrix[block].remove(other);
                    self.matrix[*other].remove(&block);
                }
            }
        }
    }

    /// Steps of the points that are affected or share a residual with a block that moved; returns them.
    pub fn move_points(&mut self, affected: &BTreeSet<usize>, moved: &[usize]) -> Vec<usize> {
        let mut points = affected.clone();
        for block in moved {
            points.extend(&self.blocks[*block].points);
        }
        for &point in &points {
            let state = &self.blocks[point].point;
            let mut right = -state.gradient;
            for (block, coupling) in &state.pairs {
                let step = &self.step[*block];
                for (t, column) in right
                    .iter_mut()
                    .zip(coupling.chunks_exact(step.len().max(1)))
                {
                    *t -= column.iter().zip(step).map(|(v, x)| v * x).sum::<f64>();
                }
            }
            let step = state.inverse * right;
            self.step[point].copy_from_slice(step.as_slice());
        }
        points.into_iter().collect()
    }

    /// Whether a block is farther from where it is linearized than `limit` of its standard deviations.
    pub fn has_moved(&self, block: usize, limit: f64) -> bool {
        let parts = self.step[block].iter().zip(&self.diagonal[block]);
        parts.fold(false, |moved, (d, h)| moved | (d.abs() * h.sqrt() > limit))
    }
}

/// `target += leftᵀ right`: `target` is `m × n`, columns first; the Jacobians are rows first.
fn add_jacobians(target: &mut [f64], left: &[f64], m: usize, right: &[f64], n: usize) {
    vectorized!(add_jacobians_inline(target, left, m, right, n));
}

#[inline(always)]
fn add_jacobians_inline<const FUSED: bool>(
    (target, left, m, right, n): (&mut [f64], &[f64], usize, &[f64], usize),
) {
    add_product::<FUSED>(target, left, m, right, n);
}

/// What a point subtracts from the column of one of its blocks.
#[inline(always)]
fn subtract_point<const FUSED: bool>(
    (state, block, affected, steps, gain, found): (
        &PointState,
        usize,
        &BTreeSet<usize>,
        &[Vec<f64>],
        &[f64],
        &mut Neighbours,
    ),
) {
    let n = steps[block].len();
    for (other, coupling) in &state.pairs {
        if *other < block || !affected.contains(other) {
            continue;
        }
        let m = steps[*other].len();
        let target = found.entry(*other).or_insert_with(|| vec![0.0; m * n]);
        subtract_product::<FUSED>(target, coupling, m, gain, n);
    }
}

fn transposed(values: &[f64], m: usize, n: usize) -> Vec<f64> {
    (0..m)
        .flat_map(|r| (0..n).map(move |c| values[c * m + r]))
        .collect()
}
