//! What groups of residuals do to a result, and what they should do by their weights.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::Error;
use crate::covariance::{Covariance, Factored};
use crate::divide::on_pool;
use crate::evaluation::Evaluation;
use crate::layout::Layout;
use crate::problem::{BlockId, Problem, ResidualId};
use crate::residual::CONSTANT;

/// What one group of residuals `r` with Jacobian `J` does to blocks of covariance `C`.
#[derive(Clone, Debug, PartialEq)]
pub struct Influence {
    /// By how much the group moves the blocks from where the others have them, to first order: `−C Jᵀ r`. At a minimum all
    /// residuals together move them by nothing.
    pub shift: DVector<f64>,
    /// Covariance of the noise in that, were the residuals' own of unit variance and independent: `C Jᵀ J C`. Those of all residuals
    /// together are `C`.
    pub noise: DMatrix<f64>,
}

/// What residuals say of some blocks at the problem's present values.
#[derive(Clone, Debug, PartialEq)]
pub struct Influences {
    /// Joint covariance of the blocks.
    pub covariance: Covariance,
    /// By how much all residuals together would move the blocks: zero at a minimum.
    pub step: DVector<f64>,
    /// By group.
    pub groups: Vec<Influence>,
}

/// The joint covariance of blocks, and the influence of each group of residuals on them, at the problem's present values.
///
/// Groups whose shifts are larger than their noise explains have something in common that the problem does not know of.
pub fn influences(
    problem: &Problem,
    blocks: &[BlockId],
    groups: &[Vec<ResidualId>],
) -> Result<Influences, Error> {
    let mut factored = Factored::new(problem, blocks)?;
    let columns = factored.columns(problem, blocks);
    let (size, reduced) = (columns.dimension(), factored.layout.dimension());
    let mut matrix = DMatrix::zeros(size, size);
    // By row of the whole system, so that what belongs to one block lies together.
    let mut inverse = DMatrix::zeros(size, factored.layout.whole_dimension());
    let mut solved = vec![0.0; reduced];
    for column in &columns.list {
        factored.solve(column, &mut solved);
        columns.fill(&mut matrix, column, &solved);
        let at_points = factored.at_points(column, &solved);
        for (k, value) in solved.iter().chain(&at_points).enumerate() {
            inverse[(column.row, k)] = *value;
        }
    }
    let mut position_of = vec![None; problem.residuals.len()];
    for (position, residual) in factored.layout.order.iter().enumerate() {
        position_of[*residual as usize] = Some(position);
    }
    let (layout, evaluation) = (&factored.layout, &factored.evaluation);
    let influence = |members: &Vec<ResidualId>| {
        let mut influence = Influence {
            shift: DVector::zeros(size),
            noise: DMatrix::zeros(size, size),
        };
        for position in members.iter().filter_map(|id| *position_of.get(id.0)?) {
            let (error, moves) = moves(problem, layout, evaluation, position, &inverse);
            influence.shift -= &moves * error;
            influence.noise.gemm(1.0, &moves, &moves.transpose(), 1.0);
        }
        influence
    };
    let influences = on_pool(|| groups.par_iter().map(influence).collect());
    factored.evaluation.outcome(problem, &factored.layout)?;
    let step = factored.step(problem, blocks);
    Ok(Influences {
        covariance: columns.covariance(blocks, matrix),
        step,
        groups: influences,
    })
}

/// By how much all residuals together would move blocks from the problem's present values, to first order: `−C Jᵀ r`.
pub fn undamped_step(problem: &Problem, blocks: &[BlockId]) -> Result<DVector<f64>, Error> {
    let mut factored = Factored::new(problem, blocks)?;
    Ok(factored.step(problem, blocks))
}

