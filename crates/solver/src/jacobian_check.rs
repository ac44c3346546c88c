use crate::evaluation::evaluate;
use crate::layout::Layout;
use crate::problem::{Problem, ResidualId};
use crate::residual::CONSTANT;
use crate::{Error, Undefined};

/// Step of the central differences, in tangent units.
const STEP: f64 = 1e-5;

/// Compares every analytic Jacobian of the problem with central differences at its values: the test of a residual.
///
/// `tolerance` is relative to the largest entry of the Jacobian in question (and absolute below 1); 1e-7 suits
/// well-scaled residuals. Blocks held constant are left out.
pub fn check_jacobians(problem: &Problem, tolerance: f64) -> Result<(), Error> {
    let layout = Layout::new(problem)?;
    for k in 0..problem.residuals.len() {
        check_residual(problem, &layout, k, tolerance)?;
    }
    Ok(())
}

fn check_residual(
    problem: &Problem,
    layout: &Layout,
    k: usize,
    tolerance: f64,
) -> Result<(), Error> {
    let undefined = |Undefined| Error::Undefined { residual: k };
    let dimension = problem.residuals[k].dimension;
    let mut record = vec![f64::NAN; layout.record_start[k + 1] - layout.record_start[k]];
    evaluate(problem, layout, k, &problem.values, &mut record, true).map_err(undefined)?;

    let mut values = problem.values.clone();
    let mut sides = [vec![f64::NAN; dimension], vec![f64::NAN; dimension]];
    for (position, slot) in layout.slots_of(k).iter().enumerate() {
        if slot.jacobian == CONSTANT {
            continue;
        }
        let block = problem.blocks_of(ResidualId(k))[position];
        let entry = &problem.blocks[block.index()];
        let range = entry.start..entry.start + entry.shape.stored;
        let tangent = entry.shape.tangent;
        let jacobian = &record[slot.jacobian..][..dimension * tangent];
        let scale = jacobian.iter().fold(1.0, |a: f64, x| a.max(x.abs()));
        let mut delta = vec![0.0; tangent];
        for column in 0..tangent {
            for (side, step) in sides.iter_mut().zip([STEP, -STEP]) {
                delta[column] = step;
                (entry.plus)(
                    &problem.values[range.clone()],
                    &delta,
                    &mut values[range.clone()],
                );
                evaluate(problem, layout, k, &values, side, false).map_err(undefined)?;
            }
            delta[column] = 0.0;
            for row in 0..dimension {
                let numeric = (sides[0][row] - sides[1][row]) / (2.0 * STEP);
                let analytic = jacobian[row * tangent + column];
                if !((analytic - numeric).abs() <= tolerance * scale) {
                    return Err(Error::JacobianMismatch {
                        residual: k,
                        position,
                        row,
                        column,
                        analytic,
                        numeric,
                    });
                }
            }
        }
        values[range.clone()].copy_from_slice(&problem.values[range]);
    }
    Ok(())
}
