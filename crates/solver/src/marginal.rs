//! What a problem says of some of its blocks once all others are at their best.

use nalgebra::{DMatrix, DVector};

use crate::covariance::Factored;
use crate::evaluation::{Evaluation, not_finite};
use crate::layout::Layout;
use crate::problem::{BlockId, Problem, Role};
use crate::residual::CONSTANT;
use crate::{Error, Shape};

/// The cost near a problem's values as a function of some blocks alone, `½ (squares + 2 gᵀ δ + δᵀ H δ)`: all other blocks follow.
#[derive(Clone, Debug, PartialEq)]
pub struct Marginal {
    /// `H`, in the blocks' tangents, one after the other. Components that are held have none, and are zero.
    pub information: DMatrix<f64>,
    /// `g`.
    pub gradient: DVector<f64>,
    /// Squares of all residuals, as their kernels weigh them, where these blocks stay and the others are at their best.
    pub squares: f64,
    /// Squares that the others took off.
    pub taken: f64,
}

/// The normal equations of some blocks at the problem's present values, all others eliminated.
///
/// The blocks themselves need not be determined by the data; the others must be.
pub fn marginal(problem: &Problem, blocks: &[BlockId]) -> Result<Marginal, Error> {
    let mut others = problem.clone();
    let mut asked = vec![None; problem.blocks.len()];
    let mut size = 0;
    for block in blocks {
        let Some(entry) = others.blocks.get_mut(block.0) else {
            return Err(Error::UnknownBlock {
                block: block.0,
                blocks: problem.blocks.len(),
            });
        };
        entry.role = Role::Constant;
        asked[block.0] = Some(size);
        let Shape { tangent, .. } = entry.shape;
        size += tangent;
    }
    let followers = Layout::new(&others)?;
    let mut factored = match followers.whole_dimension() {
        0 => None,
        _ => Some(Factored::new(&others, &[])?),
    };
    let followers = factored.as_ref().map_or(&followers, |f| &f.layout);
    let height = followers.whole_dimension();
    // The blocks asked for first, then all others, then the residual.
    let place = |block: usize| -> Vec<usize> {
        let entry = &problem.blocks[block];
        let own = 0..entry.free();
        let others = followers.whole_rows(block);
        match asked[block] {
            Some(first) => own.map(|k| first + entry.component(k)).collect(),
            None => others.map(|row| size + row).collect(),
        }
    };
    let last = size + height;
    // Rows of the blocks asked for and of the residual alone: those of the others among themselves are factored.
    let mut kept = DMatrix::zeros(size + 1, last + 1);
    let layout = Layout::new(problem)?;
    let mut evaluation = Evaluation::new(problem, &layout);
    if let Some(position) = evaluation
        .start(problem, &layout, &problem.values)
        .not_finite
    {
        return Err(not_finite(problem, &layout, position));
    }
    evaluation.begin();
    for (position, residual) in layout.order.iter().enumerate() {
        let length = layout.record_start[position + 1] - layout.record_start[position];
        let mut record = vec![0.0; length];
        let range = position..position + 1;
        evaluation.linearize(problem, &layout, &problem.values, range, &mut record);
        let rows = problem.residuals[*residual as usize].rows();
        let mut columns = vec![(last, record[..rows].to_vec())];
        for slot in layout.slots_of(position) {
            if slot.jacobian == CONSTANT {
                continue;
            }
            let places = place(slot.block as usize);
            let jacobian = &record[slot.jacobian as usize..];
            for (c, place) in places.iter().enumerate() {
                let column = (0..rows).map(|r| jacobian[r * places.len() + c]);
                columns.push((*place, column.collect()));
            }
        }
        for (i, a) in &columns {
            let row = match *i {
                i if i == last => size,
                i if i < size => i,
                _ => continue,
            };
            for (j, b) in &columns {
                let product: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                kept[(row, *j)] += product;
            }
        }
    }
    evaluation.outcome(problem, &layout)?;
    let coupling = kept.columns(size, height).into_owned();
    let mut followed = coupling.transpose();
    if let Some(factored) = &mut factored {
        for mut column in followed.column_iter_mut() {
            let mut right: Vec<f64> = column.iter().copied().collect();
            factored.solve_whole(&mut right);
            column.copy_from_slice(&right);
        }
    }
    let taken = coupling * followed;
    let at = |i: usize, j: usize| {
        let own = kept[(i, if j == size { last } else { j })];
        own - 0.5 * (taken[(i, j)] + taken[(j, i)])
    };
    Ok(Marginal {
        information: DMatrix::from_fn(size, size, at),
        gradient: DVector::from_fn(size, |i, _| at(i, size)),
        squares: at(size, size),
        taken: taken[(size, size)],
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3x2, SMatrix, SVector, Vector2, Vector3};

    use super::*;
    use crate::linear_residual::Linear;
    use crate::{Kernel, dense_jacobian};

    /// Numbers without an order.
    fn number(k: usize) -> f64 {
        ((k * k * 37 + k * 11) % 101) as f64 / 50.0 - 1.0
    }

    #[test]
    fn it_is_the_schur_complement_of_the_dense_matrix_and_asks_nothing_of_its_blocks() {
        let mut problem = Problem::new();
        // Its second component moves nothing.
        let x = problem.add_block(Vector2::new(0.3, -0.2));
        let points = [
            problem.add_block(Vector3::new(0.1, 0.2, 0.3)),
            problem.add_eliminated_point(Vector3::new(-0.4, 0.5, 0.6)),
        ];
        for k in 0..8 {
            let n = 20 * k;
            let residual = Linear {
                a: SMatrix::from_columns(&[
                    Vector2::new(number(n), number(n + 1)),
                    Vector2::zeros(),
                ]),
                b: SMatrix::from_fn(|i, j| number(n + 2 + 3 * i + j)),
                z: Vector2::new(number(n + 8), number(n + 9)),
            };
            let on = [x.id(), points[k % 2].id()];
            let kernel = Kernel::Squared;
            problem.add_residual(residual, &on, kernel).expect("fits");
        }
        let found = marginal(&problem, &[x.id()]).expect("the points are determined");

        let dense = dense_jacobian(&problem).expect("finite");
        let columns =
            |block| -> Vec<usize> { dense.columns_of(block).iter().flatten().copied().collect() };
        let j = dense.matrix.select_columns(&columns(x.id()));
        let rest = points.map(|p| columns(p.id())).concat();
        let k = dense.matrix.select_columns(&rest);
        let inverse = (k.transpose() * &k).try_inverse().expect("determined");
        let off = DMatrix::identity(16, 16) - &k * inverse * k.transpose();
        let information = j.transpose() * &off * &j;
        let gradient = j.transpose() * &off * &dense.residual;
        assert!(
            (&found.information - information).amax() < 1e-12,
            "{found:?}"
        );
        assert!((&found.gradient - gradient).amax() < 1e-12, "{found:?}");
        let squares = dense.residual.dot(&(&off * &dense.residual));
        assert!((found.squares - squares).abs() < 1e-12, "{found:?}");
        let before = dense.residual.norm_squared();
        assert!((found.taken - (before - squares)).abs() < 1e-12);
        // What moves nothing is no error, and nothing is said of it.
        assert_eq!(found.information.column(1).amax(), 0.0);

        // But others that are not determined are one.
        let all: SVector<f64, 3> = SVector::zeros();
        let lonely = problem.add_block(all);
        let residual = Linear {
            a: SMatrix::identity(),
            b: Matrix3x2::from_element(1.0).transpose(),
            z: Vector2::zeros(),
        };
        let on = [x.id(), lonely.id()];
        problem
            .add_residual(residual, &on, Kernel::Squared)
            .expect("fits");
        let refused = marginal(&problem, &[x.id()]);
        assert!(
            matches!(refused, Err(Error::Undetermined { .. })),
            "{refused:?}"
        );
    }
}
