use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use crate::diagnosis::undetermined;
use crate::divide::on_pool;
use crate::evaluation::{Evaluation, not_finite};
use crate::factorization::Factorization;
use crate::layout::{Layout, POINT, Part};
use crate::linear_system::{LinearSystem, Solver};
use crate::minimise::check_values;
use crate::normal::{NormalEquations, ReducedSystem};
use crate::problem::{BlockId, Problem};
use crate::{Error, SolveConfig};

/// Joint covariance of some blocks, in their tangents: the inverse of the normal matrix, as far as they go.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    blocks: Vec<BlockId>,
    /// First row of each block; one more entry: the dimension.
    start: Vec<usize>,
    matrix: DMatrix<f64>,
}

impl Covariance {
    /// Covariance of one block, or of one with another; `None` for a block that was not asked for. Components that are
    /// held have none, and are zero.
    pub fn between(&self, a: BlockId, b: BlockId) -> Option<DMatrix<f64>> {
        let rows = |block: BlockId| {
            let k = self.blocks.iter().position(|other| *other == block)?;
            Some((self.start[k], self.start[k + 1] - self.start[k]))
        };
        let ((row, height), (column, width)) = (rows(a)?, rows(b)?);
        let view = self.matrix.view((row, column), (height, width));
        Some(view.into_owned())
    }

    /// The same with each standard deviation multiplied, and the square of what a bias may be added: one number of each for a row
    /// of [`Covariance::joint`].
    pub fn widened(mut self, factors: &[f64], bias: &DVector<f64>) -> Self {
        for (row, factor) in factors.iter().enumerate().take(self.matrix.nrows()) {
            let mut of_row = self.matrix.row_mut(row);
            of_row *= *factor;
            let mut of_column = self.matrix.column_mut(row);
            of_column *= *factor;
        }
        self.matrix.ger(1.0, bias, bias, 1.0);
        self
    }

    /// All blocks, in the order in which they were asked for.
    pub fn joint(&self) -> &DMatrix<f64> {
        &self.matrix
    }
}

/// Covariance of the blocks at the problem's present values, with the weights that robust kernels have there.
///
/// Exact for any blocks, eliminated points included; the work is one factorization and one solve for each dimension
/// asked for. Where the data does not determine the problem there is no covariance, and the error names a parameter.
pub fn covariance(problem: &Problem, blocks: &[BlockId]) -> Result<Covariance, Error> {
    Ok(Factored::new(problem, blocks)?.covariance(problem, blocks))
}

/// [`covariance`] of each of several groups of blocks, by one factorization: what lies between groups is not computed, so that memory
/// grows with the largest group alone. Before each group `each` is told how many are done; what it refuses with ends the work.
pub fn covariance_of_groups<E: From<Error>>(
    problem: &Problem,
    groups: &[Vec<BlockId>],
    mut each: impl FnMut(usize) -> Result<(), E>,
) -> Result<Vec<Covariance>, E> {
    let mut factored = Factored::new(problem, &groups.concat())?;
    let groups = groups.iter().enumerate().map(|(done, blocks)| {
        each(done)?;
        Ok(factored.covariance(problem, blocks))
    });
    groups.collect()
}

/// The normal matrix at a problem's values, factored.
pub(crate) struct Factored {
    pub layout: Layout,
    pub evaluation: Evaluation,
    normal: NormalEquations,
    reduced: ReducedSystem,
    factorization: Factorization,
}

