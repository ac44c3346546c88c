//! The normal equations of a problem that grows, points eliminated, kept up to date block by block.

use nalgebra::{Matrix3, Vector3};

use crate::kernels::{
    add_matrix_vector, add_product, multiply_inverse, subtract_product, vectorized,
};
use crate::layout::POINT;
use crate::normal::inverse_of_symmetric;
use crate::problem::BlockId;
use crate::residual::CONSTANT;

use super::marks::Marks;
use super::models::Models;
use super::steps::{Part, Steps};

/// Damping of a point that its observations do not determine yet, as a share of its diagonal: one of which the determinant of
/// the normal matrix is a smaller share of the product of its diagonal than that.
const POINT_DAMPING: f64 = 1e-9;

/// The reduced system and the points that were eliminated from it.
#[derive(Default)]
pub(super) struct System {
    /// By block: residuals that read it.
    residuals: Vec<Vec<u32>>,
    /// By block: those of them that read no point.
    bare: Vec<Vec<u32>>,
    /// By block: points that a reduced block shares residuals with.
    points: Vec<Vec<u32>>,
    /// By block.
    eliminated: Vec<Eliminated>,
    /// What residuals that read points contribute, with these eliminated: columns, diagonal, right side.
    seen: Vec<Column>,
    seen_diagonal: Vec<f64>,
    seen_right_side: Vec<f64>,
    columns: Vec<Column>,
    /// Diagonal of the normal matrix and right side of the reduced system, where the steps are.
    pub diagonal: Vec<f64>,
    pub right_side: Vec<f64>,
    /// Share of the diagonal that is added to it. It holds a block where it is, not where it began.
    damping: f64,
    found: Vec<u32>,
    gain: Vec<f64>,
}

/// A point: its own part of the normal equations.
#[derive(Default)]
struct Eliminated {
    gradient: Vector3<f64>,
    /// Zero where its observations do not determine it.
    inverse: Matrix3<f64>,
    is_determined: bool,
    /// Reduced blocks and where the normal matrix between each and the point begins in `couplings`, columns first.
    pairs: Vec<[u32; 2]>,
    couplings: Vec<f64>,
}

/// What one block's column of the reduced matrix has in the block itself and those that are eliminated after it.
#[derive(Default)]
pub(super) struct Column {
    /// Blocks, and where the values of each begin: rows of that block, columns of the column's own, columns first.
    pub rows: Vec<[u32; 2]>,
    pub values: Vec<f64>,
}

impl System {
    pub fn new(damping: f64) -> Self {
        Self {
            damping,
            ..Self::default()
        }
    }

    /// Makes room for blocks that came.
    pub fn grow(&mut self, blocks: usize, steps: &Steps) {
        self.residuals.resize_with(blocks, Vec::new);
        self.bare.resize_with(blocks, Vec::new);
        self.points.resize_with(blocks, Vec::new);
        self.eliminated.resize_with(blocks, Eliminated::default);
        self.seen.resize_with(blocks, Column::default);
        self.seen_diagonal.resize(steps.len(), 0.0);
        self.seen_right_side.resize(steps.len(), 0.0);
        self.columns.resize_with(blocks, Column::default);
        self.found.resize(blocks, u32::MAX);
        self.diagonal.resize(steps.len(), 0.0);
        self.right_side.resize(steps.len(), 0.0);
    }

    /// Residuals that read a block.
    pub fn residuals_of(&self, block: usize) -> &[u32] {
        self.residuals.get(block).map_or(&[], Vec::as_slice)
    }

    /// Residuals that read a block and no point.
    pub fn bare_of(&self, block: usize) -> &[u32] {
        &self.bare[block]
    }

    /// Points that share residuals with a reduced block.
    pub fn points_of(&self, block: usize) -> &[u32] {
        &self.points[block]
    }

