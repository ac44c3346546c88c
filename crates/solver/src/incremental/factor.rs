//! Cholesky factor of the reduced system, kept up to the first columns that a change can reach.

use crate::kernels::{add_lower_product, add_scaled, long_dot, vectorized};
use crate::problem::Problem;

use super::marks::Marks;
use super::steps::Steps;
use super::system::System;

/// Columns that are made together at most: those of a pose, a velocity and two biases.
const WIDEST: usize = 15;

/// Place of a block that has no columns.
const NOWHERE: u32 = u32::MAX;

/// Blocks that are eliminated together.
#[derive(Default)]
struct Group {
    blocks: Vec<u32>,
    width: usize,
    /// Blocks below, in the order of elimination, and where the rows of each begin.
    rows: Vec<[u32; 2]>,
    /// Rows, of the blocks themselves and below.
    height: usize,
    /// Lower triangle and what is below it, columns first.
    panel: Vec<f64>,
    /// Solution of the lower triangular system.
    forward: Vec<f64>,
    /// Earlier groups that have rows in this one, and those of them whose first row is in it.
    reached_by: Vec<u32>,
    children: Vec<u32>,
}

/// The factor.
#[derive(Default)]
pub(super) struct Factor {
    groups: Vec<Group>,
    /// By block: its group, and its place in the order of elimination.
    group_of: Vec<u32>,
    place: Vec<u32>,
    next_place: u32,
    /// Groups that are up to date.
    valid: usize,
    /// Scratch: first row of each block in the panel at work; an update of it; steps below it; groups to go through.
    local: Vec<u32>,
    update: Vec<f64>,
    below: Vec<f64>,
    rows: Marks,
    is_pending: Vec<bool>,
}

impl Factor {
    /// By block.
    pub fn place(&self) -> &[u32] {
        &self.place
    }

    /// Group of a block that has one.
    pub fn group(&self, block: usize) -> usize {
        self.group_of[block] as usize
    }

    pub fn groups(&self) -> usize {
        self.groups.len()
    }

    pub fn has(&self, block: usize) -> bool {
        self.place.get(block).is_some_and(|p| *p != NOWHERE)
    }

    /// Makes room for blocks that came.
    pub fn grow(&mut self, blocks: usize) {
        self.group_of.resize(blocks, NOWHERE);
        self.place.resize(blocks, NOWHERE);
        self.local.resize(blocks, 0);
    }

    /// Adds blocks at the end of the order.
    pub fn append(&mut self, steps: &Steps, blocks: &[usize]) {
        let first = self.groups.len();
        for block in blocks {
            let n = steps.dimension(*block);
            let fits = self.groups.len() > first
                && self.groups.last().is_some_and(|g| g.width + n <= WIDEST);
            if !fits {
                self.groups.push(Group::default());
            }
            let group = self.groups.len() - 1;
            self.groups[group].blocks.push(*block as u32);
            self.groups[group].width += n;
            self.group_of[*block] = group as u32;
            self.place[*block] = self.next_place;
            self.next_place += 1;
        }
    }

    /// Takes blocks out of the order.
    pub fn remove(&mut self, steps: &Steps, blocks: &[usize]) {
        let groups = blocks.iter().map(|b| self.group_of[*b] as usize);
        let Some(first) = groups.min() else {
            return;
        };
        for block in blocks {
            self.place[*block] = NOWHERE;
        }
        self.discard(first);
        let old: Vec<Group> = self.groups.drain(first..).collect();
        for mut group in old {
            for block in &group.blocks {
                self.group_of[*block as usize] = NOWHERE;
            }
            group.blocks.retain(|b| self.place[*b as usize] != NOWHERE);
            if group.blocks.is_empty() {
                continue;
            }
            let dimensions = group.blocks.iter().map(|b| steps.dimension(*b as usize));
            group.width = dimensions.sum();
            for block in &group.blocks {
                self.group_of[*block as usize] = self.groups.len() as u32;
            }
            self.groups.push(group);
        }
    }