impl Factored {
    /// Fails where one of the blocks has no covariance, or the data does not determine the problem.
    pub fn new(problem: &Problem, blocks: &[BlockId]) -> Result<Self, Error> {
        check_values(problem)?;
        let mut layout = Layout::new(problem)?;
        for block in blocks {
            match layout.parts.get(block.0) {
                None => {
                    return Err(Error::UnknownBlock {
                        block: block.0,
                        blocks: problem.blocks.len(),
                    });
                }
                Some(Part::Constant) => {
                    return Err(Error::NoCovariance {
                        name: problem.block_name(*block),
                    });
                }
                Some(_) => {}
            }
        }
        let config = SolveConfig {
            max_matrix_bytes: usize::MAX,
            ..SolveConfig::default()
        };
        let mut system = LinearSystem::new(&mut layout, &config)?;
        let mut evaluation = Evaluation::new(problem, &layout);
        if let Some(position) = evaluation
            .start(problem, &layout, &problem.values)
            .not_finite
        {
            return Err(not_finite(problem, &layout, position));
        }
        let mut normal = NormalEquations::new(&layout);
        on_pool(|| normal.linearize(problem, &layout, &evaluation, &problem.values));
        evaluation.outcome(problem, &layout)?;
        let unknown = undetermined(problem, &layout, &normal, &mut system);
        let refuse = |parameters: usize, first: String| Error::Undetermined {
            dimension: layout.dimension(),
            parameters,
            first,
        };
        if let Some(first) = unknown.first() {
            return Err(refuse(unknown.len(), first.to_string()));
        }
        let LinearSystem {
            mut reduced,
            solver,
            ..
        } = system;
        on_pool(|| normal.reduce(&layout, 0.0, &mut reduced));
        let Solver::Direct(mut factorization) = solver else {
            return Err(layout.too_large(layout.dimension()));
        };
        if !factorization.factor(&layout, &reduced.matrix) {
            return Err(refuse(0, "the reduced matrix is singular".into()));
        }
        Ok(Self {
            layout,
            evaluation,
            normal,
            reduced,
            factorization,
        })
    }

    /// Joint covariance of some of the blocks that the factorization was made for.
    fn covariance(&mut self, problem: &Problem, blocks: &[BlockId]) -> Covariance {
        let columns = self.columns(problem, blocks);
        let mut matrix = DMatrix::zeros(columns.dimension(), columns.dimension());
        let mut solved = vec![0.0; self.layout.dimension()];
        for column in &columns.list {
            self.solve(column, &mut solved);
            columns.fill(&mut matrix, column, &solved);
        }
        columns.covariance(blocks, matrix)
    }

    /// The dimensions of the blocks.
    pub fn columns(&self, problem: &Problem, blocks: &[BlockId]) -> Columns {
        Columns::of(problem, &self.layout, &self.normal, &self.reduced, blocks)
    }

    /// The column of the inverse of the reduced matrix that belongs to a dimension.
    pub fn solve(&mut self, column: &Column, solved: &mut [f64]) {
        solved.copy_from_slice(&column.in_reduced);
        self.factorization.solve(solved);
    }

    /// The solution for a right side of the whole normal matrix, in its place: reduced rows, then eliminated points.
    pub fn solve_whole(&mut self, right: &mut [f64]) {
        let (rows, points) = right.split_at_mut(self.layout.dimension());
        let coupling = &self.normal.coupling;
        let inverses = &self.reduced.point_inverse;
        for (p, (own, inverse)) in points.chunks_exact(POINT).zip(inverses).enumerate() {
            let alone = inverse * Vector3::from_column_slice(own);
            for pair in self.layout.pairs_at(p) {
                let of_pair = &mut rows[self.layout.rows(pair.reduced as usize)];
                let n = of_pair.len();
                for (r, value) in of_pair.iter_mut().enumerate() {
                    for k in 0..POINT {
                        *value -= coupling[pair.start + k * n + r] * alone[k];
                    }
                }
            }
        }
        self.factorization.solve(rows);
        for (p, (own, inverse)) in points.chunks_exact_mut(POINT).zip(inverses).enumerate() {
            let pulled = Vector3::from_column_slice(own) - self.pull_on_point(p, rows);
            own.copy_from_slice((inverse * pulled).as_slice());
        }
    }

    /// By how much one undamped step would move blocks, in their tangents; components that are held do not move.
    pub fn step(&mut self, problem: &Problem, blocks: &[BlockId]) -> DVector<f64> {
        let at_points = self.normal.point_gradient.iter().flat_map(|g| g.iter());
        let gradient = self.normal.gradient.iter().chain(at_points);
        let mut moved: Vec<f64> = gradient.map(|g| -g).collect();
        self.solve_whole(&mut moved);
        let mut step = Vec::new();
        for block in blocks {
            let entry = &problem.blocks[block.0];
            let first = step.len();
            step.resize(first + entry.shape.tangent, 0.0);
            for (k, row) in self.layout.whole_rows(block.0).enumerate() {
                step[first + entry.component(k)] = moved[row];
            }
        }
        DVector::from_vec(step)
    }

    /// `H_pr x_r` of a point, where the reduced rows are moved.
    fn pull_on_point(&self, point: usize, moved: &[f64]) -> Vector3<f64> {
        let mut pull = Vector3::zeros();
        for pair in self.layout.pairs_at(point) {
            let of_pair = &moved[self.layout.rows(pair.reduced as usize)];
            let n = of_pair.len();
            for (r, value) in of_pair.iter().enumerate() {
                for k in 0..POINT {
                    pull[k] += self.normal.coupling[pair.start + k * n + r] * value;
                }
            }
        }
        pull
    }

