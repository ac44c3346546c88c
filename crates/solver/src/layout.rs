use std::ops::Range;

use crate::Error;
use crate::problem::{Problem, ResidualId, Role};
use crate::residual::{CONSTANT, NO_PAIR, Slot};

/// Dimension of an eliminated point.
pub(crate) const POINT: usize = 3;

/// The part that a block plays in the normal equations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// Number of the block in the reduced system.
    Reduced(usize),
    /// Number of the point.
    Point(usize),
    /// Not searched.
    Constant,
}

/// A Jacobian by a reduced block.
#[derive(Clone, Copy, Debug)]
struct Incidence {
    /// Position of the residual in [`Layout::order`].
    position: u32,
    /// Number of its slot.
    slot: u32,
}

/// A product of two Jacobians of one residual, and the block of the reduced matrix it belongs to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coupling {
    pub block: u32,
    /// First number of the other Jacobian in the record.
    pub jacobian: u32,
}

/// A reduced block that shares residuals with a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    pub reduced: u32,
    /// First number of its `tangent × 3` matrix, columns first, in pair values.
    pub start: usize,
}

/// A block of the lower triangle of the reduced matrix: rows of block `row`, columns first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MatrixBlock {
    pub row: u32,
    pub start: usize,
}

/// What the reduced matrix holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pattern {
    /// Blocks coupled by residuals or by points.
    SchurComplement,
    /// Only blocks coupled by residuals: what is needed where the Schur complement is not formed.
    Hessian,
}

/// Where everything lies: fixed once per solve, so that iterations only fill numbers in.
pub(crate) struct Layout {
    /// Residuals in the order in which they are evaluated: those of each point together, then the others.
    pub order: Vec<u32>,
    /// Slots of the residuals. Those without a point that touch the same blocks as the one before have the same slots: a long walk's map compares two scans by a
    /// thousand residuals.
    pub slots: Vec<Slot>,
    /// Range of the slots of the residual at each position.
    slot_ranges: Vec<[u32; 2]>,
    /// Record of the residual at position `k`: `record_start[k]..record_start[k + 1]`.
    pub record_start: Vec<usize>,
    /// First position of each point's residuals; one more entry: the first position without a point.
    pub point_first: Vec<usize>,
    /// Part of each block.
    pub parts: Vec<Part>,
    /// Blocks of the reduced system in their order, and of the points.
    pub reduced: Vec<usize>,
    pub points: Vec<usize>,
    /// Row of each reduced block in the reduced system; one more entry: its dimension.
    pub row_start: Vec<usize>,
    by_reduced: Groups<Incidence>,
    /// Products of each slot with later ones: the range that the slot says.
    pub couplings: Vec<Coupling>,
    /// Pairs, those of a point together and in order of reduced block; and the pairs of each reduced block.
    pub pairs: Vec<Pair>,
    pub pairs_of_point: Vec<usize>,
    pub pairs_of_reduced: Groups<u32>,
    /// Point of each pair.
    pub point_of_pair: Vec<u32>,
    /// Length of pair values.
    pub pair_len: usize,
    /// The reduced matrix by columns of blocks, the diagonal block first. Empty while it is not to be formed.
    pub columns: Groups<MatrixBlock>,
    /// Length of the matrix' values.
    pub matrix_len: usize,
    /// Matrix block of each two pairs of a point, the second not before the first.
    pub block_of_pairs: Vec<u32>,
    pub first_of_pairs: Vec<usize>,
}

/// Lists one after the other.
pub(crate) struct Groups<T> {
    pub items: Vec<T>,
    pub start: Vec<usize>,
}

impl<T: Copy> Groups<T> {
    fn empty(groups: usize) -> Self {
        Self {
            items: Vec::new(),
            start: vec![0; groups + 1],
        }
    }

    /// Groups `(group, item)` pairs, keeping their order within a group.
    fn collect(groups: usize, pairs: impl Iterator<Item = (usize, T)> + Clone) -> Self {
        let mut start = vec![0; groups + 1];
        for (group, _) in pairs.clone() {
            start[group + 1] += 1;
        }
        for g in 0..groups {
            start[g + 1] += start[g];
        }
        let mut next = start.clone();
        let mut items = Vec::new();
        if let Some((_, first)) = pairs.clone().next() {
            items.resize(start[groups], first);
        }
        for (group, item) in pairs {
            items[next[group]] = item;
            next[group] += 1;
        }
        Self { items, start }
    }

    pub fn get(&self, group: usize) -> &[T] {
        &self.items[self.range(group)]
    }

