use nalgebra::{DMatrix, DVector};

use crate::evaluation::Evaluation;
use crate::layout::{Layout, Part};
use crate::minimise::check_values;
use crate::problem::{BlockId, Problem};
use crate::residual::CONSTANT;
use crate::{Error, Shape};

/// A small problem as one matrix: `½ ‖r + J δ‖²` near its values.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseJacobian {
    /// Residuals, weighted by their kernels, points' first.
    pub residual: DVector<f64>,
    /// Their derivatives by all free components.
    pub matrix: DMatrix<f64>,
    columns: Vec<Vec<Option<usize>>>,
}

impl DenseJacobian {
    /// Column of each component of a block's tangent; `None` for those that are held.
    pub fn columns_of(&self, block: BlockId) -> &[Option<usize>] {
        self.columns.get(block.0).map_or(&[], Vec::as_slice)
    }
}

/// The Jacobian of a whole problem at its values, for a look at small ones: it has as many numbers as residuals times
/// parameters.
pub fn dense_jacobian(problem: &Problem) -> Result<DenseJacobian, Error> {
    check_values(problem)?;
    let layout = Layout::new(problem)?;
    let mut evaluation = Evaluation::new(problem, &layout);
    evaluation.start(problem, &layout, &problem.values);
    let mut width = 0;
    let mut columns = Vec::new();
    for (part, entry) in layout.parts.iter().zip(&problem.blocks) {
        let Shape { tangent, .. } = entry.shape;
        let mut own = vec![None; tangent];
        if *part != Part::Constant {
            for k in 0..entry.free() {
                own[entry.component(k)] = Some(width);
                width += 1;
            }
        }
        columns.push(own);
    }
    let dimension = |k: &u32| problem.residuals[*k as usize].rows();
    let height = layout.order.iter().map(dimension).sum();
    let mut residual = DVector::zeros(height);
    let mut matrix = DMatrix::zeros(height, width);
    let mut first = 0;
    evaluation.begin();
    for (position, k) in layout.order.iter().enumerate() {
        let mut record =
            vec![0.0; layout.record_start[position + 1] - layout.record_start[position]];
        let range = position..position + 1;
        evaluation.linearize(problem, &layout, &problem.values, range, &mut record);
        let rows = dimension(k);
        residual
            .rows_mut(first, rows)
            .copy_from_slice(&record[..rows]);
        for slot in layout.slots_of(position) {
            if slot.jacobian == CONSTANT {
                continue;
            }
            let own = columns[slot.block as usize].iter().flatten();
            let jacobian = &record[slot.jacobian as usize..];
            let free = own.clone().count();
            for (c, column) in own.enumerate() {
                for r in 0..rows {
                    matrix[(first + r, *column)] = jacobian[r * free + c];
                }
            }
        }
        first += rows;
    }
    evaluation.outcome(problem, &layout)?;
    Ok(DenseJacobian {
        residual,
        matrix,
        columns,
    })
}
