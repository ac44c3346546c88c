use crate::layout::{Layout, POINT, Part};
use crate::normal::NormalEquations;
use crate::problem::Problem;

/// Moves every bounded entry of `values` to the nearest value within.
pub(crate) fn clamp(problem: &Problem, values: &mut [f64]) {
    for ((block, component), bounds) in &problem.bounds {
        let entry = &mut values[problem.blocks[*block].start + component];
        *entry = entry.clamp(bounds.lower, bounds.upper);
    }
}

/// Holds those entries of a linearization that lie on a bound and are drawn beyond it.
pub(crate) fn hold_at_bounds(
    problem: &Problem,
    layout: &Layout,
    values: &[f64],
    normal: &mut NormalEquations,
) {
    for ((block, component), bounds) in &problem.bounds {
        let entry = &problem.blocks[*block];
        if entry.mask >> component & 1 == 0 {
            continue;
        }
        let value = values[entry.start + component];
        // Components that are held constant have no column.
        let column = (0..*component).filter(|c| entry.mask >> c & 1 == 1).count();
        let drawn = |gradient: f64| {
            (value <= bounds.lower && gradient > 0.0) || (value >= bounds.upper && gradient < 0.0)
        };
        match layout.parts[*block] {
            Part::Reduced(i) if drawn(normal.gradient[layout.row_start[i] + column]) => {
                hold_reduced(layout, normal, i, column);
            }
            Part::Point(p) if drawn(normal.point_gradient[p][column]) => {
                hold_point(layout, normal, p, column);
            }
            _ => {}
        }
    }
}

fn hold_reduced(layout: &Layout, normal: &mut NormalEquations, i: usize, column: usize) {
    normal.gradient[layout.row_start[i] + column] = 0.0;
    let n = layout.tangent(i);
    let own = layout.column_value_start(i)..layout.column_value_start(i + 1);
    let diagonal = own.start + column * n + column;
    let kept = normal.hessian[diagonal];
    for block in layout.columns.get(i) {
        let m = layout.tangent(block.row as usize);
        normal.hessian[block.start + column * m..][..m].fill(0.0);
    }
    for c in 0..n {
        normal.hessian[own.start + c * n + column] = 0.0;
    }
    normal.hessian[diagonal] = if kept > 0.0 { kept } else { 1.0 };
    for earlier in 0..i {
        let blocks = layout.columns.get(earlier);
        if let Ok(found) = blocks.binary_search_by_key(&(i as u32), |block| block.row) {
            for c in 0..layout.tangent(earlier) {
                normal.hessian[blocks[found].start + c * n + column] = 0.0;
            }
        }
    }
    for &q in layout.pairs_of_reduced.get(i) {
        let start = layout.pairs[q as usize].start;
        for c in 0..POINT {
            normal.coupling[start + c * n + column] = 0.0;
        }
    }
}

fn hold_point(layout: &Layout, normal: &mut NormalEquations, p: usize, column: usize) {
    normal.point_gradient[p][column] = 0.0;
    let hessian = &mut normal.point_hessian[p];
    let kept = hessian[(column, column)];
    for k in 0..POINT {
        hessian[(column, k)] = 0.0;
        hessian[(k, column)] = 0.0;
    }
    hessian[(column, column)] = if kept > 0.0 { kept } else { 1.0 };
    for pair in layout.pairs_at(p) {
        let n = layout.tangent(pair.reduced as usize);
        normal.coupling[pair.start + column * n..][..n].fill(0.0);
    }
}