    pub fn range(&self, group: usize) -> Range<usize> {
        self.start[group]..self.start[group + 1]
    }
}

impl Layout {
    /// The layout without the reduced matrix' pattern, which [`Layout::couple`] adds.
    pub fn new(problem: &Problem) -> Result<Self, Error> {
        let mut touched = vec![false; problem.blocks.len()];
        for (k, entry) in problem.residuals.iter().enumerate() {
            if entry.residual.is_some() {
                for block in problem.blocks_of(ResidualId(k)) {
                    touched[block.0] = true;
                }
            }
        }
        let mut parts = Vec::with_capacity(problem.blocks.len());
        let (mut reduced, mut points, mut row_start) = (Vec::new(), Vec::new(), vec![0]);
        for (index, block) in problem.blocks.iter().enumerate() {
            // A block without residuals has no row: it stays where it is. A point of which components are held is
            // not a full point any more.
            parts.push(match block.role {
                Role::Free | Role::Eliminated if !touched[index] => Part::Constant,
                Role::Eliminated if block.free() == POINT => {
                    points.push(index);
                    Part::Point(points.len() - 1)
                }
                Role::Free | Role::Eliminated => {
                    row_start.push(row_start[reduced.len()] + block.free());
                    reduced.push(index);
                    Part::Reduced(reduced.len() - 1)
                }
                Role::Constant | Role::Removed => Part::Constant,
            });
        }
        let mut layout = Self {
            order: Vec::new(),
            slots: Vec::with_capacity(problem.block_lists.len()),
            slot_ranges: Vec::new(),
            record_start: vec![0],
            point_first: Vec::new(),
            by_reduced: Groups::empty(reduced.len()),
            couplings: Vec::new(),
            pairs: Vec::new(),
            pairs_of_point: vec![0],
            pairs_of_reduced: Groups::empty(reduced.len()),
            point_of_pair: Vec::new(),
            pair_len: 0,
            columns: Groups::empty(reduced.len()),
            matrix_len: 0,
            block_of_pairs: Vec::new(),
            first_of_pairs: Vec::new(),
            parts,
            reduced,
            points,
            row_start,
        };
        layout.order_residuals(problem);
        layout.place_records(problem)?;
        layout.pair()?;
        layout.gather();
        Ok(layout)
    }

    fn point_of(&self, problem: &Problem, residual: usize) -> Option<usize> {
        problem
            .blocks_of(ResidualId(residual))
            .iter()
            .find_map(|block| match self.parts[block.0] {
                Part::Point(p) => Some(p),
                _ => None,
            })
    }

    fn order_residuals(&mut self, problem: &Problem) {
        let count = self.points.len();
        let alive =
            (0..problem.residuals.len()).filter(|k| problem.residuals[*k].residual.is_some());
        let group: Vec<(usize, u32)> = alive
            .map(|k| (self.point_of(problem, k).unwrap_or(count), k as u32))
            .collect();
        let groups = Groups::collect(count + 1, group.iter().copied());
        self.order = groups.items;
        self.point_first = groups.start[..=count].to_vec();
    }

    fn place_records(&mut self, problem: &Problem) -> Result<(), Error> {
        let alone = self.point_first[self.points.len()];
        self.slot_ranges.reserve_exact(self.order.len());
        self.record_start.reserve_exact(self.order.len());
        for (position, &k) in self.order.iter().enumerate() {
            let entry = &problem.residuals[k as usize];
            if position > alone {
                let before = &problem.residuals[self.order[position - 1] as usize];
                if before.blocks == entry.blocks && before.dimension == entry.dimension {
                    let length = self.record_start[position] - self.record_start[position - 1];
                    self.slot_ranges.push(self.slot_ranges[position - 1]);
                    self.record_start.push(self.record_start[position] + length);
                    continue;
                }
            }
            let first = self.slots.len() as u32;
            let dimension = entry.rows();
            let mut next = dimension;
            for block in problem.blocks_of(ResidualId(k as usize)) {
                let entry = &problem.blocks[block.0];
                let jacobian = if self.parts[block.0] == Part::Constant {
                    CONSTANT
                } else {
                    next += dimension * entry.free();
                    (next - dimension * entry.free()) as u32
                };
                self.slots.push(problem.slot(*block, jacobian));
            }
            // Numbers within a record, and of blocks, are kept short.
            if next.max(self.slots.len()).max(problem.blocks.len()) >= CONSTANT as usize {
                return Err(self.too_large(next));
            }
            self.slot_ranges.push([first, self.slots.len() as u32]);
            self.record_start
                .push(self.record_start[self.record_start.len() - 1] + next);
        }
        Ok(())
    }

