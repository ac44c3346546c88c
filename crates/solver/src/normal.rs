#![allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::divide::{divide, divide_slice};
use crate::evaluation::Evaluation;
use crate::kernels::{
    add_matrix_vector, add_product, add_transposed_vector, dot, multiply_inverse, subtract_product,
    vectorized,
};
use crate::layout::{Layout, POINT, Place};
use crate::problem::Problem;

/// Points, and residuals without a point, per parallel task.
const POINT_GRAIN: usize = 32;
const RESIDUAL_GRAIN: usize = 64;

/// Diagonal entries below this share of the largest are damped as if they were there.
const SMALLEST_DAMPED_SHARE: f64 = 1e-12;

/// The normal equations `H δ = −g`, with eliminated points apart from the reduced blocks.
pub(crate) struct NormalEquations {
    records: Vec<f64>,
    /// `H` and `g` of the points.
    pub point_hessian: Vec<Matrix3<f64>>,
    pub point_gradient: Vec<Vector3<f64>>,
    /// `H` between reduced blocks and points, `tangent × 3` by pair, columns first.
    pub coupling: Vec<f64>,
    /// Lower triangle of `H` between reduced blocks, as [`Layout::columns`] says.
    pub hessian: Vec<f64>,
    pub gradient: Vec<f64>,
    pub diagonal: Vec<f64>,
    /// Damping of entries that are smaller.
    floor: f64,
}

/// The reduced system for one damping.
pub(crate) struct ReducedSystem {
    /// Lower triangle of the Schur complement by blocks.
    pub matrix: Vec<f64>,
    pub right_side: Vec<f64>,
    pub point_inverse: Vec<Matrix3<f64>>,
}

/// A step in all free blocks, or a direction.
#[derive(Clone)]
pub(crate) struct Step {
    pub reduced: Vec<f64>,
    pub points: Vec<Vector3<f64>>,
}

impl Step {
    pub fn new(layout: &Layout) -> Self {
        Self {
            reduced: vec![0.0; layout.dimension()],
            points: vec![Vector3::zeros(); layout.points.len()],
        }
    }
}

/// What the linearization of some points writes.
struct PointParts<'a> {
    records: &'a mut [f64],
    coupling: &'a mut [f64],
    hessian: &'a mut [Matrix3<f64>],
    gradient: &'a mut [Vector3<f64>],
}

/// What the assembly of some columns of blocks writes.
struct ColumnParts<'a> {
    matrix: &'a mut [f64],
    gradient: &'a mut [f64],
    diagonal: &'a mut [f64],
}

impl NormalEquations {
    pub fn new(layout: &Layout) -> Self {
        Self {
            records: vec![0.0; layout.record_start[layout.order.len()]],
            point_hessian: vec![Matrix3::zeros(); layout.points.len()],
            point_gradient: vec![Vector3::zeros(); layout.points.len()],
            coupling: vec![0.0; layout.pair_len],
            hessian: vec![0.0; layout.matrix_len],
            gradient: vec![0.0; layout.dimension()],
            diagonal: vec![0.0; layout.dimension()],
            floor: 0.0,
        }
    }

    /// Linearizes all residuals at `values` and sums them up. Every sum is made by one thread in one order.
    pub fn linearize(
        &mut self,
        problem: &Problem,
        layout: &Layout,
        evaluation: &Evaluation,
        values: &[f64],
    ) {
        evaluation.begin();
        let first_alone = layout.point_first[layout.points.len()];
        let (with_point, alone) = self.records.split_at_mut(layout.record_start[first_alone]);
        let parts = PointParts {
            records: with_point,
            coupling: &mut self.coupling,
            hessian: &mut self.point_hessian,
            gradient: &mut self.point_gradient,
        };
        divide(
            0..layout.points.len(),
            POINT_GRAIN,
            parts,
            &|parts, range, middle| split_points(layout, parts, range, middle),
            &|points, parts| {
                let positions = layout.point_first[points.start]..layout.point_first[points.end];
                evaluation.linearize(problem, layout, values, positions, parts.records);
                vectorized!(assemble_points(problem, layout, points, parts));
            },
        );
        divide(
            first_alone..layout.order.len(),
            RESIDUAL_GRAIN,
            alone,
            &|records: &mut [f64], range, middle| {
                records.split_at_mut(layout.record_start[middle] - layout.record_start[range.start])
            },
            &|range, records| evaluation.linearize(problem, layout, values, range, records),
        );
        self.assemble_reduced(problem, layout);
        let points = self
            .point_hessian
            .iter()
            .flat_map(|h| [h[(0, 0)], h[(1, 1)], h[(2, 2)]]);
        self.floor = SMALLEST_DAMPED_SHARE
            * points
                .chain(self.diagonal.iter().copied())
                .fold(0.0, f64::max);
    }

