use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::ops::Range;
use std::sync::Arc;

use lsfb_geometry::Vector3;
use nalgebra::SVector;
use serde::{Deserialize, Serialize};

use crate::residual::{ALL, NO_PAIR, Single, Slot};
use crate::{
    Error, Kernel, Linearization, Manifold, Parameters, Residual, ResidualSet, Shape, Undefined,
};

/// Handle of a block, without the type of its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
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
    /// No longer there.
    Removed,
}

#[derive(Clone)]
pub(crate) struct BlockEntry {
    pub start: usize,
    pub shape: Shape,
    pub role: Role,
    /// Role when it is not held constant.
    pub role_when_free: Role,
    pub plus: fn(&[f64], &[f64], &mut [f64]),
    pub turn: fn(&[f64]) -> f64,
    pub align: fn(&[f64], &mut [f64], bool),
    pub tangent_name: fn(usize) -> &'static str,
    /// Bit `k` is set where component `k` of the tangent is searched.
    pub mask: u64,
}

impl BlockEntry {
    /// Where its numbers are among the values.
    pub fn stored(&self) -> Range<usize> {
        self.start..self.start + self.shape.stored
    }

    /// Components of the tangent that are searched.
    pub fn free(&self) -> usize {
        if self.mask == ALL {
            self.shape.tangent
        } else {
            self.mask.count_ones() as usize
        }
    }

    /// Component of the tangent that the `k`-th searched one is.
    pub fn component(&self, k: usize) -> usize {
        if self.mask == ALL {
            return k;
        }
        (0..self.shape.tangent)
            .filter(|c| self.mask >> c & 1 == 1)
            .nth(k)
            .unwrap_or(k)
    }
}

#[derive(Clone)]
pub(crate) struct ResidualEntry {
    /// `None` once it was removed.
    pub residual: Option<Arc<dyn ResidualSet>>,
    /// Its number in the set.
    pub number: u32,
    pub dimension: u32,
    pub kernel: Kernel,
    /// Range of its blocks in `block_lists`; the same as that of the residual before it where these are the same.
    pub blocks: [u32; 2],
}

impl ResidualEntry {
    /// Rows of the residual.
    pub fn rows(&self) -> usize {
        self.dimension as usize
    }

    /// Evaluates it; `Undefined` once it was removed.
    #[inline]
    pub fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let residual = self.residual.as_ref().ok_or(Undefined)?;
        residual.evaluate(self.number, parameters, out)
    }
}

/// Range of one component of a vector block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    pub lower: f64,
    pub upper: f64,
}

#[derive(Clone, Default)]
pub(crate) struct Names {
    pub block: String,
    pub components: Vec<String>,
}