/// A residual and `C Jᵀ` of it, with `inverse` the rows of the inverse asked for.
fn moves(
    problem: &Problem,
    layout: &Layout,
    evaluation: &Evaluation,
    position: usize,
    inverse: &DMatrix<f64>,
) -> (DVector<f64>, DMatrix<f64>) {
    let range = layout.record_start[position]..layout.record_start[position + 1];
    let mut record = vec![0.0; range.len()];
    let only = position..position + 1;
    evaluation.linearize(problem, layout, &problem.values, only, &mut record);
    let rows = problem.residuals[layout.order[position] as usize].rows();
    let mut moves = DMatrix::zeros(inverse.nrows(), rows);
    for slot in layout.slots_of(position) {
        if slot.jacobian == CONSTANT {
            continue;
        }
        let columns = layout.whole_rows(slot.block as usize);
        let free = columns.len();
        let jacobian = &record[slot.jacobian as usize..][..rows * free];
        let by_block = DMatrix::from_row_slice(rows, free, jacobian);
        let of_block = inverse.columns(columns.start, free);
        moves.gemm(1.0, &of_block, &by_block.transpose(), 1.0);
    }
    record.truncate(rows);
    (DVector::from_vec(record), moves)
}

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, SVector, Vector2, Vector3};

    use super::*;
    use crate::linear_residual::Linear;
    use crate::{Block, Kernel, SolveConfig, covariance, dense_jacobian, solve};

    type Blocks = ([Block<Vector2<f64>>; 2], [Block<Vector3<f64>>; 3]);

    /// Two blocks and three eliminated points at their minimum, and their residuals.
    fn solved() -> (Problem, Blocks, Vec<ResidualId>) {
        // Numbers without a pattern.
        let mut at = 0.0;
        let mut next = move || {
            at += 1.0;
            f64::sin(at * at)
        };
        let mut problem = Problem::new();
        let blocks = [0, 1].map(|_| problem.add_block(Vector2::<f64>::zeros()));
        let points = [0, 1, 2].map(|_| problem.add_eliminated_point(Vector3::zeros()));
        let mut ids = Vec::new();
        for _ in 0..4 {
            for block in blocks {
                for point in points {
                    let residual = Linear {
                        a: SMatrix::from_fn(|_, _| next()),
                        b: SMatrix::from_fn(|_, _| next()),
                        z: SVector::from_fn(|_, _| next()),
                    };
                    let on = [block.id(), point.id()];
                    let id = problem.add_residual(residual, &on, Kernel::Squared);
                    ids.push(id.expect("fits"));
                }
            }
        }
        solve(&mut problem, &SolveConfig::default()).expect("solves");
        (problem, (blocks, points), ids)
    }

    #[test]
    fn influences_are_those_of_the_dense_inverse_and_add_up() {
        let (problem, (blocks, points), ids) = solved();
        let asked = [blocks[1].id(), points[2].id()];
        let group: Vec<ResidualId> = ids.iter().copied().step_by(3).collect();
        let Influences {
            covariance: found,
            step,
            groups: parts,
        } = influences(&problem, &asked, &[ids.clone(), group.clone()]).expect("determined");
        assert!(step.amax() < 1e-8, "at a minimum they balance");
        assert_eq!(found, covariance(&problem, &asked).expect("determined"));
        assert_eq!(step, undamped_step(&problem, &asked).expect("determined"));
        assert!((&parts[0].noise - found.joint()).amax() < 1e-10);
        assert!(parts[0].shift.amax() < 1e-8, "at a minimum they balance");

        let dense = dense_jacobian(&problem).expect("defined");
        let inverse = (dense.matrix.transpose() * &dense.matrix).cholesky();
        let inverse = inverse.expect("determined").inverse();
        let moves = inverse * dense.matrix.transpose();
        let layout = Factored::new(&problem, &[]).expect("determined").layout;
        let rows: Vec<usize> = asked
            .iter()
            .flat_map(|b| dense.columns_of(*b).iter().flatten().copied())
            .collect();
        let mut shift = DVector::zeros(rows.len());
        let mut noise = DMatrix::zeros(rows.len(), rows.len());
        for (position, k) in layout.order.iter().enumerate() {
            if !group.contains(&ResidualId(*k as usize)) {
                continue;
            }
            let own = moves.columns(2 * position, 2).select_rows(&rows);
            shift -= &own * dense.residual.rows(2 * position, 2);
            noise += &own * own.transpose();
        }
        assert!(shift.norm() > 1e-3);
        assert!((&parts[1].shift - shift).amax() < 1e-10);
        assert!((&parts[1].noise - noise).amax() < 1e-10);
    }

    /// Also of an eliminated point, and of a block with a component that is held.
    #[test]
    fn one_undamped_step_solves_a_linear_problem_and_groups_add_up_to_it() {
        let (mut problem, (blocks, points), ids) = solved();
        let held = problem.set_constant_components(blocks[1], &[1]);
        held.expect("a component");
        let best = (problem.value(blocks[0]), problem.value(points[2]));
        problem.set_value(blocks[0], &(best.0 + Vector2::new(0.3, -2.0)));
        problem.set_value(points[2], &(best.1 + Vector3::new(5.0, 0.1, -0.7)));
        let asked = [blocks[0].id(), blocks[1].id(), points[2].id()];
        let step = undamped_step(&problem, &asked).expect("determined");
        let all = influences(&problem, &asked, &[ids]).expect("determined");
        assert!((&all.step - &step).amax() < 1e-12);
        assert!((&all.groups[0].shift - &step).amax() < 1e-9);
        let moved = problem.value(blocks[0]) + step.fixed_rows::<2>(0);
        assert!((moved - best.0).amax() < 1e-8, "{moved} {}", best.0);
        assert_eq!(step[3], 0.0, "it is held");
        let moved = problem.value(points[2]) + step.fixed_rows::<3>(4);
        assert!((moved - best.1).amax() < 1e-8, "{moved} {}", best.1);
    }
}