    fn assemble_reduced(&mut self, problem: &Problem, layout: &Layout) {
        let records = &self.records[..];
        let parts = ColumnParts {
            matrix: &mut self.hessian,
            gradient: &mut self.gradient,
            diagonal: &mut self.diagonal,
        };
        divide(
            0..layout.reduced.len(),
            columns_per_task(layout),
            parts,
            &|parts, range, middle| split_columns(layout, parts, range, middle),
            &|columns, parts| {
                vectorized!(assemble_columns(problem, layout, columns, records, parts))
            },
        );
    }

    /// Largest entry of the gradient.
    pub fn gradient_max_norm(&self) -> f64 {
        self.point_gradient
            .iter()
            .map(Vector3::amax)
            .chain(self.gradient.iter().map(|g| g.abs()))
            .fold(0.0, f64::max)
    }

    /// What damping by `lambda` adds to a diagonal entry.
    pub fn damping(&self, diagonal: f64, lambda: f64) -> f64 {
        lambda * diagonal.max(self.floor)
    }

    /// Inverts the points' own matrices in `H + λ diag H`.
    fn invert_points(&self, lambda: f64, system: &mut ReducedSystem) {
        divide_slice(
            &mut system.point_inverse,
            POINT_GRAIN * 4,
            &|points, inverses| {
                for (inverse, hessian) in inverses.iter_mut().zip(&self.point_hessian[points]) {
                    let mut damped = *hessian;
                    for d in 0..POINT {
                        damped[(d, d)] += self.damping(damped[(d, d)], lambda);
                    }
                    // A point that cannot be inverted even so is held.
                    *inverse = inverse_of_symmetric(&damped).unwrap_or_else(Matrix3::zeros);
                }
            },
        );
    }

    /// Eliminates the points from the right side of `(H + λ diag H) δ = −g`.
    pub fn reduce_right_side(&self, layout: &Layout, lambda: f64, system: &mut ReducedSystem) {
        self.invert_points(lambda, system);
        let inverses = &system.point_inverse[..];
        divide(
            0..layout.reduced.len(),
            columns_per_task(layout),
            &mut system.right_side[..],
            &|rows: &mut [f64], range, middle| {
                rows.split_at_mut(layout.row_start[middle] - layout.row_start[range.start])
            },
            &|blocks, rows| vectorized!(right_side_of(self, layout, blocks, inverses, rows)),
        );
    }

    /// Eliminates the points from `(H + λ diag H) δ = −g`: forms the Schur complement and its right side.
    pub fn reduce(&self, layout: &Layout, lambda: f64, system: &mut ReducedSystem) {
        self.invert_points(lambda, system);
        let inverses = &system.point_inverse[..];
        let parts = (&mut system.matrix[..], &mut system.right_side[..]);
        divide(
            0..layout.reduced.len(),
            columns_per_task(layout),
            parts,
            &|(matrix, rows): (&mut [f64], &mut [f64]), range, middle| {
                let values =
                    layout.column_value_start(middle) - layout.column_value_start(range.start);
                let (left, right) = matrix.split_at_mut(values);
                let (top, bottom) =
                    rows.split_at_mut(layout.row_start[middle] - layout.row_start[range.start]);
                ((left, top), (right, bottom))
            },
            &|columns, (matrix, rows)| {
                vectorized!(subtract_points(
                    self, layout, lambda, columns, inverses, matrix, rows
                ))
            },
        );
    }

