use std::collections::BTreeMap;

use crate::kernels::{add_scaled, subtract_wide, vectorized};

/// Symmetric positive matrix by blocks: of each block its neighbours, itself included, with the block of rows of the
/// neighbour and columns of its own, columns first.
pub(crate) type Neighbours = BTreeMap<usize, Vec<f64>>;

/// One column of blocks of the factor.
#[derive(Default)]
struct Column {
    /// Lower triangle on the diagonal, columns first.
    diagonal: Vec<f64>,
    /// Blocks below it, by their number; and where the values of each begin.
    rows: Vec<usize>,
    start: Vec<usize>,
    values: Vec<f64>,
    /// Solution of the lower triangular system.
    forward: Vec<f64>,
}

/// Cholesky factor of a matrix that grows: kept up to the first column that a change can reach, made anew from there.
#[derive(Default)]
pub(crate) struct Factor {
    /// Blocks in the order of elimination, and the place of each; [`NOWHERE`] for others.
    order: Vec<usize>,
    place: Vec<usize>,
    columns: Vec<Column>,
    /// Scratch: columns that reach each place; first value of each block in the column at work.
    updates: Vec<Vec<usize>>,
    offset: Vec<usize>,
}

const NOWHERE: usize = usize::MAX;

/// What the factor is made of.
pub(crate) struct System<'a> {
    /// By block.
    pub matrix: &'a [Neighbours],
    pub right_side: &'a [Vec<f64>],
    /// Share of the diagonal added to it.
    pub damping: f64,
}

impl Factor {
    pub fn order(&self) -> &[usize] {
        &self.order
    }

    /// Brings the factor up to date after the blocks in `changed` did, and puts `order` in force. Returns the first
    /// place made anew; `None` where the matrix is not positive definite.
    pub fn update(
        &mut self,
        system: &System<'_>,
        order: Vec<usize>,
        changed: impl Iterator<Item = usize>,
    ) -> Option<usize> {
        let same = self.order.iter().zip(&order).take_while(|(a, b)| a == b);
        let mut first = same.count();
        self.place.resize(system.matrix.len(), NOWHERE);
        self.offset.resize(system.matrix.len(), NOWHERE);
        for block in &self.order[first..] {
            self.place[*block] = NOWHERE;
        }
        self.order = order;
        for (k, block) in self.order.iter().enumerate().skip(first) {
            self.place[*block] = k;
        }
        for block in changed {
            first = first.min(self.place[block]);
        }
        first = first.min(self.columns.len());
        self.columns.truncate(first);
        self.updates.iter_mut().for_each(Vec::clear);
        self.updates.resize(self.order.len(), Vec::new());
        let mut children: Vec<Vec<usize>> = vec![Vec::new(); self.order.len()];
        for (k, column) in self.columns.iter().enumerate() {
            let mut parent = NOWHERE;
            for row in &column.rows {
                let place = self.place[*row];
                parent = parent.min(place);
                if place >= first {
                    self.updates[place].push(k);
                }
            }
            if parent >= first && parent != NOWHERE {
                children[parent].push(k);
            }
        }
        for place in first..self.order.len() {
            let column = self.column(system, place, &children[place])?;
            let places = column.rows.iter().map(|row| self.place[*row]);
            if let Some(parent) = places.clone().min() {
                children[parent].push(place);
            }
            for row in places {
                self.updates[row].push(place);
            }
            self.columns.push(column);
        }
        Some(first)
    }

    /// Makes one column from the matrix and the columns before it.
    fn column(&mut self, system: &System<'_>, place: usize, children: &[usize]) -> Option<Column> {
        let block = self.order[place];
        let n = system.right_side[block].len();
        let neighbours = &system.matrix[block];
        let mut rows: Vec<usize> = neighbours.keys().copied().collect();
        for child in children {
            rows.extend_from_slice(&self.columns[*child].rows);
        }
        rows.retain(|row| self.place[*row] != NOWHERE && self.place[*row] > place);
        rows.sort_unstable_by_key(|row| self.place[*row]);
        rows.dedup();
        let mut start = vec![0];
        for (k, row) in rows.iter().enumerate() {
            self.offset[*row] = start[k];
            start.push(start[k] + n * system.right_side[*row].len());
        }
        let mut values = vec![0.0; start[rows.len()]];
        let mut diagonal = neighbours.get(&block).cloned().unwrap_or_default();
        diagonal.resize(n * n, 0.0);
        for k in 0..n {
            let entry = &mut diagonal[k * n + k];
            *entry += system.damping * entry.max(f64::MIN_POSITIVE);
        }
        for (k, row) in rows.iter().enumerate() {
            if let Some(source) = neighbours.get(row) {
                values[start[k]..start[k + 1]].copy_from_slice(source);
            }
        }
        let mut forward = system.right_side[block].clone();
        let parts = Parts {
            diagonal: &mut diagonal,
            values: &mut values,
            forward: &mut forward,
        };
        vectorized!(subtract_earlier(&*self, system, place, parts));
        cholesky(&mut diagonal, n)?;
        solve_lower(&diagonal, n, &mut forward);
        for (k, row) in rows.iter().enumerate() {
            let m = system.right_side[*row].len();
            divide_by_lower(&mut values[start[k]..start[k + 1]], m, &diagonal, n);
        }
        Some(Column {
            diagonal,
            rows,
            start,
            values,
            forward,
        })
    }