    /// Reduced blocks that share residuals with a point.
    pub fn blocks_at(&self, point: usize) -> impl Iterator<Item = usize> + '_ {
        self.eliminated[point].pairs.iter().map(|p| p[0] as usize)
    }

    /// Whether a block has columns in the factor: reduced, and read by a residual.
    pub fn is_reduced(&self, steps: &Steps, block: usize) -> bool {
        steps.part(block) == Part::Reduced && !self.residuals_of(block).is_empty()
    }

    pub fn column(&self, block: usize) -> &Column {
        &self.columns[block]
    }

    /// A residual reads these blocks from now on.
    pub fn add_residual(&mut self, steps: &Steps, blocks: &[BlockId], residual: usize) {
        let reads_point = blocks.iter().any(|b| steps.part(b.0) == Part::Point);
        for block in blocks {
            self.residuals[block.0].push(residual as u32);
            if !reads_point {
                self.bare[block.0].push(residual as u32);
            }
        }
    }

    /// A residual no longer reads a block.
    pub fn forget_residual(&mut self, block: usize, residual: usize) {
        if block < self.residuals.len() {
            self.residuals[block].retain(|k| *k as usize != residual);
            self.bare[block].retain(|k| *k as usize != residual);
        }
    }

    /// Forms a point's own normal equations. Blocks that it shares residuals with, before or now, are added to `reached`.
    pub fn eliminate(&mut self, models: &Models, steps: &Steps, point: usize, reached: &mut Marks) {
        let mut state = std::mem::take(&mut self.eliminated[point]);
        for [block, _] in &state.pairs {
            reached.add(*block as usize);
        }
        let before = std::mem::take(&mut state.pairs);
        state.couplings.clear();
        let (residuals, of_point) = (&self.residuals[point][..], &mut state);
        let (mut hessian, mut gradient) =
            vectorized!(add_up_point(residuals, models, steps, point, of_point));
        let same = before
            .iter()
            .map(|p| p[0])
            .eq(state.pairs.iter().map(|p| p[0]));
        if !same {
            for [block, _] in &before {
                self.points[*block as usize].retain(|p| *p as usize != point);
            }
            for [block, _] in &state.pairs {
                self.points[*block as usize].push(point as u32);
                reached.add(*block as usize);
            }
        }
        let at = steps.range(point).start;
        let product = hessian.diagonal().product();
        let is_weak = !(hessian.determinant() > POINT_DAMPING * product);
        let share = if is_weak { POINT_DAMPING } else { 0.0 };
        for (d, step) in steps.of(point).iter().enumerate() {
            let damping = share * hessian[(d, d)];
            self.diagonal[at + d] = hessian[(d, d)];
            hessian[(d, d)] += damping;
            gradient[d] -= damping * step;
        }
        state.gradient = gradient;
        let inverse = inverse_of_symmetric(&hessian);
        state.is_determined = inverse.is_some();
        state.inverse = inverse.unwrap_or_else(Matrix3::zeros);
        self.eliminated[point] = state;
    }

    /// Sums up one block's column of the reduced system; `place` is that of each block in the order of elimination. What points
    /// contribute is summed up anew only where that changed.
    pub fn reduce(
        &mut self,
        models: &Models,
        steps: &Steps,
        place: &[u32],
        block: usize,
        points_changed: bool,
    ) {
        if points_changed || self.seen[block].rows.is_empty() {
            self.reduce_seen(models, steps, place, block);
        }
        let n = steps.dimension(block);
        let range = steps.range(block);
        let mut column = std::mem::take(&mut self.columns[block]);
        let seen = &self.seen[block];
        column.rows.clone_from(&seen.rows);
        column.values.clone_from(&seen.values);
        column.find(&mut self.found);
        let right_side = &mut self.right_side[range.clone()];
        right_side.copy_from_slice(&self.seen_right_side[range.clone()]);
        let (residuals, found) = (&self.bare[block][..], &mut self.found[..]);
        let (target, right) = (&mut column, &mut right_side[..]);
        vectorized!(add_residuals(
            (residuals, false),
            (models, steps, place, block),
            (target, found, right),
        ));
        column.forget(&mut self.found);
        for (k, right) in right_side.iter_mut().enumerate() {
            let entry = &mut column.values[k * n + k];
            let by_points = self.seen_diagonal[range.start + k] - seen.values[k * n + k];
            let diagonal = *entry + by_points;
            let damping = self.damping * diagonal.max(f64::MIN_POSITIVE);
            *entry += damping;
            *right += damping * steps.of(block)[k];
            self.diagonal[range.start + k] = diagonal;
        }
        self.columns[block] = column;
    }

    /// Sums up what residuals that read points contribute to one block's column.
    fn reduce_seen(&mut self, models: &Models, steps: &Steps, place: &[u32], block: usize) {
        let n = steps.dimension(block);
        let range = steps.range(block);
        let mut column = std::mem::take(&mut self.seen[block]);
        column.rows.clear();
        column.values.clear();
        let right_side = &mut self.seen_right_side[range.clone()];
        right_side.fill(0.0);
        column.place(&mut self.found, block as u32, n * n);
        let (residuals, found) = (&self.residuals[block][..], &mut self.found[..]);
        let (target, right) = (&mut column, &mut right_side[..]);
        vectorized!(add_residuals(
            (residuals, true),
            (models, steps, place, block),
            (target, found, right),
        ));
        for k in 0..n {
            self.seen_diagonal[range.start + k] = column.values[k * n + k];
        }
        self.gain.resize(POINT * n, 0.0);
        let (points, eliminated) = (&self.points[block][..], &self.eliminated[..]);
        let (found, gain, target) = (&mut self.found[..], &mut self.gain[..], &mut column);
        vectorized!(subtract_points(
            (points, eliminated),
            (steps, place, block),
            (target, found, right_side, gain),
        ));
        column.forget(&mut self.found);
        self.seen[block] = column;
    }

    /// Where a point's step is now, by those of the blocks it shares residuals with.
    pub fn point_step(&self, steps: &Steps, point: usize) -> Vector3<f64> {
        let state = &self.eliminated[point];
        if !state.is_determined {
            return Vector3::from_column_slice(steps.of(point));
        }
        let mut right = -state.gradient;
        for [block, at] in &state.pairs {
            let step = steps.of(*block as usize);
            let coupling = &state.couplings[*at as usize..];
            if let Some(step) = step.first_chunk::<6>().filter(|_| step.len() == 6) {
                let (columns, _) = coupling.as_chunks::<6>();
                for (t, c) in right.iter_mut().zip(columns) {
                    let first = c[0] * step[0] + c[1] * step[1] + c[2] * step[2];
                    let second = c[3] * step[3] + c[4] * step[4] + c[5] * step[5];
                    *t -= first + second;
                }
                continue;
            }
            let columns = coupling.chunks_exact(step.len().max(1));
            for (t, column) in right.iter_mut().zip(columns) {
                *t -= column.iter().zip(step).map(|(v, x)| v * x).sum::<f64>();
            }
        }
        state.inverse * right
    }

    /// Whether two steps of a block differ by more than `limit` of the standard deviations that it has if all else is known.
    pub fn differ(&self, range: std::ops::Range<usize>, a: &[f64], b: &[f64], limit: f64) -> bool {
        let parts = a.iter().zip(b).zip(&self.diagonal[range]);
        parts.fold(false, |differ, ((a, b), h)| {
            differ | ((a - b).powi(2) * h > limit * limit)
        })
    }
}