    /// Blocks that are eliminated together with a block.
    pub fn beside(&self, block: usize) -> impl Iterator<Item = usize> + '_ {
        let group = &self.groups[self.group(block)];
        group.blocks.iter().map(|b| *b as usize)
    }

    /// Groups from `first` on are no longer up to date.
    fn discard(&mut self, first: usize) {
        let first = first.min(self.valid);
        for group in &mut self.groups[first..] {
            group.reached_by.retain(|g| (*g as usize) < first);
            group.children.retain(|g| (*g as usize) < first);
        }
        self.valid = first;
    }

    /// Brings the factor up to date after the columns of `changed` did. Returns the first group that was made anew; `None`
    /// where the matrix is not positive definite.
    pub fn update(&mut self, system: &System, steps: &Steps, changed: &[usize]) -> Option<usize> {
        let groups = changed.iter().map(|b| self.group_of[*b] as usize);
        self.discard(groups.min().unwrap_or(self.valid));
        let first = self.valid;
        while self.valid < self.groups.len() {
            self.make(system, steps, self.valid)?;
            self.valid += 1;
        }
        Some(first)
    }

    /// Makes one group from the matrix and the groups before it.
    fn make(&mut self, system: &System, steps: &Steps, at: usize) -> Option<()> {
        let mut group = std::mem::take(&mut self.groups[at]);
        self.find_rows(system, steps, at, &mut group);
        let height = group.height;
        group.panel.clear();
        group.panel.resize(height * group.width, 0.0);
        group.forward.clear();
        let mut first_column = 0;
        for block in &group.blocks {
            let n = steps.dimension(*block as usize);
            let column = system.column(*block as usize);
            for [row, start] in &column.rows {
                let m = steps.dimension(*row as usize);
                let to = self.local[*row as usize] as usize;
                let values = column.values[*start as usize..].chunks_exact(m.max(1));
                for (c, values) in values.take(n).enumerate() {
                    group.panel[(first_column + c) * height + to..][..m].copy_from_slice(values);
                }
            }
            let range = steps.range(*block as usize);
            group.forward.extend_from_slice(&system.right_side[range]);
            first_column += n;
        }
        let mut update = std::mem::take(&mut self.update);
        let reached_by = std::mem::take(&mut group.reached_by);
        for earlier in &reached_by {
            let earlier = &self.groups[*earlier as usize];
            self.subtract(earlier, steps, at, &mut group, &mut update);
        }
        group.reached_by = reached_by;
        self.update = update;
        let (panel, forward) = (&mut group.panel[..], &mut group.forward[..]);
        let made = vectorized!(cholesky(panel, forward, group.width, height));
        if made {
            let mut last = at as u32;
            for (k, [row, _]) in group.rows.iter().enumerate() {
                let above = self.group_of[*row as usize];
                if k == 0 {
                    self.groups[above as usize].children.push(at as u32);
                }
                if above != last {
                    self.groups[above as usize].reached_by.push(at as u32);
                    last = above;
                }
            }
        }
        self.groups[at] = group;
        made.then_some(())
    }

    /// Rows of a group: those of its own columns and of its children.
    fn find_rows(&mut self, system: &System, steps: &Steps, at: usize, group: &mut Group) {
        let mut height = 0;
        for block in &group.blocks {
            self.local[*block as usize] = height as u32;
            height += steps.dimension(*block as usize);
            for [row, _] in &system.column(*block as usize).rows {
                if self.group_of[*row as usize] as usize > at {
                    self.rows.add(*row as usize);
                }
            }
        }
        for child in &group.children {
            for [row, _] in &self.groups[*child as usize].rows {
                if self.group_of[*row as usize] as usize > at {
                    self.rows.add(*row as usize);
                }
            }
        }
        group.rows.clear();
        let rows = self.rows.all().iter().map(|row| [*row as u32, 0]);
        group.rows.extend(rows);
        self.rows.clear();
        let place = &self.place;
        let by_place = |row: &[u32; 2]| place[row[0] as usize];
        group.rows.sort_unstable_by_key(by_place);
        for row in &mut group.rows {
            row[1] = height as u32;
            self.local[row[0] as usize] = height as u32;
            height += steps.dimension(row[0] as usize);
        }
        group.height = height;
    }

    /// Subtracts from a group what an earlier one contributes.
    fn subtract(
        &self,
        earlier: &Group,
        steps: &Steps,
        at: usize,
        group: &mut Group,
        update: &mut Vec<f64>,
    ) {
        let is_own = |row: &[u32; 2]| self.group_of[row[0] as usize] as usize == at;
        let Some(first) = earlier.rows.iter().position(is_own) else {
            return;
        };
        let rows = &earlier.rows[first..];
        let own = rows.iter().take_while(|row| is_own(row)).count();
        let from = rows[0][1] as usize;
        let to = rows.get(own).map_or(earlier.height, |row| row[1] as usize);
        let (m, n) = (earlier.height - from, to - from);
        update.clear();
        update.resize(m * n, 0.0);
        let (panel, height) = (&earlier.panel[..], earlier.height);
        let target = &mut update[..];
        vectorized!(add_update(target, panel, height, from, m, n));
        for column in &rows[..own] {
            let to_column = self.local[column[0] as usize] as usize;
            let first = column[1] as usize - from;
            for c in 0..steps.dimension(column[0] as usize) {
                let values = &update[(first + c) * m..][..m];
                let target = &mut group.panel[(to_column + c) * group.height..][..group.height];
                for (k, row) in rows.iter().enumerate() {
                    let start = row[1] as usize - from;
                    if start < first {
                        continue;
                    }
                    let end = rows.get(k + 1).map_or(m, |next| next[1] as usize - from);
                    let target = &mut target[self.local[row[0] as usize] as usize..];
                    for (t, v) in target.iter_mut().zip(&values[start..end]) {
                        *t -= v;
                    }
                }
                let row = earlier.panel[from + first + c..].iter().step_by(height);
                let sum: f64 = row.zip(&earlier.forward).map(|(l, y)| l * y).sum();
                group.forward[to_column + c] -= sum;
            }
        }
    }

    /// Solves for the steps, from the last group back to `last`. A group before `first` is solved for only if a block that it
    /// depends on is one of `moved`. A block moves if its step changes by more than `limit`, and is added to them.
    pub fn solve(
        &mut self,
        problem: &mut Problem,
        steps: &mut Steps,
        system: &System,
        (last, first): (usize, usize),
        limit: f64,
        moved: &mut Marks,
    ) {
        self.is_pending.clear();
        self.is_pending.resize(self.groups.len(), false);
        for block in moved.all() {
            for earlier in &self.groups[self.group_of[*block] as usize].reached_by {
                self.is_pending[*earlier as usize] = true;
            }
        }
        for (at, group) in self.groups.iter().enumerate().skip(last).rev() {
            if at < first && !self.is_pending[at] {
                continue;
            }
            self.below.clear();
            self.below.extend_from_slice(&group.forward);
            for [row, _] in &group.rows {
                self.below.extend_from_slice(steps.of(*row as usize));
            }
            let (solved, panel) = (&mut self.below[..], &group.panel[..]);
            vectorized!(solve_back(solved, panel, group.width, group.height));
            let mut begin = 0;
            let mut is_reached = false;
            for block in &group.blocks {
                let range = steps.range(*block as usize);
                let new = &self.below[begin..begin + range.len()];
                begin += range.len();
                if system.differ(range, steps.of(*block as usize), new, limit) {
                    steps.set(problem, *block as usize, new);
                    moved.add(*block as usize);
                    is_reached = true;
                }
            }
            if is_reached {
                for earlier in &group.reached_by {
                    self.is_pending[*earlier as usize] = true;
                }
            }
        }
    }
}

