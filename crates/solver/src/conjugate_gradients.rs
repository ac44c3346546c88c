#![allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::divide::divide;
use crate::kernels::{
    add_matrix_vector, add_transposed_vector, dot, multiply_inverse, subtract_product, vectorized,
};
use crate::layout::{Layout, POINT};
use crate::normal::{NormalEquations, ReducedSystem};

/// Sums over points are made of this many, whatever the number of threads.
const PARTS: usize = 16;

/// Steps end once one lowers the quadratic model by less than this share of what they did on average: what is left are
/// directions of weak curvature, in which the next linearization goes on.
const LEAST_GAIN: f64 = 0.1;

/// Conjugate gradients on the Schur complement, which is applied point by point and never formed. Preconditioned with
/// the inverses of its diagonal blocks.
pub(crate) struct ConjugateGradients {
    tolerance: f64,
    max_steps: usize,
    /// Inverse of each diagonal block.
    inverses: Vec<f64>,
    inverse_start: Vec<usize>,
    residual: Vec<f64>,
    direction: Vec<f64>,
    preconditioned: Vec<f64>,
    applied: Vec<f64>,
    /// What points pull the reduced blocks by: the sum of each of [`PARTS`] ranges of points.
    parts: Vec<f64>,
}

impl ConjugateGradients {
    pub fn new(layout: &Layout, tolerance: f64, max_steps: usize) -> Self {
        let mut inverse_start = vec![0];
        for i in 0..layout.reduced.len() {
            inverse_start.push(inverse_start[i] + layout.tangent(i).pow(2));
        }
        let zeros = || vec![0.0; layout.dimension()];
        Self {
            tolerance,
            max_steps,
            inverses: vec![0.0; inverse_start[layout.reduced.len()]],
            inverse_start,
            residual: zeros(),
            direction: zeros(),
            preconditioned: zeros(),
            applied: zeros(),
            parts: vec![0.0; PARTS * layout.dimension()],
        }
    }

    /// Solves for the reduced step; `false` where the matrix turns out not to be positive definite.
    pub fn solve(
        &mut self,
        normal: &NormalEquations,
        layout: &Layout,
        lambda: f64,
        system: &ReducedSystem,
        step: &mut [f64],
    ) -> bool {
        if !self.invert_diagonal(normal, layout, lambda, system) {
            return false;
        }
        step.fill(0.0);
        self.residual.copy_from_slice(&system.right_side);
        self.precondition(layout);
        self.direction.copy_from_slice(&self.preconditioned);
        let mut product = dot::<false>(&self.residual, &self.preconditioned);
        let goal = self.tolerance.powi(2) * product;
        let mut decrease = 0.0;
        for k in 0..self.max_steps {
            if !(product > goal) {
                break;
            }
            self.apply(normal, layout, lambda, system);
            let curvature = dot::<false>(&self.direction, &self.applied);
            if !(curvature > 0.0 && curvature.is_finite()) {
                return false;
            }
            let length = product / curvature;
            for (k, x) in step.iter_mut().enumerate() {
                *x += length * self.direction[k];
                self.residual[k] -= length * self.applied[k];
            }
            let gain = 0.5 * length * product;
            decrease += gain;
            if gain * (k as f64 + 1.0) < LEAST_GAIN * decrease {
                break;
            }
            self.precondition(layout);
            let next = dot::<false>(&self.residual, &self.preconditioned);
            let turn = next / product;
            product = next;
            for (d, z) in self.direction.iter_mut().zip(&self.preconditioned) {
                *d = z + turn * *d;
            }
        }
        step.iter().all(|x| x.is_finite())
    }

    fn invert_diagonal(
        &mut self,
        normal: &NormalEquations,
        layout: &Layout,
        lambda: f64,
        system: &ReducedSystem,
    ) -> bool {
        let inverse_start = &self.inverse_start;
        divide(
            0..layout.reduced.len(),
            1,
            &mut self.inverses[..],
            &|inverses: &mut [f64], range, middle| {
                inverses.split_at_mut(inverse_start[middle] - inverse_start[range.start])
            },
            &|blocks, inverses| {
                let base = inverse_start[blocks.start];
                for i in blocks {
                    let target =
                        &mut inverses[inverse_start[i] - base..inverse_start[i + 1] - base];
                    vectorized!(diagonal_block(
                        normal,
                        layout,
                        lambda,
                        system,
                        i,
                        &mut *target
                    ));
                    invert(target, layout.tangent(i));
                }
            },
        );
        self.inverses.iter().all(|x| x.is_finite())
    }

    fn precondition(&mut self, layout: &Layout) {
        self.preconditioned.fill(0.0);
        for i in 0..layout.reduced.len() {
            let inverse = &self.inverses[self.inverse_start[i]..self.inverse_start[i + 1]];
            let target = &mut self.preconditioned[layout.rows(i)];
            add_matrix_vector::<false>(target, inverse, &self.residual[layout.rows(i)]);
        }
    }

