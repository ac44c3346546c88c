use crate::evaluation::evaluate;
use crate::layout::Layout;
use crate::problem::Problem;
use crate::residual::CONSTANT;
use crate::{Error, Undefined};

/// Step of the central differences, in tangent units.
const STEP: f64 = 1e-5;

/// What [`check_residual_jacobian!`](crate::check_residual_jacobian) expands to, and nothing else should call.
#[doc(hidden)]
pub fn check_jacobians(problem: &Problem, tolerance: f64) -> Result<(), Error> {
    let layout = Layout::new(problem)?;
    for position in 0..layout.order.len() {
        check_residual(problem, &layout, position, tolerance)?;
    }
    Ok(())
}

fn check_residual(
    problem: &Problem,
    layout: &Layout,
    position: usize,
    tolerance: f64,
) -> Result<(), Error> {
    let k = layout.order[position] as usize;
    let undefined = |Undefined| Error::Undefined { residual: k };
    let dimension = problem.residuals[k].rows();
    let mut record =
        vec![f64::NAN; layout.record_start[position + 1] - layout.record_start[position]];
    evaluate(
        problem,
        layout,
        position,
        &problem.values,
        &mut record,
        true,
    )
    .map_err(undefined)?;

    let mut values = problem.values.clone();
    let mut sides = [vec![f64::NAN; dimension], vec![f64::NAN; dimension]];
    for (argument, slot) in layout.slots_of(position).iter().enumerate() {
        if slot.jacobian == CONSTANT {
            continue;
        }
        let entry = &problem.blocks[slot.block as usize];
        let range = entry.stored();
        let tangent = entry.shape.tangent;
        let free = entry.free();
        let jacobian = &record[slot.jacobian as usize..][..dimension * free];
        let scale = jacobian.iter().fold(1.0, |a: f64, x| a.max(x.abs()));
        let mut delta = vec![0.0; tangent];
        for column in 0..free {
            let component = entry.component(column);
            for (side, step) in sides.iter_mut().zip([STEP, -STEP]) {
                delta[component] = step;
                (entry.plus)(
                    &problem.values[range.clone()],
                    &delta,
                    &mut values[range.clone()],
                );
                evaluate(problem, layout, position, &values, side, false).map_err(undefined)?;
            }
            delta[component] = 0.0;
            for row in 0..dimension {
                let numeric = (sides[0][row] - sides[1][row]) / (2.0 * STEP);
                let analytic = jacobian[row * free + column];
                if !((analytic - numeric).abs() <= tolerance * scale) {
                    return Err(Error::JacobianMismatch {
                        residual: k,
                        position: argument,
                        row,
                        column: component,
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

/// Adds blocks with these values to a problem; gives their handles.
#[macro_export]
#[doc(hidden)]
macro_rules! values_of {
    ($problem:ident, $($value:expr),+ $(,)?) => {
        [$($problem.add_block($value).id()),+]
    };
}

/// The test of a residual: its analytic Jacobians are those of central differences.
///
/// With a name it is a test of that name, at the values given, one for each block that the residual reads. Within a test,
/// `all of` checks every residual of a problem at its values; blocks held constant are left out.
///
/// The tolerance is relative to the largest entry of the Jacobian in question (and absolute below 1): 1e-7, which suits
/// well-scaled residuals, or what `within` says.
///
/// ```
/// use lsfb_solver::{Kernel, Problem, VectorPrior, check_residual_jacobian};
/// use nalgebra::Vector2;
///
/// check_residual_jacobian!(prior, VectorPrior::new(Vector2::new(1.0, 2.0), Vector2::new(0.5, 3.0)), Vector2::new(4.0, -1.0));
///
/// let mut problem = Problem::new();
/// let block = problem.add_block(Vector2::new(4.0, -1.0));
/// let prior = VectorPrior::new(Vector2::new(1.0, 2.0), Vector2::new(0.5, 3.0));
/// problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
/// check_residual_jacobian!(all of problem, within 1e-9);
/// # Ok::<(), lsfb_solver::Error>(())
/// ```
#[macro_export]
macro_rules! check_residual_jacobian {
    (all of $problem:expr) => {
        $crate::check_residual_jacobian!(all of $problem, within 1e-7)
    };
    (all of $problem:expr, within $tolerance:expr) => {
        $crate::check_jacobians(&$problem, $tolerance).expect("Jacobians match")
    };
    ($name:ident, $residual:expr, $($value:expr),+ $(,)?) => {
        #[test]
        fn $name() {
            let mut problem = $crate::Problem::new();
            let blocks = $crate::values_of!(problem, $($value),+);
            problem
                .add_residual($residual, &blocks, $crate::Kernel::Squared)
                .expect("the values are of the blocks it reads");
            $crate::check_residual_jacobian!(all of problem);
        }
    };
}
