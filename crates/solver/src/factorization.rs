use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, MatRef, Par, Side};

use crate::Error;
use crate::layout::Layout;

/// Cholesky of the reduced matrix, with all memory taken once.
///
/// It runs on one thread: with several, the order of its sums would depend on their number.
pub(crate) enum Factorization {
    Dense(Dense),
    Sparse(Box<Sparse>),
}

/// Share of the lower triangle from which on a reduced matrix is taken as dense.
const DENSE_SHARE: f64 = 0.5;

/// Dimension up to which a reduced matrix is taken as dense.
const SMALL: usize = 48;

impl Factorization {
    /// Whether a dense factor is the cheaper one.
    pub fn prefers_dense(layout: &Layout) -> bool {
        let n = layout.dimension() as f64;
        layout.dimension() <= SMALL || layout.matrix_len as f64 >= DENSE_SHARE * 0.5 * n * n
    }

    /// Factors the matrix; `false` where it is not positive definite.
    pub fn factor(&mut self, layout: &Layout, matrix: &[f64]) -> bool {
        if layout.dimension() == 0 {
            return true;
        }
        match self {
            Self::Dense(dense) => dense.factor(layout, matrix),
            Self::Sparse(sparse) => sparse.factor(layout, matrix),
        }
    }

    /// Solves in place with the last factor.
    pub fn solve(&mut self, right_side: &mut [f64]) {
        if right_side.is_empty() {
            return;
        }
        match self {
            Self::Dense(dense) => dense.solve(right_side),
            Self::Sparse(sparse) => sparse.solve(right_side),
        }
    }
}

pub(crate) struct Dense {
    factor: Vec<f64>,
    memory: MemBuffer,
    dimension: usize,
}

impl Dense {
    pub fn new(layout: &Layout) -> Result<Self, Error> {
        let dimension = layout.dimension();
        let entries = dimension.saturating_mul(dimension);
        let factor = zeros(layout, entries)?;
        let request =
            llt::factor::cholesky_in_place_scratch::<f64>(dimension, Par::Seq, Default::default());
        let memory = MemBuffer::try_new(request).map_err(|_| layout.too_large(entries))?;
        Ok(Self {
            factor,
            memory,
            dimension,
        })
    }

    fn factor(&mut self, layout: &Layout, matrix: &[f64]) -> bool {
        let n = self.dimension;
        for i in 0..layout.reduced.len() {
            let columns = layout.rows(i);
            for block in layout.columns.get(i) {
                let rows = layout.rows(block.row as usize);
                let values = &matrix[block.start..][..rows.len() * columns.len()];
                for (c, column) in columns.clone().zip(values.chunks_exact(rows.len().max(1))) {
                    self.factor[c * n..][rows.clone()].copy_from_slice(column);
                }
            }
            // What is not coupled now may hold the last factor.
            let mut coupled = layout
                .columns
                .get(i)
                .iter()
                .map(|b| b.row as usize)
                .peekable();
            for j in i..layout.reduced.len() {
                if coupled.next_if_eq(&j).is_none() {
                    for c in columns.clone() {
                        self.factor[c * n..][layout.rows(j)].fill(0.0);
                    }
                }
            }
        }
        let whole = MatMut::from_column_major_slice_mut(&mut self.factor, n, n);
        llt::factor::cholesky_in_place(
            whole,
            Default::default(),
            Par::Seq,
            MemStack::new(&mut self.memory),
            Default::default(),
        )
        .is_ok()
    }