impl Column {
    /// Tells where the values of its rows are, for [`Column::place`].
    fn find(&self, found: &mut [u32]) {
        for [row, at] in &self.rows {
            found[*row as usize] = *at;
        }
    }

    /// What [`Column::find`] and [`Column::place`] told holds no more.
    fn forget(&self, found: &mut [u32]) {
        for [row, _] in &self.rows {
            found[*row as usize] = u32::MAX;
        }
    }

    /// Values of a row, which is added where it is not there yet.
    #[inline(always)]
    fn place(&mut self, found: &mut [u32], row: u32, length: usize) -> &mut [f64] {
        let at = &mut found[row as usize];
        if *at == u32::MAX {
            *at = self.values.len() as u32;
            self.rows.push([row, *at]);
            self.values.resize(self.values.len() + length, 0.0);
        }
        &mut self.values[*at as usize..][..length]
    }
}

/// A point's normal matrix and gradient, and its couplings with the blocks that it shares residuals with.
#[inline(always)]
#[allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]
fn add_up_point<const FUSED: bool>(
    (residuals, models, steps, point, state): (&[u32], &Models, &Steps, usize, &mut Eliminated),
) -> (Matrix3<f64>, Vector3<f64>) {
    let mut hessian = Matrix3::zeros();
    let mut gradient = Vector3::zeros();
    for k in residuals {
        let (dimension, slots, record) = models.model(*k as usize);
        let own = slots.iter().find(|slot| slot.block as usize == point);
        let Some(own) = own.filter(|slot| slot.jacobian != CONSTANT) else {
            continue;
        };
        let by_point = &record[own.jacobian as usize..][..dimension * POINT];
        for (row, b) in by_point.chunks_exact(POINT).zip(record) {
            let row = Vector3::from_column_slice(row);
            hessian += row * row.transpose();
            gradient += row * *b;
        }
        for slot in slots {
            let block = slot.block as usize;
            if slot.jacobian == CONSTANT || steps.part(block) != Part::Reduced {
                continue;
            }
            let n = steps.dimension(block);
            let known = state.pairs.iter().rev().find(|pair| pair[0] == slot.block);
            let at = known.map_or(state.couplings.len(), |pair| pair[1] as usize);
            if known.is_none() {
                state.pairs.push([slot.block, at as u32]);
                state.couplings.resize(at + POINT * n, 0.0);
            }
            let target = &mut state.couplings[at..at + POINT * n];
            let jacobian = &record[slot.jacobian as usize..][..dimension * n];
            add_product::<FUSED>(target, jacobian, n, by_point, POINT);
        }
    }
    (hessian, gradient)
}