    fn pair(&mut self) -> Result<(), Error> {
        let mut seen: Vec<u32> = Vec::new();
        for p in 0..self.points.len() {
            let slots = self.slots_of_point(p);
            seen.clear();
            seen.extend(self.slots[slots.clone()].iter().filter_map(|slot| {
                match self.parts[slot.block as usize] {
                    Part::Reduced(i) => Some(i as u32),
                    _ => None,
                }
            }));
            seen.sort_unstable();
            seen.dedup();
            let first = self.pairs.len();
            for &reduced in &seen {
                self.pairs.push(Pair {
                    reduced,
                    start: self.pair_len,
                });
                self.point_of_pair.push(p as u32);
                self.pair_len += POINT * self.tangent(reduced as usize);
            }
            for slot in &mut self.slots[slots] {
                if let Part::Reduced(i) = self.parts[slot.block as usize]
                    && let Ok(found) = seen.binary_search(&(i as u32))
                {
                    slot.pair = (first + found) as u32;
                }
            }
            self.pairs_of_point.push(self.pairs.len());
        }
        if self.pairs.len() >= NO_PAIR as usize {
            return Err(self.too_large(self.pair_len));
        }
        let pairs = self.pairs.iter().enumerate();
        self.pairs_of_reduced = Groups::collect(
            self.reduced.len(),
            pairs.map(|(q, pair)| (pair.reduced as usize, q as u32)),
        );
        Ok(())
    }

    fn gather(&mut self) {
        let this = &*self;
        let is_first = |k: &usize| *k == 0 || this.slot_ranges[*k] != this.slot_ranges[*k - 1];
        let incidences = (0..this.order.len()).filter(is_first).flat_map(move |k| {
            let slots = this.slot_range(k);
            slots.filter_map(
                move |slot| match this.parts[this.slots[slot].block as usize] {
                    Part::Reduced(i) => Some((
                        i,
                        Incidence {
                            position: k as u32,
                            slot: slot as u32,
                        },
                    )),
                    _ => None,
                },
            )
        });
        self.by_reduced = Groups::collect(this.reduced.len(), incidences);
    }

    /// Values in the blocks of the lower triangle of the Schur complement.
    pub fn count_matrix_values(&self) -> usize {
        let mut mark = vec![u32::MAX; self.reduced.len()];
        let mut count = 0;
        for i in 0..self.reduced.len() {
            self.visit_coupled(i, Pattern::SchurComplement, |j| {
                if mark[j] != i as u32 {
                    mark[j] = i as u32;
                    count += self.tangent(i) * self.tangent(j);
                }
            });
        }
        count
    }

    /// Calls `visit` with every reduced block from `i` on that is coupled with it, more than once.
    fn visit_coupled(&self, i: usize, pattern: Pattern, mut visit: impl FnMut(usize)) {
        for incidence in self.by_reduced.get(i) {
            for slot in self.slots_of(incidence.position as usize) {
                if let Part::Reduced(j) = self.parts[slot.block as usize]
                    && j >= i
                {
                    visit(j);
                }
            }
        }
        if pattern == Pattern::Hessian {
            return;
        }
        for &q in self.pairs_of_reduced.get(i) {
            let point = self.point_of_pair[q as usize] as usize;
            for pair in &self.pairs[q as usize..self.pairs_of_point[point + 1]] {
                visit(pair.reduced as usize);
            }
        }
    }

