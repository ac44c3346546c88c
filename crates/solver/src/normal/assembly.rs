//! Sums of products of Jacobians.

#![allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::kernels::add_product;
use crate::layout::{Layout, POINT, Part};
use crate::problem::Problem;

/// What the linearization of some points writes.
pub(super) struct PointParts<'a> {
    pub records: &'a mut [f64],
    pub coupling: &'a mut [f64],
    pub hessian: &'a mut [Matrix3<f64>],
    pub gradient: &'a mut [Vector3<f64>],
}

/// What the assembly of some columns of blocks writes.
pub(super) struct ColumnParts<'a> {
    pub matrix: &'a mut [f64],
    pub gradient: &'a mut [f64],
}

pub(super) fn split_points<'a>(
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

pub(super) fn split_columns<'a>(
    layout: &Layout,
    parts: ColumnParts<'a>,
    range: &Range<usize>,
    middle: usize,
) -> (ColumnParts<'a>, ColumnParts<'a>) {
    let rows = layout.row_start[middle] - layout.row_start[range.start];
    let values = layout.column_value_start(middle) - layout.column_value_start(range.start);
    let matrix = parts.matrix.split_at_mut(values);
    let gradient = parts.gradient.split_at_mut(rows);
    (
        ColumnParts {
            matrix: matrix.0,
            gradient: gradient.0,
        },
        ColumnParts {
            matrix: matrix.1,
            gradient: gradient.1,
        },
    )
}

#[inline(always)]
pub(super) fn assemble_points<const FUSED: bool>(
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
            let dimension = problem.residuals[layout.order[k] as usize].rows();
            let slots = layout.slots_of(k);
            let Some(own) = slots
                .iter()
                .find(|slot| layout.parts[slot.block as usize] == Part::Point(point))
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

/// Adds the products of residuals at some positions, whose records begin with those of the first, to some columns.
#[inline(always)]
pub(super) fn assemble_columns<const FUSED: bool>(
    (problem, layout, columns, positions, records, parts): (
        &Problem,
        &Layout,
        Range<usize>,
        Range<usize>,
        &[f64],
        ColumnParts<'_>,
    ),
) {
    let value_base = layout.column_value_start(columns.start);
    let row_base = layout.row_start[columns.start];
    let record_base = layout.record_start[positions.start];
    for k in positions {
        let residual = layout.order[k];
        for slot in layout.slots_of(k) {
            let Part::Reduced(i) = layout.parts[slot.block as usize] else {
                continue;
            };
            if !columns.contains(&i) {
                continue;
            }
            let record = &records
                [layout.record_start[k] - record_base..layout.record_start[k + 1] - record_base];
            let dimension = problem.residuals[residual as usize].rows();
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
}
