mod assembly;
mod elimination;

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::divide::{divide, divide_slice};
use crate::evaluation::Evaluation;
use crate::kernels::{add_transposed_vector, dot, vectorized};
use crate::layout::{Layout, POINT};
use crate::problem::Problem;
use assembly::{
    ColumnParts, PointParts, assemble_columns, assemble_points, split_columns, split_points,
};
use elimination::{right_side_of, solve_points, subtract_points};

/// Points, and residuals without a point, per parallel task.
const POINT_GRAIN: usize = 32;
const RESIDUAL_GRAIN: usize = 64;

/// Numbers of residuals and Jacobians that are held at once, but for those of a single point: they are summed up in pieces, since those of all residuals of a
/// long walk's map are the most memory that a solve takes.
const RECORDS_AT_ONCE: usize = 1 << 18;

/// Diagonal entries below this share of the largest are damped as if they were there.
const SMALLEST_DAMPED_SHARE: f64 = 1e-12;

/// The normal equations `H δ = −g`, with eliminated points apart from the reduced blocks.
pub(crate) struct NormalEquations {
    /// Residuals and Jacobians of one piece of the residuals.
    records: Vec<f64>,
    pieces: Vec<Piece>,
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

impl NormalEquations {
    pub fn new(layout: &Layout) -> Self {
        let pieces = pieces(layout);
        let longest = pieces.iter().map(|piece| piece.record_len(layout)).max();
        Self {
            records: vec![0.0; longest.unwrap_or(0)],
            pieces,
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
        self.hessian.fill(0.0);
        self.gradient.fill(0.0);
        for number in 0..self.pieces.len() {
            let piece = self.pieces[number].clone();
            self.linearize_piece(problem, layout, evaluation, values, &piece);
            self.assemble_reduced(problem, layout, piece.positions(layout));
        }
        self.read_diagonal(layout);
        let points = self
            .point_hessian
            .iter()
            .flat_map(|h| [h[(0, 0)], h[(1, 1)], h[(2, 2)]]);
        self.floor = SMALLEST_DAMPED_SHARE
            * points
                .chain(self.diagonal.iter().copied())
                .fold(0.0, f64::max);
    }

    /// Fills the records of one piece, and sums up what its points have.
    fn linearize_piece(
        &mut self,
        problem: &Problem,
        layout: &Layout,
        evaluation: &Evaluation,
        values: &[f64],
        piece: &Piece,
    ) {
        let records = &mut self.records[..piece.record_len(layout)];
        match piece {
            Piece::Points(points) => {
                let pair_values =
                    layout.pair_value_start(points.start)..layout.pair_value_start(points.end);
                let parts = PointParts {
                    records,
                    coupling: &mut self.coupling[pair_values],
                    hessian: &mut self.point_hessian[points.clone()],
                    gradient: &mut self.point_gradient[points.clone()],
                };
                divide(
                    points.clone(),
                    POINT_GRAIN,
                    parts,
                    &|parts, range, middle| split_points(layout, parts, range, middle),
                    &|points, parts| {
                        let first = layout.point_first[points.start];
                        let positions = first..layout.point_first[points.end];
                        evaluation.linearize(problem, layout, values, positions, parts.records);
                        vectorized!(assemble_points(problem, layout, points, parts));
                    },
                );
            }
            Piece::Alone(positions) => divide(
                positions.clone(),
                RESIDUAL_GRAIN,
                records,
                &|records: &mut [f64], range, middle| {
                    records.split_at_mut(
                        layout.record_start[middle] - layout.record_start[range.start],
                    )
                },
                &|range, records| evaluation.linearize(problem, layout, values, range, records),
            ),
        }
    }

    /// Adds the products of a piece to the reduced matrix.
    fn assemble_reduced(&mut self, problem: &Problem, layout: &Layout, positions: Range<usize>) {
        let records = &self.records[..];
        let parts = ColumnParts {
            matrix: &mut self.hessian,
            gradient: &mut self.gradient,
        };
        divide(
            0..layout.reduced.len(),
            columns_per_task(layout),
            parts,
            &|parts, range, middle| split_columns(layout, parts, range, middle),
            &|columns, parts| {
                let positions = positions.clone();
                vectorized!(assemble_columns(
                    problem, layout, columns, positions, records, parts
                ))
            },
        );
    }

    fn read_diagonal(&mut self, layout: &Layout) {
        for i in 0..layout.reduced.len() {
            let n = layout.tangent(i);
            let start = layout.column_value_start(i);
            let rows = layout.row_start[i]..layout.row_start[i + 1];
            for (c, entry) in self.diagonal[rows].iter_mut().enumerate() {
                *entry = self.hessian[start + c * n + c];
            }
        }
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

/// Residuals that are linearized and summed up at once.
#[derive(Clone)]
enum Piece {
    /// Those of some points.
    Points(Range<usize>),
    /// Positions without a point.
    Alone(Range<usize>),
}

impl Piece {
    fn positions(&self, layout: &Layout) -> Range<usize> {
        match self {
            Self::Points(points) => {
                layout.point_first[points.start]..layout.point_first[points.end]
            }
            Self::Alone(positions) => positions.clone(),
        }
    }

    fn record_len(&self, layout: &Layout) -> usize {
        let positions = self.positions(layout);
        layout.record_start[positions.end] - layout.record_start[positions.start]
    }
}

/// All residuals in their order, in pieces that do not depend on threads.
fn pieces(layout: &Layout) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let points = layout.points.len();
    let record = |position: usize| layout.record_start[position];
    let of_points = runs(points, |point| record(layout.point_first[point]));
    pieces.extend(of_points.into_iter().map(Piece::Points));
    let first = layout.point_first[points];
    let alone = runs(layout.order.len() - first, |k| record(first + k));
    let alone = alone.into_iter().map(|r| first + r.start..first + r.end);
    pieces.extend(alone.map(Piece::Alone));
    pieces
}

/// Ranges of `count` things, the `k`-th of which has records from `start(k)` on, with as many as are held at once, or a single thing that has more.
fn runs(count: usize, start: impl Fn(usize) -> usize) -> Vec<Range<usize>> {
    let mut runs = Vec::new();
    let mut first = 0;
    for next in 1..=count {
        if next == count || start(next + 1) - start(first) > RECORDS_AT_ONCE {
            runs.push(first..next);
            first = next;
        }
    }
    runs
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

/// Each task over columns reads all residuals or points, so there are no more tasks than threads; every block is
/// summed in the order of residuals and points whatever the task.
fn columns_per_task(layout: &Layout) -> usize {
    layout.reduced.len().div_ceil(rayon::current_num_threads())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_all_in_order_and_no_longer_than_they_may_be() {
        // The fourth is longer than what is held at once.
        let lengths = [0, 1, RECORDS_AT_ONCE - 1, RECORDS_AT_ONCE + 7, 5, 0, 3];
        let start = |k: usize| lengths[..k].iter().sum::<usize>();
        let found = runs(lengths.len(), start);
        assert_eq!(found, [0..3, 3..4, 4..7]);
        assert!(runs(0, |_| 0).is_empty());
        assert_eq!(runs(2, |k| 9 * k).first(), Some(&(0..2)));
    }
}
