use std::ops::Range;

use crate::Error;
use crate::problem::{Problem, ResidualId, Role};
use crate::residual::{CONSTANT, Slot};

/// Dimension of an eliminated point.
pub(crate) const POINT: usize = 3;

/// The part that a block plays in the normal equations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// Number of the block in the reduced system.
    Reduced(usize),
    /// Number of the point.
    Point(usize),
    /// Not searched.
    Constant,
}

/// A Jacobian in a residual's record.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Incidence {
    pub residual: usize,
    /// First number of the Jacobian in the record.
    pub jacobian: usize,
}

/// A reduced block that shares residuals with a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    pub point: usize,
    pub reduced: usize,
    /// First number of its `tangent × 3` matrix, columns first, in pair values.
    pub start: usize,
}

/// Where everything lies: fixed once per solve, so that iterations only fill numbers in.
pub(crate) struct Layout {
    /// Slots of all residuals, and each one's range by `slot_start[k]..slot_start[k + 1]`.
    pub slots: Vec<Slot>,
    pub slot_start: Vec<usize>,
    /// Record of residual `k`: `record_start[k]..record_start[k + 1]`.
    pub record_start: Vec<usize>,
    /// Part of each block.
    pub places: Vec<Place>,
    /// Blocks of the reduced system in their order, and of the points.
    pub reduced: Vec<usize>,
    pub points: Vec<usize>,
    /// Row of each reduced block in the reduced system; one more entry: its dimension.
    pub row_start: Vec<usize>,
    /// Jacobians by reduced block and by point.
    pub by_reduced: Groups<Incidence>,
    pub by_point: Groups<Incidence>,
    /// Pairs, those of a point together and in order of reduced block; and the pairs of each reduced block.
    pub pairs: Vec<Pair>,
    pub pairs_of_point: Vec<usize>,
    pub pairs_of_reduced: Groups<usize>,
    /// Length of pair values.
    pub pair_len: usize,
    /// For each reduced block `i` the blocks `j ≥ i` it is coupled with, `i` first.
    pub coupled: Groups<usize>,
    /// Lower triangle of the reduced matrix by columns.
    pub column_start: Vec<usize>,
    pub row_index: Vec<usize>,
}

/// Lists one after the other.
pub(crate) struct Groups<T> {
    items: Vec<T>,
    start: Vec<usize>,
}

impl<T: Copy> Groups<T> {
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
        let mut items: Vec<Option<T>> = vec![None; start[groups]];
        for (group, item) in pairs {
            items[next[group]] = Some(item);
            next[group] += 1;
        }
        Self {
            items: items.into_iter().flatten().collect(),
            start,
        }
    }

    pub fn get(&self, group: usize) -> &[T] {
        &self.items[self.range(group)]
    }

    pub fn range(&self, group: usize) -> Range<usize> {
        self.start[group]..self.start[group + 1]
    }
}

impl Layout {
    pub fn new(problem: &Problem) -> Result<Self, Error> {
        let mut places = Vec::with_capacity(problem.blocks.len());
        let (mut reduced, mut points, mut row_start) = (Vec::new(), Vec::new(), vec![0]);
        let mut touched = vec![false; problem.blocks.len()];
        for block in &problem.block_lists {
            touched[block.0] = true;
        }
        for (index, block) in problem.blocks.iter().enumerate() {
            // A block without residuals has no row: it stays where it is.
            places.push(match block.role {
                Role::Free if touched[index] => {
                    row_start.push(row_start[reduced.len()] + block.shape.tangent);
                    reduced.push(index);
                    Place::Reduced(reduced.len() - 1)
                }
                Role::Eliminated if touched[index] => {
                    points.push(index);
                    Place::Point(points.len() - 1)
                }
                _ => Place::Constant,
            });
        }

        let count = problem.residuals.len();
        let mut slots = Vec::with_capacity(problem.block_lists.len());
        let (mut slot_start, mut record_start) = (vec![0], vec![0]);
        for k in 0..count {
            let dimension = problem.residuals[k].dimension;
            let mut next = dimension;
            for block in problem.blocks_of(ResidualId(k)) {
                let entry = &problem.blocks[block.0];
                let jacobian = if places[block.0] == Place::Constant {
                    CONSTANT
                } else {
                    next += dimension * entry.shape.tangent;
                    next - dimension * entry.shape.tangent
                };
                slots.push(Slot {
                    block: block.0,
                    value: entry.start,
                    jacobian,
                });
            }
            slot_start.push(slots.len());
            record_start.push(record_start[k] + next);
        }

        let incidences = |wanted: fn(Place) -> Option<usize>| {
            let (slots, slot_start, places) = (&slots, &slot_start, &places);
            (0..count).flat_map(move |k| {
                slots[slot_start[k]..slot_start[k + 1]]
                    .iter()
                    .filter_map(move |slot| {
                        Some((
                            wanted(places[slot.block])?,
                            Incidence {
                                residual: k,
                                jacobian: slot.jacobian,
                            },
                        ))
                    })
            })
        };
        let reduced_of = |place| match place {
            Place::Reduced(i) => Some(i),
            _ => None,
        };
        let point_of = |place| match place {
            Place::Point(p) => Some(p),
            _ => None,
        };
        let by_reduced = Groups::collect(reduced.len(), incidences(reduced_of));
        let by_point = Groups::collect(points.len(), incidences(point_of));

        let mut pairs = Vec::new();
        let mut pairs_of_point = vec![0];
        let mut pair_len = 0;
        let mut seen = Vec::new();
        for p in 0..points.len() {
            seen.clear();
            for incidence in by_point.get(p) {
                let range = slot_start[incidence.residual]..slot_start[incidence.residual + 1];
                seen.extend(
                    slots[range]
                        .iter()
                        .filter_map(|slot| reduced_of(places[slot.block])),
                );
            }
            seen.sort_unstable();
            seen.dedup();
            for &i in &seen {
                pairs.push(Pair {
                    point: p,
                    reduced: i,
                    start: pair_len,
                });
                pair_len += POINT * (row_start[i + 1] - row_start[i]);
            }
            pairs_of_point.push(pairs.len());
        }
        let pairs_of_reduced = Groups::collect(
            reduced.len(),
            pairs.iter().enumerate().map(|(q, pair)| (pair.reduced, q)),
        );

        let mut layout = Self {
            slots,
            slot_start,
            record_start,
            places,
            reduced,
            points,
            row_start,
            by_reduced,
            by_point,
            pairs,
            pairs_of_point,
            pairs_of_reduced,
            pair_len,
            coupled: Groups {
                items: Vec::new(),
                start: vec![0],
            },
            column_start: vec![0],
            row_index: Vec::new(),
        };
        layout.couple()?;
        Ok(layout)
    }