    fn solve(&mut self, right_side: &mut [f64]) {
        let n = self.dimension;
        llt::solve::solve_in_place_with_conj(
            MatRef::from_column_major_slice(&self.factor, n, n),
            Conj::No,
            MatMut::from_column_major_slice_mut(right_side, n, 1),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
    }
}

pub(crate) struct Sparse {
    symbolic: SymbolicCholesky<usize>,
    factor: Vec<f64>,
    memory: MemBuffer,
    /// Row of the reduced system at each place of the order of elimination.
    row_at: Vec<usize>,
    /// The right side in that order.
    ordered: Vec<f64>,
    /// Lower triangle in that order by scalar columns, and where each block of the reduced matrix goes.
    column_start: Vec<usize>,
    row_index: Vec<usize>,
    values: Vec<f64>,
    targets: Vec<Target>,
}

/// Where a block goes in the ordered triangle.
#[derive(Clone, Copy)]
struct Target {
    /// First scalar column.
    column: usize,
    /// Distance from that column's diagonal.
    offset: usize,
    /// Whether the order swaps the block's row and column.
    is_transposed: bool,
}

impl Sparse {
    pub fn new(layout: &Layout) -> Result<Self, Error> {
        Self::new_within(layout, usize::MAX)?.ok_or_else(|| layout.too_large(layout.matrix_len))
    }

    /// `None` where the factor would have more than `entries` numbers.
    pub fn new_within(layout: &Layout, entries: usize) -> Result<Option<Self>, Error> {
        let dimension = layout.dimension();
        let too_large = || layout.too_large(layout.matrix_len);
        let order = block_ordering(layout)?;
        let row_at: Vec<usize> = order.iter().flat_map(|i| layout.rows(*i)).collect();
        let pattern = Pattern::new(layout, &order)?;
        let params = CholeskySymbolicParams {
            // Blocks are supernodes from the start.
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        // A matrix that is ordered already is analysed by its upper triangle, and factored by its lower one.
        let (upper_start, upper_index) = pattern.transposed();
        let symbolic = factorize_symbolic_cholesky(
            symbolic_matrix(dimension, &upper_start, &upper_index),
            Side::Upper,
            SymmetricOrdering::Identity,
            params,
        )
        .map_err(|_| too_large())?;
        if symbolic.len_val() > entries {
            return Ok(None);
        }
        let factor = zeros(layout, symbolic.len_val())?;
        let scratch = symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
            .or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
        let memory = MemBuffer::try_new(scratch).map_err(|_| too_large())?;
        let values = zeros(layout, pattern.row_index.len())?;
        Ok(Some(Self {
            symbolic,
            factor,
            memory,
            row_at,
            ordered: vec![0.0; dimension],
            column_start: pattern.column_start,
            row_index: pattern.row_index,
            values,
            targets: pattern.targets,
        }))
    }

    fn factor(&mut self, layout: &Layout, matrix: &[f64]) -> bool {
        for i in 0..layout.reduced.len() {
            let n = layout.tangent(i);
            for at in layout.columns.range(i) {
                let block = layout.columns.items[at];
                let m = layout.tangent(block.row as usize);
                let source = &matrix[block.start..][..m * n];
                let target = self.targets[at];
                let (height, width) = if target.is_transposed { (n, m) } else { (m, n) };
                for c in 0..width {
                    // Each column begins at its diagonal, one later than the one before.
                    let start = self.column_start[target.column + c];
                    let skip = if target.offset == 0 { c } else { 0 };
                    let values = &mut self.values[start + target.offset + skip - c..];
                    let values = &mut values[..height - skip];
                    if target.is_transposed {
                        for (value, row) in values.iter_mut().zip(source.chunks_exact(m)) {
                            *value = row[c];
                        }
                    } else {
                        values.copy_from_slice(&source[c * m + skip..(c + 1) * m]);
                    }
                }
            }
        }
        let pattern = symbolic_matrix(self.row_at.len(), &self.column_start, &self.row_index);
        self.symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                SparseColMatRef::new(pattern, &self.values),
                Side::Lower,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Default::default(),
            )
            .is_ok()
    }