    /// The rest of that column of the whole inverse: what belongs to eliminated points, one after the other.
    pub fn at_points(&self, column: &Column, solved: &[f64]) -> Vec<f64> {
        let mut at_points = Vec::with_capacity(POINT * self.layout.points.len());
        for (p, inverse) in self.reduced.point_inverse.iter().enumerate() {
            let mut right = -self.pull_on_point(p, solved);
            if let Some((own, coordinate, _)) = column.point
                && own == p
            {
                right[coordinate] += 1.0;
            }
            at_points.extend((inverse * right).iter());
        }
        at_points
    }
}

/// One dimension asked for: the row of the inverse it selects, as the Schur complement sees it.
pub(crate) struct Column {
    pub row: usize,
    in_reduced: Vec<f64>,
    nonzero: std::ops::Range<usize>,
    /// Point and coordinate.
    point: Option<(usize, usize, Matrix3<f64>)>,
}

impl Column {
    /// Covariance of two coordinates of one point with all else known.
    fn in_point(&self, other: &Self) -> f64 {
        match (&self.point, &other.point) {
            (Some((p, a, inverse)), Some((q, b, _))) if p == q => inverse[(*a, *b)],
            _ => 0.0,
        }
    }
}

pub(crate) struct Columns {
    pub list: Vec<Column>,
    start: Vec<usize>,
}

impl Columns {
    fn of(
        problem: &Problem,
        layout: &Layout,
        normal: &NormalEquations,
        reduced: &ReducedSystem,
        blocks: &[BlockId],
    ) -> Self {
        let mut columns = Self {
            list: Vec::new(),
            start: vec![0],
        };
        for block in blocks {
            let entry = &problem.blocks[block.0];
            let first = columns.dimension();
            columns.start.push(first + entry.shape.tangent);
            match layout.parts[block.0] {
                Part::Reduced(i) => {
                    for (k, row) in layout.rows(i).enumerate() {
                        let mut in_reduced = vec![0.0; layout.dimension()];
                        in_reduced[row] = 1.0;
                        columns.list.push(Column {
                            row: first + entry.component(k),
                            in_reduced,
                            nonzero: row..row + 1,
                            point: None,
                        });
                    }
                }
                Part::Point(p) => {
                    let inverse = reduced.point_inverse[p];
                    for coordinate in 0..POINT {
                        let in_reduced = point_column(layout, normal, p, &inverse, coordinate);
                        columns.list.push(Column {
                            row: first + coordinate,
                            in_reduced,
                            nonzero: 0..layout.dimension(),
                            point: Some((p, coordinate, inverse)),
                        });
                    }
                }
                Part::Constant => {}
            }
        }
        columns
    }

    pub fn dimension(&self) -> usize {
        self.start[self.start.len() - 1]
    }

    /// Writes the covariances of one dimension with all others.
    pub fn fill(&self, matrix: &mut DMatrix<f64>, column: &Column, solved: &[f64]) {
        for other in &self.list {
            let product: f64 = other
                .nonzero
                .clone()
                .map(|k| other.in_reduced[k] * solved[k])
                .sum();
            matrix[(other.row, column.row)] = product + column.in_point(other);
        }
    }

    pub fn covariance(self, blocks: &[BlockId], matrix: DMatrix<f64>) -> Covariance {
        Covariance {
            blocks: blocks.to_vec(),
            start: self.start,
            // Symmetric to the last bit.
            matrix: (&matrix + matrix.transpose()) * 0.5,
        }
    }
}

/// `−H_rp H_pp⁻¹` of one coordinate.
fn point_column(
    layout: &Layout,
    normal: &NormalEquations,
    point: usize,
    inverse: &Matrix3<f64>,
    coordinate: usize,
) -> Vec<f64> {
    let mut column = vec![0.0; layout.dimension()];
    for pair in layout.pairs_at(point) {
        let rows = layout.rows(pair.reduced as usize);
        let n = rows.len();
        for (r, target) in column[rows].iter_mut().enumerate() {
            for k in 0..POINT {
                *target -= normal.coupling[pair.start + k * n + r] * inverse[(k, coordinate)];
            }
        }
    }
    column
}