    /// Dimension of the reduced system.
    pub fn dimension(&self) -> usize {
        self.row_start[self.reduced.len()]
    }

    /// Slots of a residual.
    pub fn slots_of(&self, residual: usize) -> &[Slot] {
        &self.slots[self.slot_start[residual]..self.slot_start[residual + 1]]
    }

    /// Tangent dimension of a reduced block.
    pub fn tangent(&self, reduced: usize) -> usize {
        self.row_start[reduced + 1] - self.row_start[reduced]
    }

    /// Pairs of a point.
    pub fn pairs_at(&self, point: usize) -> &[Pair] {
        &self.pairs[self.pairs_of_point[point]..self.pairs_of_point[point + 1]]
    }

    /// Values of the lower triangle that belong to the columns of a reduced block.
    pub fn values_of(&self, reduced: usize) -> Range<usize> {
        self.column_start[self.row_start[reduced]]..self.column_start[self.row_start[reduced + 1]]
    }

    /// Finds which blocks are coupled, and from it the pattern of the reduced matrix.
    fn couple(&mut self) -> Result<(), Error> {
        let count = self.reduced.len();
        let mut mark = vec![usize::MAX; count];
        let mut entries = 0usize;
        for i in 0..count {
            let first = self.coupled.items.len();
            self.coupled.items.push(i);
            mark[i] = i;
            let items = &mut self.coupled.items;
            let mut visit = |j: usize| {
                if j > i && mark[j] != i {
                    mark[j] = i;
                    items.push(j);
                }
            };
            for incidence in self.by_reduced.get(i) {
                let range =
                    self.slot_start[incidence.residual]..self.slot_start[incidence.residual + 1];
                for slot in &self.slots[range] {
                    if let Place::Reduced(j) = self.places[slot.block] {
                        visit(j);
                    }
                }
            }
            for &q in self.pairs_of_reduced.get(i) {
                let p = self.pairs[q].point;
                for pair in &self.pairs[self.pairs_of_point[p]..self.pairs_of_point[p + 1]] {
                    visit(pair.reduced);
                }
            }
            self.coupled.items[first..].sort_unstable();
            self.coupled.start.push(self.coupled.items.len());

            let n = self.tangent(i);
            let rows: usize = self.coupled.get(i).iter().map(|&j| self.tangent(j)).sum();
            entries += n * rows - n * (n - 1) / 2;
            let too_large = |_| Error::TooLarge {
                dimension: self.row_start[count],
                entries,
            };
            self.row_index
                .try_reserve(entries - self.row_index.len())
                .map_err(too_large)?;
            for column in 0..n {
                for &j in self.coupled.get(i) {
                    let skip = if j == i { column } else { 0 };
                    self.row_index
                        .extend(self.row_start[j] + skip..self.row_start[j + 1]);
                }
                self.column_start.push(self.row_index.len());
            }
        }
        Ok(())
    }
}