    /// Points' part of the step, given that of the reduced blocks.
    pub fn back_substitute(&self, layout: &Layout, inverses: &[Matrix3<f64>], step: &mut Step) {
        let reduced = &step.reduced[..];
        divide_slice(&mut step.points, POINT_GRAIN * 4, &|points, deltas| {
            deltas.copy_from_slice(&self.point_gradient[points.clone()]);
            vectorized!(solve_points(
                self, layout, points, inverses, reduced, deltas
            ))
        });
    }

    /// For some points: the step that `direction` of the reduced blocks alone makes them take.
    pub fn back_substitute_points(
        &self,
        layout: &Layout,
        points: Range<usize>,
        inverses: &[Matrix3<f64>],
        direction: &[f64],
        moved: &mut [Vector3<f64>],
    ) {
        moved.fill(Vector3::zeros());
        vectorized!(solve_points(
            self, layout, points, inverses, direction, moved
        ));
    }

    /// Adds to the rows of a reduced block what moved points pull it by.
    pub fn add_coupled_points(
        &self,
        layout: &Layout,
        block: usize,
        points: &[Vector3<f64>],
        target: &mut [f64],
    ) {
        vectorized!(add_coupled_points(self, layout, block, points, target));
    }

    /// `xᵀ H x`; also the product of the gradient and `x`.
    pub fn quadratic(&self, layout: &Layout, x: &Step) -> Quadratic {
        let mut square = 0.0;
        let mut slope = dot::<false>(&self.gradient, &x.reduced);
        for i in 0..layout.reduced.len() {
            for block in layout.columns.get(i) {
                let j = block.row as usize;
                let (left, right) = (&x.reduced[layout.rows(j)], &x.reduced[layout.rows(i)]);
                let values = &self.hessian[block.start..][..left.len() * right.len()];
                let mut product = 0.0;
                for (column, factor) in values.chunks_exact(left.len().max(1)).zip(right) {
                    product += dot::<false>(column, left) * factor;
                }
                square += if j == i { product } else { 2.0 * product };
            }
        }
        for (p, delta) in x.points.iter().enumerate() {
            let mut coupled = Vector3::zeros();
            for pair in layout.pairs_at(p) {
                let rows = &x.reduced[layout.rows(pair.reduced as usize)];
                let values = &self.coupling[pair.start..][..POINT * rows.len()];
                add_transposed_vector::<false>(coupled.as_mut_slice(), values, rows);
            }
            square += delta.dot(&(self.point_hessian[p] * delta + 2.0 * coupled));
            slope += delta.dot(&self.point_gradient[p]);
        }
        Quadratic { square, slope }
    }

    /// Decrease of the cost that the quadratic model foresees for a step of `(H + λ diag H) δ = −g`:
    /// `½ δᵀ(λ diag H δ − g)`.
    pub fn predicted_decrease(&self, step: &Step, lambda: f64) -> f64 {
        let term = |delta: f64, diagonal: f64, gradient: f64| {
            0.5 * delta * (self.damping(diagonal, lambda) * delta - gradient)
        };
        let mut decrease = 0.0;
        for ((delta, diagonal), gradient) in
            step.reduced.iter().zip(&self.diagonal).zip(&self.gradient)
        {
            decrease += term(*delta, *diagonal, *gradient);
        }
        for ((delta, hessian), gradient) in step
            .points
            .iter()
            .zip(&self.point_hessian)
            .zip(&self.point_gradient)
        {
            for d in 0..POINT {
                decrease += term(delta[d], hessian[(d, d)], gradient[d]);
            }
        }
        decrease
    }
}

/// `xᵀ H x` and `gᵀ x`.
pub(crate) struct Quadratic {
    pub square: f64,
    pub slope: f64,
}

impl ReducedSystem {
    pub fn new(layout: &Layout) -> Self {
        Self {
            matrix: vec![0.0; layout.matrix_len],
            right_side: vec![0.0; layout.dimension()],
            point_inverse: vec![Matrix3::zeros(); layout.points.len()],
        }
    }
}