    /// Solves for `step`, by block, from the last column back. A column before `first` is solved for only if a block it
    /// depends on moved; `moved(block, old, new)` says whether a new part counts as that, and only then is it taken.
    pub fn solve(
        &self,
        first: usize,
        step: &mut [Vec<f64>],
        mut moved: impl FnMut(usize, &[f64], &[f64]) -> bool,
    ) -> Vec<usize> {
        let mut is_moved = vec![false; step.len()];
        let mut blocks = Vec::new();
        for (place, column) in self.columns.iter().enumerate().rev() {
            if place < first && !column.rows.iter().any(|row| is_moved[*row]) {
                continue;
            }
            let block = self.order[place];
            let mut part = column.forward.clone();
            for (k, row) in column.rows.iter().enumerate() {
                let x = &step[*row];
                let values = &column.values[column.start[k]..column.start[k + 1]];
                for (t, v) in part.iter_mut().zip(values.chunks_exact(x.len().max(1))) {
                    *t -= v.iter().zip(x).map(|(v, x)| v * x).sum::<f64>();
                }
            }
            solve_upper(&column.diagonal, part.len(), &mut part);
            if moved(block, &step[block], &part) {
                is_moved[block] = true;
                blocks.push(block);
                step[block].copy_from_slice(&part);
            }
        }
        blocks
    }
}

/// A column at work.
struct Parts<'a> {
    diagonal: &'a mut [f64],
    values: &'a mut [f64],
    forward: &'a mut [f64],
}

/// Subtracts from a column what the columns before it contribute.
#[inline(always)]
fn subtract_earlier<const FUSED: bool>(
    (factor, system, place, parts): (&Factor, &System<'_>, usize, Parts<'_>),
) {
    let block = factor.order[place];
    let n = parts.forward.len();
    for earlier in &factor.updates[place] {
        let earlier = &factor.columns[*earlier];
        let Some(own) = earlier.rows.iter().position(|row| *row == block) else {
            continue;
        };
        let own = &earlier.values[earlier.start[own]..earlier.start[own + 1]];
        subtract_wide::<FUSED>(parts.diagonal, own, n, own, n);
        for (f, column) in earlier.forward.iter().zip(own.chunks_exact(n.max(1))) {
            add_scaled::<FUSED>(parts.forward, column, -*f);
        }
        for (k, row) in earlier.rows.iter().enumerate() {
            if factor.place[*row] > place {
                let left = &earlier.values[earlier.start[k]..earlier.start[k + 1]];
                let m = system.right_side[*row].len();
                let target = &mut parts.values[factor.offset[*row]..][..m * n];
                subtract_wide::<FUSED>(target, left, m, own, n);
            }
        }
    }
}

/// Lower Cholesky factor in place, columns first; the upper triangle is left as it is.
fn cholesky(a: &mut [f64], n: usize) -> Option<()> {
    for c in 0..n {
        for k in 0..c {
            let factor = a[k * n + c];
            for r in c..n {
                a[c * n + r] -= factor * a[k * n + r];
            }
        }
        let pivot = a[c * n + c];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let root = pivot.sqrt();
        for r in c..n {
            a[c * n + r] /= root;
        }
    }
    Some(())
}

fn solve_lower(l: &[f64], n: usize, x: &mut [f64]) {
    for c in 0..n {
        x[c] /= l[c * n + c];
        for r in c + 1..n {
            x[r] -= l[c * n + r] * x[c];
        }
    }
}

fn solve_upper(l: &[f64], n: usize, x: &mut [f64]) {
    for c in (0..n).rev() {
        for r in c + 1..n {
            x[c] -= l[c * n + r] * x[r];
        }
        x[c] /= l[c * n + c];
    }
}

/// `x ← x L⁻ᵀ`, `x` being `m × n`.
fn divide_by_lower(x: &mut [f64], m: usize, l: &[f64], n: usize) {
    for c in 0..n {
        for k in 0..c {
            let factor = l[k * n + c];
            for r in 0..m {
                x[c * m + r] -= factor * x[k * m + r];
            }
        }
        for r in 0..m {
            x[c * m + r] /= l[c * n + c];
        }
    }
}
