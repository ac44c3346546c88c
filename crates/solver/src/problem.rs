use std::marker::PhantomData;

use lsfb_geometry::Vector3;

use crate::{Error, Kernel, Manifold, Residual, Shape};

/// Handle of a block, without the type of its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BlockId(pub(crate) usize);

impl BlockId {
    /// Number of the block, in the order of addition: what errors and reports name.
    pub fn index(self) -> usize {
        self.0
    }
}

/// Handle of a block whose value is an `M`.
#[derive(Debug)]
pub struct Block<M> {
    id: BlockId,
    value: PhantomData<fn() -> M>,
}

impl<M> Clone for Block<M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M> Copy for Block<M> {}

impl<M> Block<M> {
    /// The handle without the type, as [`Problem::add_residual`] takes it.
    pub fn id(self) -> BlockId {
        self.id
    }
}

/// Handle of a residual.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ResidualId(pub(crate) usize);

impl ResidualId {
    /// Number of the residual, in the order of addition: what errors and reports name.
    pub fn index(self) -> usize {
        self.0
    }
}

/// What the solver does with a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// Part of the reduced system.
    Free,
    /// A point eliminated by the Schur complement.
    Eliminated,
    /// Never changed.
    Constant,
}

pub(crate) struct BlockEntry {
    pub start: usize,
    pub shape: Shape,
    pub role: Role,
    /// Role when it is not held constant.
    pub role_when_free: Role,
    pub plus: fn(&[f64], &[f64], &mut [f64]),
}

pub(crate) struct ResidualEntry {
    pub residual: Box<dyn Residual>,
    pub dimension: usize,
    pub kernel: Kernel,
    /// Range of its blocks in `block_lists`.
    pub first_block: usize,
}

/// Blocks with values, and the residuals between them.
#[derive(Default)]
pub struct Problem {
    pub(crate) values: Vec<f64>,
    pub(crate) blocks: Vec<BlockEntry>,
    pub(crate) residuals: Vec<ResidualEntry>,
    pub(crate) block_lists: Vec<BlockId>,
}

impl Problem {
    /// A problem without blocks.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a free block that starts at `value`.
    pub fn add_block<M: Manifold>(&mut self, value: M) -> Block<M> {
        self.add(value, Role::Free)
    }

    /// Adds a free point that is eliminated from the normal equations before they are solved: for the many points of
    /// bundle adjustment. A residual may touch one such point at most.
    pub fn add_eliminated_point(&mut self, point: Vector3<f64>) -> Block<Vector3<f64>> {
        self.add(point, Role::Eliminated)
    }

    fn add<M: Manifold>(&mut self, value: M, role: Role) -> Block<M> {
        let start = self.values.len();
        self.values.resize(start + M::STORED, 0.0);
        value.store(&mut self.values[start..]);
        self.blocks.push(BlockEntry {
            start,
            shape: Shape::of::<M>(),
            role,
            role_when_free: role,
            plus: |x, delta, out| M::load(x).plus(delta).store(out),
        });
        Block {
            id: BlockId(self.blocks.len() - 1),
            value: PhantomData,
        }
    }

    /// Holds a block at its value.
    pub fn set_constant<M>(&mut self, block: Block<M>) {
        if let Some(entry) = self.blocks.get_mut(block.id.0) {
            entry.role = Role::Constant;
        }
    }

    /// Lets a block go that [`Problem::set_constant`] held.
    pub fn set_free<M>(&mut self, block: Block<M>) {
        if let Some(entry) = self.blocks.get_mut(block.id.0) {
            entry.role = entry.role_when_free;
        }
    }

    /// Value of a block of this problem.
    pub fn value<M: Manifold>(&self, block: Block<M>) -> M {
        M::load(self.stored(block.id))
    }

    /// Replaces the value of a block of this problem.
    pub fn set_value<M: Manifold>(&mut self, block: Block<M>, value: &M) {
        let start = self.blocks[block.id.0].start;
        value.store(&mut self.values[start..start + M::STORED]);
    }

    /// The stored numbers of all blocks, in the order of addition: to compare two results bit by bit.
    pub fn stored_values(&self) -> &[f64] {
        &self.values
    }

    fn stored(&self, block: BlockId) -> &[f64] {
        let entry = &self.blocks[block.0];
        &self.values[entry.start..entry.start + entry.shape.stored]
    }

    /// Adds a residual on `blocks`, in the order in which it reads them.
    pub fn add_residual(
        &mut self,
        residual: impl Residual + 'static,
        blocks: &[BlockId],
        kernel: Kernel,
    ) -> Result<ResidualId, Error> {
        let index = self.residuals.len();
        self.check_blocks(index, &residual, blocks)?;
        let first_block = self.block_lists.len();
        self.block_lists.extend_from_slice(blocks);
        self.residuals.push(ResidualEntry {
            dimension: residual.dimension(),
            residual: Box::new(residual),
            kernel,
            first_block,
        });
        Ok(ResidualId(index))
    }

    fn check_blocks(
        &self,
        index: usize,
        residual: &dyn Residual,
        blocks: &[BlockId],
    ) -> Result<(), Error> {
        let shapes = residual.blocks();
        if residual.dimension() == 0 {
            return Err(Error::EmptyResidual { residual: index });
        }
        if shapes.len() != blocks.len() {
            return Err(Error::BlockCount {
                residual: index,
                expected: shapes.len(),
                got: blocks.len(),
            });
        }
        let mut eliminated: Option<usize> = None;
        for (position, (block, expected)) in blocks.iter().zip(shapes).enumerate() {
            let entry = self.blocks.get(block.0).ok_or(Error::UnknownBlock {
                block: block.0,
                blocks: self.blocks.len(),
            })?;
            if entry.shape != *expected {
                return Err(Error::BlockShape {
                    residual: index,
                    position,
                    expected: *expected,
                    got: entry.shape,
                });
            }
            if blocks[..position].contains(block) {
                return Err(Error::RepeatedBlock {
                    residual: index,
                    block: block.0,
                });
            }
            if entry.role_when_free == Role::Eliminated {
                if let Some(first) = eliminated {
                    return Err(Error::TwoEliminated {
                        residual: index,
                        first,
                        second: block.0,
                    });
                }
                eliminated = Some(block.0);
            }
        }
        Ok(())
    }

    /// Blocks of a residual.
    pub fn blocks_of(&self, residual: ResidualId) -> &[BlockId] {
        let first = self.residuals[residual.0].first_block;
        let end = self
            .residuals
            .get(residual.0 + 1)
            .map_or(self.block_lists.len(), |next| next.first_block);
        &self.block_lists[first..end]
    }

    /// Number of blocks.
    pub fn block_count(&self) -> usize {
        self.blocks.len()
    }

    /// Number of residuals.
    pub fn residual_count(&self) -> usize {
        self.residuals.len()
    }
}