/// The inverse by cofactors, which is as exact as the matrix is well scaled; `None` where it is not positive definite.
pub(crate) fn inverse_of_symmetric(m: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let (a, b, c) = (m[(0, 0)], m[(1, 0)], m[(2, 0)]);
    let (d, e, f) = (m[(1, 1)], m[(2, 1)], m[(2, 2)]);
    let (x, y, z) = (d * f - e * e, c * e - b * f, b * e - c * d);
    let determinant = a * x + b * y + c * z;
    let minor = a * d - b * b;
    if !(a > 0.0 && minor > 0.0 && determinant > 0.0) {
        return None;
    }
    let s = 1.0 / determinant;
    let (yz, w) = (b * c - a * e, a * f - c * c);
    let inverse = Matrix3::new(
        x * s,
        y * s,
        z * s,
        y * s,
        w * s,
        yz * s,
        z * s,
        yz * s,
        minor * s,
    );
    inverse.iter().all(|x| x.is_finite()).then_some(inverse)
}

#[inline(always)]
fn assemble_points<const FUSED: bool>(
    (problem, layout, points, parts): (&Problem, &Layout, Range<usize>, PointParts<'_>),
) {
    let record_base = layout.record_start[layout.point_first[points.start]];
    let pair_base = layout.pair_value_start(points.start);
    parts.coupling.fill(0.0);
    for ((point, h), g) in points.zip(parts.hessian).zip(parts.gradient) {
        *h = Matrix3::zeros();
        *g = Vector3::zeros();
        for k in layout.point_first[point]..layout.point_first[point + 1] {
            let record = &parts.records
                [layout.record_start[k] - record_base..layout.record_start[k + 1] - record_base];
            let dimension = problem.residuals[layout.order[k] as usize].dimension;
            let slots = layout.slots_of(k);
            let Some(own) = slots
                .iter()
                .find(|slot| layout.places[slot.block as usize] == Place::Point(point))
            else {
                continue;
            };
            let by_point = &record[own.jacobian as usize..][..dimension * POINT];
            add_product::<FUSED>(h.as_mut_slice(), by_point, POINT, by_point, POINT);
            add_product::<FUSED>(g.as_mut_slice(), by_point, POINT, &record[..dimension], 1);
            for slot in slots {
                let Some(pair) = layout.pairs.get(slot.pair as usize) else {
                    continue;
                };
                let n = layout.tangent(pair.reduced as usize);
                let block = &mut parts.coupling[pair.start - pair_base..][..POINT * n];
                let jacobian = &record[slot.jacobian as usize..][..dimension * n];
                add_product::<FUSED>(block, jacobian, n, by_point, POINT);
            }
        }
    }
}

#[inline(always)]
fn assemble_columns<const FUSED: bool>(
    (problem, layout, columns, records, parts): (
        &Problem,
        &Layout,
        Range<usize>,
        &[f64],
        ColumnParts<'_>,
    ),
) {
    let value_base = layout.column_value_start(columns.start);
    let row_base = layout.row_start[columns.start];
    parts.matrix.fill(0.0);
    parts.gradient.fill(0.0);
    for (k, residual) in layout.order.iter().enumerate() {
        for slot in layout.slots_of(k) {
            let Place::Reduced(i) = layout.places[slot.block as usize] else {
                continue;
            };
            if !columns.contains(&i) {
                continue;
            }
            let record = &records[layout.record_start[k]..layout.record_start[k + 1]];
            let dimension = problem.residuals[*residual as usize].dimension;
            let n = layout.tangent(i);
            let own = &record[slot.jacobian as usize..][..dimension * n];
            let gradient = &mut parts.gradient[layout.row_start[i] - row_base..][..n];
            add_product::<FUSED>(gradient, own, n, &record[..dimension], 1);
            let start = layout.column_value_start(i) - value_base;
            add_product::<FUSED>(&mut parts.matrix[start..][..n * n], own, n, own, n);
            let [first, end] = slot.couplings;
            for coupling in &layout.couplings[first as usize..end as usize] {
                let block = layout.columns.items[coupling.block as usize];
                let m = layout.tangent(block.row as usize);
                let other = &record[coupling.jacobian as usize..][..dimension * m];
                let target = &mut parts.matrix[block.start - value_base..][..m * n];
                add_product::<FUSED>(target, other, m, own, n);
            }
        }
    }
    for i in columns {
        let n = layout.tangent(i);
        let start = layout.column_value_start(i) - value_base;
        let rows = layout.row_start[i] - row_base..layout.row_start[i + 1] - row_base;
        for (c, entry) in parts.diagonal[rows].iter_mut().enumerate() {
            *entry = parts.matrix[start + c * n + c];
        }
    }
}

/// Right side of the reduced system in some rows: `−g + H_rp H_pp⁻¹ g_p`.
#[inline(always)]
fn right_side_of<const FUSED: bool>(
    (normal, layout, blocks, inverses, rows): (
        &NormalEquations,
        &Layout,
        Range<usize>,
        &[Matrix3<f64>],
        &mut [f64],
    ),
) {
    let base = layout.row_start[blocks.start];
    for (t, g) in rows.iter_mut().zip(&normal.gradient[base..]) {
        *t = -g;
    }
    for (p, inverse) in inverses.iter().enumerate() {
        let moved = inverse * normal.point_gradient[p];
        for pair in layout.pairs_at(p) {
            let i = pair.reduced as usize;
            if blocks.contains(&i) {
                let n = layout.tangent(i);
                let coupling = &normal.coupling[pair.start..][..POINT * n];
                let target = &mut rows[layout.row_start[i] - base..][..n];
                add_matrix_vector::<FUSED>(target, coupling, moved.as_slice());
            }
        }
    }
}

#[inline(always)]
fn subtract_points<const FUSED: bool>(
    (normal, layout, lambda, columns, inverses, matrix, rows): (
        &NormalEquations,
        &Layout,
        f64,
        Range<usize>,
        &[Matrix3<f64>],
        &mut [f64],
        &mut [f64],
    ),
) {
    let base = layout.column_value_start(columns.start);
    let row_base = layout.row_start[columns.start];
    for (t, g) in rows.iter_mut().zip(&normal.gradient[row_base..]) {
        *t = -g;
    }
    matrix.copy_from_slice(&normal.hessian[base..base + matrix.len()]);
    for i in columns.clone() {
        let n = layout.tangent(i);
        let start = layout.column_value_start(i) - base;
        for (c, diagonal) in normal.diagonal[layout.rows(i)].iter().enumerate() {
            matrix[start + c * n + c] += normal.damping(*diagonal, lambda);
        }
    }
    let mut gain = [0.0; POINT * MAX_GAIN];
    for (p, inverse) in inverses.iter().enumerate() {
        let pairs = layout.pairs_at(p);
        let moved = inverse * normal.point_gradient[p];
        let mut blocks = layout.first_of_pairs[p];
        for (a, pair) in pairs.iter().enumerate() {
            let of_pairs = &layout.block_of_pairs[blocks..][..pairs.len() - a];
            blocks += of_pairs.len();
            let i = pair.reduced as usize;
            if i < columns.start {
                continue;
            }
            if i >= columns.end {
                break;
            }
            let n = layout.tangent(i);
            let coupling = &normal.coupling[pair.start..][..POINT * n];
            let own_rows = &mut rows[layout.row_start[i] - row_base..][..n];
            add_matrix_vector::<FUSED>(own_rows, coupling, moved.as_slice());
            // Wide blocks are taken in parts of their columns, so that the gain needs no memory of its own.
            for first in (0..n).step_by(MAX_GAIN) {
                let part = (n - first).min(MAX_GAIN);
                let gain = &mut gain[..POINT * part];
                if part == n {
                    multiply_inverse::<FUSED>(gain, coupling, n, &inverse.data.0);
                } else {
                    for c in 0..POINT {
                        for r in 0..part {
                            gain[c * part + r] = (0..POINT)
                                .map(|k| coupling[k * n + first + r] * inverse[(k, c)])
                                .sum();
                        }
                    }
                }
                for (other, block) in pairs[a..].iter().zip(of_pairs) {
                    let block = layout.columns.items[*block as usize];
                    let m = layout.tangent(other.reduced as usize);
                    let left = &normal.coupling[other.start..][..POINT * m];
                    let target = &mut matrix[block.start - base + first * m..][..m * part];
                    subtract_product::<FUSED>(target, left, m, gain, part);
                }
            }
        }
    }
}

/// Each task over columns reads all residuals or points, so there are no more tasks than threads; every block is
/// summed in the order of residuals and points whatever the task.
fn columns_per_task(layout: &Layout) -> usize {
    layout.reduced.len().div_ceil(rayon::current_num_threads())
}

/// Columns of a block whose gain is kept at a time.
const MAX_GAIN: usize = 16;

/// Adds to the right sides of points what `direction` of the reduced blocks couples to them, and solves for their steps.
#[inline(always)]
fn solve_points<const FUSED: bool>(
    (normal, layout, points, inverses, direction, right): (
        &NormalEquations,
        &Layout,
        Range<usize>,
        &[Matrix3<f64>],
        &[f64],
        &mut [Vector3<f64>],
    ),
) {
    for (point, right) in points.zip(right) {
        for pair in layout.pairs_at(point) {
            let rows = &direction[layout.rows(pair.reduced as usize)];
            let coupling = &normal.coupling[pair.start..][..POINT * rows.len()];
            add_transposed_vector::<FUSED>(right.as_mut_slice(), coupling, rows);
        }
        *right = inverses[point] * -*right;
    }
}

#[inline(always)]
fn add_coupled_points<const FUSED: bool>(
    (normal, layout, block, points, target): (
        &NormalEquations,
        &Layout,
        usize,
        &[Vector3<f64>],
        &mut [f64],
    ),
) {
    for &q in layout.pairs_of_reduced.get(block) {
        let pair = layout.pairs[q as usize];
        let point = &points[layout.point_of_pair[q as usize] as usize];
        let coupling = &normal.coupling[pair.start..][..POINT * target.len()];
        add_matrix_vector::<FUSED>(target, coupling, point.as_slice());
    }
}

fn split_points<'a>(
    layout: &Layout,
    parts: PointParts<'a>,
    range: &Range<usize>,
    middle: usize,
) -> (PointParts<'a>, PointParts<'a>) {
    let start_of = |point: usize| layout.record_start[layout.point_first[point]];
    let records = parts
        .records
        .split_at_mut(start_of(middle) - start_of(range.start));
    let coupling = parts
        .coupling
        .split_at_mut(layout.pair_value_start(middle) - layout.pair_value_start(range.start));
    let hessian = parts.hessian.split_at_mut(middle - range.start);
    let gradient = parts.gradient.split_at_mut(middle - range.start);
    (
        PointParts {
            records: records.0,
            coupling: coupling.0,
            hessian: hessian.0,
            gradient: gradient.0,
        },
        PointParts {
            records: records.1,
            coupling: coupling.1,
            hessian: hessian.1,
            gradient: gradient.1,
        },
    )
}

fn split_columns<'a>(
    layout: &Layout,
    parts: ColumnParts<'a>,
    range: &Range<usize>,
    middle: usize,
) -> (ColumnParts<'a>, ColumnParts<'a>) {
    let rows = layout.row_start[middle] - layout.row_start[range.start];
    let values = layout.column_value_start(middle) - layout.column_value_start(range.start);
    let matrix = parts.matrix.split_at_mut(values);
    let gradient = parts.gradient.split_at_mut(rows);
    let diagonal = parts.diagonal.split_at_mut(rows);
    (
        ColumnParts {
            matrix: matrix.0,
            gradient: gradient.0,
            diagonal: diagonal.0,
        },
        ColumnParts {
            matrix: matrix.1,
            gradient: gradient.1,
            diagonal: diagonal.1,
        },
    )
}