    /// `applied = S direction`.
    fn apply(
        &mut self,
        normal: &NormalEquations,
        layout: &Layout,
        lambda: f64,
        system: &ReducedSystem,
    ) {
        let direction = &self.direction;
        let rows = layout.dimension();
        let first_of = |part: usize| part * layout.points.len() / PARTS;
        divide(
            0..PARTS,
            1,
            &mut self.parts[..],
            &|parts: &mut [f64], range, middle| parts.split_at_mut((middle - range.start) * rows),
            &|range, parts| {
                for part in range.clone() {
                    let target = &mut parts[(part - range.start) * rows..][..rows];
                    let points = first_of(part)..first_of(part + 1);
                    let inverses = &system.point_inverse[..];
                    vectorized!(pull_through_points(
                        normal,
                        layout,
                        points,
                        inverses,
                        &direction[..],
                        &mut *target
                    ));
                }
            },
        );
        for (k, applied) in self.applied.iter_mut().enumerate() {
            *applied = normal.damping(normal.diagonal[k], lambda) * direction[k];
        }
        for i in 0..layout.reduced.len() {
            for (k, block) in layout.columns.get(i).iter().enumerate() {
                let (rows, columns) = (layout.rows(block.row as usize), layout.rows(i));
                let values = &normal.hessian[block.start..][..rows.len() * columns.len()];
                let x = &direction[columns.clone()];
                add_matrix_vector::<false>(&mut self.applied[rows.clone()], values, x);
                if k > 0 {
                    let target = &mut self.applied[columns];
                    add_transposed_vector::<false>(target, values, &direction[rows]);
                }
            }
        }
        for part in 0..PARTS {
            let pulls = &self.parts[part * rows..][..rows];
            for (applied, pull) in self.applied.iter_mut().zip(pulls) {
                *applied += pull;
            }
        }
    }
}

/// What a direction of the reduced blocks pulls them by through some points, which move with it: `−H_rp H_pp⁻¹ H_pr`
/// times it. One way through the couplings, which are most of what there is to read.
#[inline(always)]
fn pull_through_points<const FUSED: bool>(
    (normal, layout, points, inverses, direction, target): (
        &NormalEquations,
        &Layout,
        Range<usize>,
        &[Matrix3<f64>],
        &[f64],
        &mut [f64],
    ),
) {
    target.fill(0.0);
    for point in points {
        let pairs = layout.pairs_at(point);
        let mut right = Vector3::zeros();
        for pair in pairs {
            let rows = &direction[layout.rows(pair.reduced as usize)];
            let coupling = &normal.coupling[pair.start..][..POINT * rows.len()];
            add_transposed_vector::<FUSED>(right.as_mut_slice(), coupling, rows);
        }
        let moved = inverses[point] * -right;
        for pair in pairs {
            let rows = &mut target[layout.rows(pair.reduced as usize)];
            let coupling = &normal.coupling[pair.start..][..POINT * rows.len()];
            add_matrix_vector::<FUSED>(rows, coupling, moved.as_slice());
        }
    }
}

/// Diagonal block of the Schur complement.
#[inline(always)]
fn diagonal_block<const FUSED: bool>(
    (normal, layout, lambda, system, i, target): (
        &NormalEquations,
        &Layout,
        f64,
        &ReducedSystem,
        usize,
        &mut [f64],
    ),
) {
    let n = layout.tangent(i);
    target.copy_from_slice(&normal.hessian[layout.column_value_start(i)..][..n * n]);
    for (c, diagonal) in normal.diagonal[layout.rows(i)].iter().enumerate() {
        target[c * n + c] += normal.damping(*diagonal, lambda);
    }
    let mut short = [0.0; POINT * 16];
    let mut long = Vec::new();
    let gain = if n <= 16 {
        &mut short[..POINT * n]
    } else {
        long.resize(POINT * n, 0.0);
        &mut long[..]
    };
    for &q in layout.pairs_of_reduced.get(i) {
        let inverse = &system.point_inverse[layout.point_of_pair[q as usize] as usize];
        let coupling = &normal.coupling[layout.pairs[q as usize].start..][..POINT * n];
        multiply_inverse::<FUSED>(gain, coupling, n, &inverse.data.0);
        subtract_product::<FUSED>(target, coupling, n, gain, n);
    }
}

/// Inverts a symmetric positive matrix in place, by Gauss and Jordan; one that is not gives numbers that are not finite.
fn invert(matrix: &mut [f64], n: usize) {
    for k in 0..n {
        let pivot = matrix[k * n + k];
        let scale = if pivot > 0.0 { 1.0 / pivot } else { f64::NAN };
        matrix[k * n + k] = 1.0;
        for r in 0..n {
            matrix[r * n + k] *= scale;
        }
        for c in (0..n).filter(|c| *c != k) {
            let factor = matrix[k * n + c];
            matrix[k * n + c] = 0.0;
            for r in 0..n {
                matrix[r * n + c] -= factor * matrix[r * n + k];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_matrices_are_inverted_in_place() {
        let matrix = Matrix3::new(4.0, 1.0, -0.5, 1.0, 3.0, 0.2, -0.5, 0.2, 2.0);
        let mut inverse = matrix;
        invert(inverse.as_mut_slice(), 3);
        assert!((inverse * matrix - Matrix3::identity()).amax() < 1e-14);
    }
}
