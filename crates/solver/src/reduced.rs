use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::cholesky::{LltRef, SymbolicCholesky, factorize_symbolic_cholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

use crate::Error;
use crate::layout::Layout;

/// Sparse Cholesky of the reduced system: ordered once, with all memory taken once.
///
/// It runs on one thread: with several, the order of its sums would depend on their number.
pub(crate) struct Factorization {
    symbolic: SymbolicCholesky<usize>,
    factor: Vec<f64>,
    memory: MemBuffer,
    dimension: usize,
}

impl Factorization {
    pub fn new(layout: &Layout) -> Result<Self, Error> {
        let dimension = layout.dimension();
        let too_large = || Error::TooLarge {
            dimension,
            entries: layout.row_index.len(),
        };
        let symbolic = factorize_symbolic_cholesky(
            pattern(layout),
            Side::Lower,
            Default::default(),
            Default::default(),
        )
        .map_err(|_| too_large())?;
        let mut factor = Vec::new();
        factor
            .try_reserve_exact(symbolic.len_val())
            .map_err(|_| too_large())?;
        factor.resize(symbolic.len_val(), 0.0);
        let scratch = symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
            .or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
        let memory = MemBuffer::try_new(scratch).map_err(|_| too_large())?;
        Ok(Self {
            symbolic,
            factor,
            memory,
            dimension,
        })
    }

    /// Factors the matrix; `false` where it is not positive definite.
    pub fn factor(&mut self, layout: &Layout, matrix: &[f64]) -> bool {
        if self.dimension == 0 {
            return true;
        }
        self.symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                SparseColMatRef::new(pattern(layout), matrix),
                Side::Lower,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Default::default(),
            )
            .is_ok()
            && self.factor.iter().all(|x| x.is_finite())
    }

    /// Solves in place with the last factor.
    pub fn solve(&mut self, right_side: &mut [f64]) {
        if self.dimension == 0 {
            return;
        }
        LltRef::new(&self.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(right_side, self.dimension, 1),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
    }
}

fn pattern(layout: &Layout) -> SymbolicSparseColMatRef<'_, usize> {
    let dimension = layout.dimension();
    SymbolicSparseColMatRef::new_checked(
        dimension,
        dimension,
        &layout.column_start,
        None,
        &layout.row_index,
    )
}
