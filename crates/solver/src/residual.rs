use nalgebra::{SMatrix, SVector};

use crate::{Manifold, Shape};

/// One term of a least-squares problem: `½ ρ(‖r(x)‖²)` over the blocks `x` it reads.
///
/// A residual holds its measurement and its weight (as a square root of the information), never its blocks: the
/// problem joins the two. It keeps no cache, and gives the same numbers on every call.
pub trait Residual: Send + Sync {
    /// Rows of the residual.
    fn dimension(&self) -> usize;

    /// The blocks it reads, in the order of [`Parameters`] and of the Jacobians.
    fn blocks(&self) -> &[Shape];

    /// Writes the residual and, where wanted, its derivative by the tangent of each block.
    ///
    /// [`Undefined`] where the model has no value, a point behind the camera say.
    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined>;
}

/// Residuals of one kind that share what they hold and have numbers: where there are millions of them, memory for each would be much.
///
/// All have as many rows and read blocks of the same shapes; the rest is as [`Residual`] has it.
pub trait ResidualSet: Send + Sync {
    /// Rows of each.
    fn dimension(&self) -> usize;

    /// The blocks that each reads.
    fn blocks(&self) -> &[Shape];

    /// Evaluates the residual of this number; [`Undefined`] where there is none.
    fn evaluate(
        &self,
        number: u32,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined>;
}

/// A residual by itself.
pub(crate) struct Single<R>(pub R);

impl<R: Residual> ResidualSet for Single<R> {
    fn dimension(&self) -> usize {
        self.0.dimension()
    }

    fn blocks(&self) -> &[Shape] {
        self.0.blocks()
    }

    fn evaluate(
        &self,
        _number: u32,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        self.0.evaluate(parameters, out)
    }
}

/// The residual has no value here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Undefined;

/// Where a residual's block lies: in the values, and in its record.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    /// First stored number of the block.
    pub value: usize,
    /// Components of the tangent that are searched.
    pub mask: u64,
    /// Index of the block.
    pub block: u32,
    /// First number of the Jacobian in the record; [`CONSTANT`] where none is wanted.
    pub jacobian: u32,
    /// Number of the pair of this block and the residual's point; [`NO_PAIR`] where there is none.
    pub pair: u32,
    /// Range of the products with later Jacobians of the residual, in `Layout::couplings`.
    pub couplings: [u32; 2],
}

/// [`Slot::mask`] of a block that is searched in all its tangent.
pub(crate) const ALL: u64 = u64::MAX;

/// [`Slot::jacobian`] of a constant block.
pub(crate) const CONSTANT: u32 = u32::MAX;

/// [`Slot::pair`] of a block that shares no residual with a point.
pub(crate) const NO_PAIR: u32 = u32::MAX;

/// The values of the blocks a residual reads.
pub struct Parameters<'a> {
    pub(crate) values: &'a [f64],
    pub(crate) slots: &'a [Slot],
}

impl Parameters<'_> {
    /// Value of the block at `position`, of the type that [`Residual::blocks`] says.
    #[inline]
    pub fn get<M: Manifold>(&self, position: usize) -> M {
        let start = self.slots[position].value;
        M::load(&self.values[start..start + M::STORED])
    }
}

/// Where a residual writes its value and its Jacobians.
pub struct Linearization<'a> {
    /// Residual, then the Jacobians of the free blocks, each row by row.
    pub(crate) record: &'a mut [f64],
    pub(crate) slots: &'a [Slot],
    pub(crate) with_jacobians: bool,
}

impl Linearization<'_> {
    /// Writes the residual.
    #[inline]
    pub fn set_residual<const D: usize>(&mut self, residual: &SVector<f64, D>) {
        self.record[..D].copy_from_slice(residual.as_slice());
    }

    /// Whether the derivative by the block at `position` is wanted: not so for constant blocks and while only the cost is.
    #[inline]
    pub fn wants_jacobian(&self, position: usize) -> bool {
        self.with_jacobians && self.slots[position].jacobian != CONSTANT
    }

    /// Whether any derivative is wanted: not so while only the cost is, and where all blocks are constant.
    #[inline]
    pub fn wants_jacobians(&self) -> bool {
        (0..self.slots.len()).any(|position| self.wants_jacobian(position))
    }

    /// Writes the derivative by the tangent of the block at `position`; nothing happens where it is not wanted.
    #[inline]
    pub fn set_jacobian<const D: usize, const N: usize>(
        &mut self,
        position: usize,
        jacobian: &SMatrix<f64, D, N>,
    ) {
        if !self.wants_jacobian(position) {
            return;
        }
        let Slot {
            jacobian: start,
            mask,
            ..
        } = self.slots[position];
        let record = &mut self.record[start as usize..];
        if mask == ALL {
            for (r, row) in record[..D * N].chunks_exact_mut(N).enumerate() {
                for (c, entry) in row.iter_mut().enumerate() {
                    *entry = jacobian[(r, c)];
                }
            }
            return;
        }
        let columns = (0..N).filter(|c| mask >> c & 1 == 1);
        let entries = (0..D).flat_map(|r| columns.clone().map(move |c| jacobian[(r, c)]));
        for (target, entry) in record.iter_mut().zip(entries) {
            *target = entry;
        }
    }
}