/// Adds what residuals contribute to a block's column and right side: all, or those that read points.
#[inline(always)]
#[allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]
fn add_residuals<const FUSED: bool>(
    ((residuals, of_points), (models, steps, place, block), (column, found, right_side)): (
        (&[u32], bool),
        (&Models, &Steps, &[u32], usize),
        (&mut Column, &mut [u32], &mut [f64]),
    ),
) {
    let n = steps.dimension(block);
    for k in residuals {
        let (dimension, slots, record) = models.model(*k as usize);
        let mut blocks = slots.iter().map(|slot| slot.block as usize);
        if of_points && !blocks.any(|b| steps.part(b) == Part::Point) {
            continue;
        }
        let own = slots.iter().find(|slot| slot.block as usize == block);
        let Some(own) = own.filter(|slot| slot.jacobian != CONSTANT) else {
            continue;
        };
        let own = &record[own.jacobian as usize..][..dimension * n];
        for (row, b) in own.chunks_exact(n.max(1)).zip(record) {
            let entries = right_side.iter_mut().zip(row);
            entries.for_each(|(t, j)| *t -= j * b);
        }
        for slot in slots {
            let other = slot.block as usize;
            if slot.jacobian == CONSTANT
                || steps.part(other) != Part::Reduced
                || place[other] < place[block]
            {
                continue;
            }
            let m = steps.dimension(other);
            let target = column.place(found, slot.block, m * n);
            let jacobian = &record[slot.jacobian as usize..][..dimension * m];
            add_product::<FUSED>(target, jacobian, m, own, n);
        }
    }
}

/// Subtracts what points contribute to the column of one of their blocks, and to its right side.
#[inline(always)]
#[allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]
fn subtract_points<const FUSED: bool>(
    ((points, eliminated), (steps, place, block), (column, found, right_side, gain)): (
        (&[u32], &[Eliminated]),
        (&Steps, &[u32], usize),
        (&mut Column, &mut [u32], &mut [f64], &mut [f64]),
    ),
) {
    let n = steps.dimension(block);
    for point in points {
        let state = &eliminated[*point as usize];
        let Some(own) = state.pairs.iter().find(|pair| pair[0] as usize == block) else {
            continue;
        };
        let own = &state.couplings[own[1] as usize..][..POINT * n];
        multiply_inverse::<FUSED>(gain, own, n, &state.inverse.data.0);
        add_matrix_vector::<FUSED>(right_side, gain, state.gradient.as_slice());
        for [other, at] in &state.pairs {
            if place[*other as usize] < place[block] {
                continue;
            }
            let m = steps.dimension(*other as usize);
            let target = column.place(found, *other, m * n);
            let coupling = &state.couplings[*at as usize..][..POINT * m];
            subtract_product::<FUSED>(target, coupling, m, gain, n);
        }
    }
}