/// `target = L_below L_ownᵀ`, lower triangle of its first rows and what is below: rows from `from` on, own ones `n`.
#[inline(always)]
#[allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]
fn add_update<const FUSED: bool>(
    (target, panel, height, from, m, n): (&mut [f64], &[f64], usize, usize, usize, usize),
) {
    add_lower_product::<FUSED>(target, panel, height, from, m, n);
}

/// Lower Cholesky factor of the first rows in place, those below divided by it, and the lower triangular system solved.
#[inline(always)]
fn cholesky<const FUSED: bool>(
    (panel, forward, width, height): (&mut [f64], &mut [f64], usize, usize),
) -> bool {
    for c in 0..width {
        let (before, rest) = panel.split_at_mut((c + 1) * height);
        let column = &mut before[c * height..];
        let pivot = column[c];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return false;
        }
        let scale = 1.0 / pivot.sqrt();
        column[c..].iter_mut().for_each(|x| *x *= scale);
        for (k, target) in rest
            .chunks_exact_mut(height)
            .take(width - c - 1)
            .enumerate()
        {
            let row = c + 1 + k;
            add_scaled::<FUSED>(&mut target[row..], &column[row..], -column[row]);
        }
        let (solved, rest) = forward.split_at_mut(c + 1);
        solved[c] /= column[c];
        add_scaled::<FUSED>(rest, &column[c + 1..], -solved[c]);
    }
    true
}

/// The first `width` numbers become `L⁻ᵀ (first − L_belowᵀ below)`, `below` being the others.
#[inline(always)]
fn solve_back<const FUSED: bool>(
    (solved, panel, width, height): (&mut [f64], &[f64], usize, usize),
) {
    for c in (0..width).rev() {
        let column = &panel[c * height..(c + 1) * height];
        let sum = long_dot::<FUSED>(&column[c + 1..], &solved[c + 1..]);
        solved[c] = (solved[c] - sum) / column[c];
    }
}
