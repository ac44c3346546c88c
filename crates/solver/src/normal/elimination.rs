//! Points out of the normal equations, and back in.

#![allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use super::NormalEquations;
use crate::kernels::{
    add_matrix_vector, add_transposed_vector, multiply_inverse, subtract_product,
};
use crate::layout::{Layout, POINT};

/// Columns of a block whose gain is kept at a time.
const MAX_GAIN: usize = 16;

/// Right side of the reduced system in some rows: `−g + H_rp H_pp⁻¹ g_p`.
#[inline(always)]
pub(super) fn right_side_of<const FUSED: bool>(
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
pub(super) fn subtract_points<const FUSED: bool>(
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

/// Adds to the right sides of points what `direction` of the reduced blocks couples to them, and solves for their steps.
#[inline(always)]
pub(super) fn solve_points<const FUSED: bool>(
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