    fn solve(&mut self, right_side: &mut [f64]) {
        for (value, row) in self.ordered.iter_mut().zip(&self.row_at) {
            *value = right_side[*row];
        }
        let dimension = self.row_at.len();
        LltRef::new(&self.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(&mut self.ordered, dimension, 1),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
        for (value, row) in self.ordered.iter().zip(&self.row_at) {
            right_side[*row] = *value;
        }
    }
}

/// The ordered lower triangle by scalar columns.
struct Pattern {
    column_start: Vec<usize>,
    row_index: Vec<usize>,
    targets: Vec<Target>,
}

impl Pattern {
    fn new(layout: &Layout, order: &[usize]) -> Result<Self, Error> {
        let count = order.len();
        let mut place = vec![0; count];
        let mut first_row = vec![0];
        for (k, block) in order.iter().enumerate() {
            place[*block] = k;
            first_row.push(first_row[k] + layout.tangent(*block));
        }
        // By place of the column: place of the row, and number of the block.
        let mut columns: Vec<Vec<(usize, usize)>> = vec![Vec::new(); count];
        for (i, a) in place.iter().enumerate() {
            for at in layout.columns.range(i) {
                let b = &place[layout.columns.items[at].row as usize];
                columns[*a.min(b)].push((*a.max(b), at));
            }
        }
        let entries = layout.matrix_len;
        let mut row_index = Vec::new();
        row_index
            .try_reserve_exact(entries)
            .map_err(|_| layout.too_large(entries))?;
        let unset = Target {
            column: 0,
            offset: 0,
            is_transposed: false,
        };
        let mut targets = vec![unset; layout.columns.items.len()];
        let mut column_start = vec![0];
        for (k, blocks) in columns.iter_mut().enumerate() {
            blocks.sort_unstable();
            let mut offset = 0;
            for (row, at) in blocks.iter() {
                targets[*at] = Target {
                    column: first_row[k],
                    offset,
                    is_transposed: place[layout.columns.items[*at].row as usize] < *row,
                };
                offset += layout.tangent(order[*row]);
            }
            for column in first_row[k]..first_row[k + 1] {
                for (row, _) in blocks.iter() {
                    row_index.extend(first_row[*row].max(column)..first_row[row + 1]);
                }
                column_start.push(row_index.len());
            }
        }
        Ok(Self {
            column_start,
            row_index,
            targets,
        })
    }

    /// Start of each column, and row indices, of the upper triangle.
    fn transposed(&self) -> (Vec<usize>, Vec<usize>) {
        let mut start = vec![0; self.column_start.len()];
        for row in &self.row_index {
            start[row + 1] += 1;
        }
        for k in 1..start.len() {
            start[k] += start[k - 1];
        }
        let mut next = start.clone();
        let mut index = vec![0; self.row_index.len()];
        for (column, range) in self.column_start.windows(2).enumerate() {
            for row in &self.row_index[range[0]..range[1]] {
                index[next[*row]] = column;
                next[*row] += 1;
            }
        }
        (start, index)
    }
}

fn zeros(layout: &Layout, entries: usize) -> Result<Vec<f64>, Error> {
    let mut values = Vec::new();
    values
        .try_reserve_exact(entries)
        .map_err(|_| layout.too_large(entries))?;
    values.resize(entries, 0.0);
    Ok(values)
}

fn symbolic_matrix<'a>(
    dimension: usize,
    column_start: &'a [usize],
    row_index: &'a [usize],
) -> SymbolicSparseColMatRef<'a, usize> {
    SymbolicSparseColMatRef::new_checked(dimension, dimension, column_start, None, row_index)
}

/// Minimum degree on the graph of blocks: a fraction of the work of ordering scalars, and blocks stay together.
fn block_ordering(layout: &Layout) -> Result<Vec<usize>, Error> {
    let count = layout.reduced.len();
    let rows: Vec<usize> = layout
        .columns
        .items
        .iter()
        .map(|block| block.row as usize)
        .collect();
    let (mut forward, mut inverse) = (vec![0; count], vec![0; count]);
    let request: StackReq = amd::order_maybe_unsorted_scratch::<usize>(count, rows.len());
    let mut memory = MemBuffer::try_new(request).map_err(|_| layout.too_large(rows.len()))?;
    amd::order_maybe_unsorted(
        &mut forward,
        &mut inverse,
        SymbolicSparseColMatRef::new_checked(count, count, &layout.columns.start, None, &rows),
        Default::default(),
        MemStack::new(&mut memory),
    )
    .map_err(|_| layout.too_large(rows.len()))?;
    Ok(forward)
}