/// Blocks with values, and the residuals between them. A clone shares the residuals, which never change.
#[derive(Clone, Default)]
pub struct Problem {
    pub(crate) values: Vec<f64>,
    pub(crate) blocks: Vec<BlockEntry>,
    pub(crate) residuals: Vec<ResidualEntry>,
    pub(crate) block_lists: Vec<BlockId>,
    /// By block and component.
    pub(crate) bounds: BTreeMap<(usize, usize), Bounds>,
    names: BTreeMap<usize, Names>,
    removed_residuals: usize,
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
            turn: M::turn,
            align: |x, rows, to_world| M::load(x).align(rows, to_world),
            tangent_name: M::tangent_name,
            mask: ALL,
        });
        Block {
            id: BlockId(self.blocks.len() - 1),
            value: PhantomData,
        }
    }

    /// Holds a block at its value.
    pub fn set_constant<M>(&mut self, block: Block<M>) {
        if let Some(entry) = self.blocks.get_mut(block.id.0)
            && entry.role != Role::Removed
        {
            entry.role = Role::Constant;
        }
    }

    /// Lets a block go that [`Problem::set_constant`] held. Components held by
    /// [`Problem::set_constant_components`] stay held.
    pub fn set_free<M>(&mut self, block: Block<M>) {
        if let Some(entry) = self.blocks.get_mut(block.id.0)
            && entry.role != Role::Removed
        {
            entry.role = if entry.mask == 0 {
                Role::Constant
            } else {
                entry.role_when_free
            };
        }
    }

    /// Holds some components of a block's tangent, and lets its others go: an empty list lets all go.
    ///
    /// The tangent of a pose is `[rotation, translation]` in the body frame; that of a vector are its entries.
    pub fn set_constant_components<M: Manifold>(
        &mut self,
        block: Block<M>,
        components: &[usize],
    ) -> Result<(), Error> {
        let mut mask = ALL;
        for &component in components {
            self.check_component::<M>(block, component)?;
            mask &= !(1 << component);
        }
        let blocks = self.blocks.len();
        let entry = self.blocks.get_mut(block.id.0).ok_or(Error::UnknownBlock {
            block: block.id.0,
            blocks,
        })?;
        let every = u64::MAX >> (64 - entry.shape.tangent.clamp(1, 64));
        entry.mask = if components.is_empty() {
            ALL
        } else {
            mask & every
        };
        self.set_free(block);
        Ok(())
    }

    fn check_component<M: Manifold>(&self, block: Block<M>, component: usize) -> Result<(), Error> {
        if component >= M::TANGENT.min(64) {
            return Err(Error::UnknownComponent {
                block: block.id.0,
                component,
                components: M::TANGENT.min(64),
            });
        }
        Ok(())
    }

    /// Keeps one entry of a vector between two values; infinite ones bound nothing. The solver starts at the nearest
    /// value within.
    pub fn set_bounds<const N: usize>(
        &mut self,
        block: Block<SVector<f64, N>>,
        component: usize,
        lower: f64,
        upper: f64,
    ) -> Result<(), Error> {
        self.check_component(block, component)?;
        if !(lower <= upper) {
            return Err(Error::EmptyBounds {
                block: block.id.0,
                component,
                lower,
                upper,
            });
        }
        self.bounds
            .insert((block.id.0, component), Bounds { lower, upper });
        Ok(())
    }

    /// Names a block in reports: "camera 2".
    pub fn set_name(&mut self, block: BlockId, name: impl Into<String>) {
        self.names.entry(block.0).or_default().block = name.into();
    }

    /// Names the components of a block's tangent in reports: "focal length".
    pub fn set_component_names(&mut self, block: BlockId, names: &[&str]) {
        self.names.entry(block.0).or_default().components =
            names.iter().map(|n| n.to_string()).collect();
    }

    /// Name of a block, or its number.
    pub fn block_name(&self, block: BlockId) -> String {
        match self.names.get(&block.0) {
            Some(names) if !names.block.is_empty() => names.block.clone(),
            _ => format!("block {}", block.0),
        }
    }

    /// Name of one component of a block's tangent, or its number.
    pub fn component_name(&self, block: BlockId, component: usize) -> String {
        let given = self
            .names
            .get(&block.0)
            .and_then(|names| names.components.get(component));
        let of_type = self
            .blocks
            .get(block.0)
            .map_or("", |entry| (entry.tangent_name)(component));
        match given {
            Some(name) => name.clone(),
            None if of_type.is_empty() => format!("component {component}"),
            None => of_type.to_string(),
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

    /// Where residuals find a block, with the Jacobian by it there; pairs and couplings are not known yet.
    pub(crate) fn slot(&self, block: BlockId, jacobian: u32) -> Slot {
        let entry = &self.blocks[block.0];
        Slot {
            value: entry.start,
            mask: entry.mask,
            block: block.0 as u32,
            jacobian,
            pair: NO_PAIR,
            couplings: [0; 2],
        }
    }

    fn stored(&self, block: BlockId) -> &[f64] {
        let entry = &self.blocks[block.0];
        &self.values[entry.stored()]
    }

    /// Adds a residual on `blocks`, in the order in which it reads them.
    pub fn add_residual(
        &mut self,
        residual: impl Residual + 'static,
        blocks: &[BlockId],
        kernel: Kernel,
    ) -> Result<ResidualId, Error> {
        self.add_residual_of(Arc::new(Single(residual)), 0, blocks, kernel)
    }

    /// Adds the residual of this number of a set on `blocks`.
    pub fn add_residual_of(
        &mut self,
        set: Arc<dyn ResidualSet>,
        number: u32,
        blocks: &[BlockId],
        kernel: Kernel,
    ) -> Result<ResidualId, Error> {
        let index = self.residuals.len();
        self.check_blocks(index, &*set, blocks)?;
        kernel.check()?;
        let last = index.checked_sub(1).map(ResidualId);
        let list = match last.filter(|last| self.blocks_of(*last) == blocks) {
            Some(last) => self.residuals[last.0].blocks,
            None => {
                let first = self.block_lists.len();
                let end = first + blocks.len();
                let [Ok(first), Ok(end)] = [first, end].map(u32::try_from) else {
                    return Err(Error::TooLarge {
                        dimension: self.blocks.len(),
                        entries: end,
                    });
                };
                self.block_lists.extend_from_slice(blocks);
                [first, end]
            }
        };
        self.residuals.push(ResidualEntry {
            dimension: set.dimension() as u32,
            residual: Some(set),
            number,
            kernel,
            blocks: list,
        });
        Ok(ResidualId(index))
    }

    /// Takes a residual out. Its number is not used again.
    pub fn remove_residual(&mut self, residual: ResidualId) {
        if let Some(entry) = self.residuals.get_mut(residual.0)
            && entry.residual.take().is_some()
        {
            self.removed_residuals += 1;
        }
    }

    /// Takes a block out, with all residuals that read it. Its number is not used again; its last value stays readable.
    pub fn remove_block<M>(&mut self, block: Block<M>) {
        for k in 0..self.residuals.len() {
            if self.blocks_of(ResidualId(k)).contains(&block.id) {
                self.remove_residual(ResidualId(k));
            }
        }
        self.retire(block.id);
    }

    /// Marks a block without residuals as removed.
    pub(crate) fn retire(&mut self, block: BlockId) {
        if let Some(entry) = self.blocks.get_mut(block.0) {
            entry.role = Role::Removed;
            entry.role_when_free = Role::Removed;
        }
    }

    fn check_blocks(
        &self,
        index: usize,
        residual: &dyn ResidualSet,
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
            let entry = self
                .blocks
                .get(block.0)
                .filter(|entry| entry.role != Role::Removed)
                .ok_or(Error::UnknownBlock {
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
        let [first, end] = self.residuals[residual.0].blocks;
        &self.block_lists[first as usize..end as usize]
    }

    /// Number of blocks, removed ones included.
    pub fn block_count(&self) -> usize {
        self.blocks.len()
    }

    /// Number of residuals.
    pub fn residual_count(&self) -> usize {
        self.residuals.len() - self.removed_residuals
    }
}