    /// Finds the pattern of the reduced matrix.
    pub fn couple(&mut self, pattern: Pattern) -> Result<(), Error> {
        let count = self.reduced.len();
        self.matrix_len = 0;
        self.first_of_pairs = vec![0];
        let mut total = 0;
        if pattern == Pattern::SchurComplement {
            for p in 0..self.points.len() {
                total += triangle(self.pairs_at(p).len(), self.pairs_at(p).len());
                self.first_of_pairs.push(total);
            }
        }
        let mut block_of_pairs = Vec::new();
        block_of_pairs
            .try_reserve_exact(total)
            .map_err(|_| self.too_large(total))?;
        block_of_pairs.resize(total, 0u32);

        let mut mark = vec![u32::MAX; count];
        let mut block_of = vec![0u32; count];
        let mut columns: Groups<MatrixBlock> = Groups::empty(0);
        let mut couplings = Vec::new();
        let mut coupled: Vec<u32> = Vec::new();
        for i in 0..count {
            coupled.clear();
            self.visit_coupled(i, pattern, |j| {
                if mark[j] != i as u32 {
                    mark[j] = i as u32;
                    coupled.push(j as u32);
                }
            });
            coupled.sort_unstable();
            for &j in &coupled {
                block_of[j as usize] = columns.items.len() as u32;
                columns.items.push(MatrixBlock {
                    row: j,
                    start: self.matrix_len,
                });
                self.matrix_len += self.tangent(i) * self.tangent(j as usize);
            }
            columns.start.push(columns.items.len());
            for incidence in self.by_reduced.get(i) {
                let first = couplings.len() as u32;
                let position = incidence.position as usize;
                for slot in &self.slots[self.slot_range(position)] {
                    if let Part::Reduced(j) = self.parts[slot.block as usize]
                        && j > i
                    {
                        couplings.push(Coupling {
                            block: block_of[j],
                            jacobian: slot.jacobian,
                        });
                    }
                }
                self.slots[incidence.slot as usize].couplings = [first, couplings.len() as u32];
            }
            if pattern == Pattern::Hessian {
                continue;
            }
            for &q in self.pairs_of_reduced.get(i) {
                let point = self.point_of_pair[q as usize] as usize;
                let range = self.pairs_of_point[point]..self.pairs_of_point[point + 1];
                let a = q as usize - range.start;
                let first = self.first_of_pairs[point] + triangle(a, range.len());
                let target = &mut block_of_pairs[first..][..range.len() - a];
                for (target, pair) in target.iter_mut().zip(&self.pairs[q as usize..range.end]) {
                    *target = block_of[pair.reduced as usize];
                }
            }
        }
        if couplings.len().max(columns.items.len()) >= u32::MAX as usize {
            return Err(self.too_large(self.matrix_len));
        }
        self.columns = columns;
        self.couplings = couplings;
        self.block_of_pairs = block_of_pairs;
        Ok(())
    }

    pub fn too_large(&self, entries: usize) -> Error {
        Error::TooLarge {
            dimension: self.dimension(),
            entries,
        }
    }

    /// Dimension of the reduced system.
    pub fn dimension(&self) -> usize {
        self.row_start[self.reduced.len()]
    }

    fn slot_range(&self, position: usize) -> Range<usize> {
        let [first, end] = self.slot_ranges[position];
        first as usize..end as usize
    }

    /// Slots of the residuals of a point, which lie side by side.
    fn slots_of_point(&self, point: usize) -> Range<usize> {
        let positions = self.point_first[point]..self.point_first[point + 1];
        match positions.clone().last() {
            Some(last) => self.slot_range(positions.start).start..self.slot_range(last).end,
            None => 0..0,
        }
    }

    /// Slots of the residual at a position.
    pub fn slots_of(&self, position: usize) -> &[Slot] {
        &self.slots[self.slot_range(position)]
    }

    /// Tangent dimension of a reduced block.
    pub fn tangent(&self, reduced: usize) -> usize {
        self.row_start[reduced + 1] - self.row_start[reduced]
    }

    /// Rows of a reduced block.
    pub fn rows(&self, reduced: usize) -> Range<usize> {
        self.row_start[reduced]..self.row_start[reduced + 1]
    }

    /// Rows of the whole system: those of the reduced one, then those of the points.
    pub fn whole_dimension(&self) -> usize {
        self.dimension() + POINT * self.points.len()
    }

    /// Rows of a block in the whole system; none where it is not searched.
    pub fn whole_rows(&self, block: usize) -> Range<usize> {
        match self.parts[block] {
            Part::Reduced(i) => self.rows(i),
            Part::Point(p) => {
                let first = self.dimension() + POINT * p;
                first..first + POINT
            }
            Part::Constant => 0..0,
        }
    }

    /// Pairs of a point.
    pub fn pairs_at(&self, point: usize) -> &[Pair] {
        &self.pairs[self.pairs_of_point[point]..self.pairs_of_point[point + 1]]
    }

    /// First pair value of a point.
    pub fn pair_value_start(&self, point: usize) -> usize {
        self.pairs
            .get(self.pairs_of_point[point])
            .map_or(self.pair_len, |pair| pair.start)
    }

    /// First matrix value of a column of blocks.
    pub fn column_value_start(&self, reduced: usize) -> usize {
        self.columns
            .items
            .get(self.columns.start[reduced])
            .map_or(self.matrix_len, |block| block.start)
    }
}

/// Entries before row `a` of the upper triangle of a matrix with `n` rows.
pub(crate) fn triangle(a: usize, n: usize) -> usize {
    a * n - a * (a.max(1) - 1) / 2
}
