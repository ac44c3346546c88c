//! Where blocks are: steps since the problem was taken over, and the values that they lead to.

use crate::layout::POINT;
use crate::problem::{Problem, Role};
use crate::residual::ALL;

/// What becomes of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// Never moves.
    Held,
    /// Has columns in the factor.
    Reduced,
    /// Is eliminated before.
    Point,
}

/// Steps of all blocks, one after the other, by their numbers in the problem.
///
/// A step is the sum of all moves of a block, each in the tangent at the value of its time, so that linearizations made at
/// different times go together; its parts that [`Manifold::align`](crate::Manifold::align) turns are in the world's axes, so
/// that far from the origin a turn of everything does not tear apart what was linearized before and after it. The problem's
/// values are where these moves have led.
#[derive(Default)]
pub(super) struct Steps {
    parts: Vec<Part>,
    start: Vec<usize>,
    steps: Vec<f64>,
    /// Values before this update, of blocks that moved in it: first number and length in the problem, and in `old_values`.
    journal: Vec<[usize; 3]>,
    old_values: Vec<f64>,
    is_noted: Vec<bool>,
    noted: Vec<usize>,
    whole: Vec<f64>,
    moved: Vec<f64>,
}

impl Steps {
    /// Makes room for what the problem has more.
    pub fn grow(&mut self, problem: &Problem) {
        for entry in &problem.blocks[self.parts.len()..] {
            let part = match entry.role {
                Role::Eliminated if entry.free() == POINT => Part::Point,
                Role::Free | Role::Eliminated => Part::Reduced,
                Role::Constant | Role::Removed => Part::Held,
            };
            self.parts.push(part);
            self.start.push(self.steps.len());
            let free = if part == Part::Held { 0 } else { entry.free() };
            self.steps.resize(self.steps.len() + free, 0.0);
            self.is_noted.push(false);
        }
    }

    #[inline]
    pub fn part(&self, block: usize) -> Part {
        self.parts.get(block).copied().unwrap_or(Part::Held)
    }

    /// Blocks that were taken in.
    pub fn blocks(&self) -> usize {
        self.parts.len()
    }

    /// Searched components of all blocks together.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Where a block's components lie among those of all blocks.
    #[inline]
    pub fn range(&self, block: usize) -> std::ops::Range<usize> {
        let end = self.start.get(block + 1).copied();
        self.start[block]..end.unwrap_or(self.steps.len())
    }

    /// Searched components of a block.
    #[inline]
    pub fn dimension(&self, block: usize) -> usize {
        self.range(block).len()
    }

    /// Of all blocks, one after the other.
    #[inline]
    pub fn all(&self) -> &[f64] {
        &self.steps
    }

    #[inline]
    pub fn of(&self, block: usize) -> &[f64] {
        &self.steps[self.range(block)]
    }

    /// Takes a new step, and moves the problem's value by what it is more than the old one.
    pub fn set(&mut self, problem: &mut Problem, block: usize, new: &[f64]) {
        let entry = &problem.blocks[block];
        let values = entry.stored();
        if !self.is_noted[block] {
            self.is_noted[block] = true;
            self.noted.push(block);
            self.journal
                .push([values.start, values.len(), self.old_values.len()]);
            self.old_values
                .extend_from_slice(&problem.values[values.clone()]);
        }
        let range = self.range(block);
        if self.parts[block] == Part::Point {
            // A vector all of which is searched.
            let steps = self.steps[range].iter_mut().zip(new);
            for (value, (step, new)) in problem.values[values].iter_mut().zip(steps) {
                *value += new - *step;
                *step = *new;
            }
            return;
        }
        self.whole.clear();
        self.whole.resize(entry.shape.tangent, 0.0);
        for (k, (s, n)) in self.steps[range.clone()].iter().zip(new).enumerate() {
            self.whole[entry.component(k)] = n - s;
        }
        self.steps[range].copy_from_slice(new);
        self.moved.resize(values.len(), 0.0);
        align(problem, block, &mut self.whole, false);
        (entry.plus)(
            &problem.values[values.clone()],
            &self.whole,
            &mut self.moved,
        );
        problem.values[values].copy_from_slice(&self.moved);
    }

    /// A value moved by what `new` is more than the block's step.
    pub fn moved_to(&self, problem: &Problem, block: usize, new: &[f64], stored: &mut [f64]) {
        let entry = &problem.blocks[block];
        let mut whole = vec![0.0; entry.shape.tangent];
        for (k, (s, n)) in self.of(block).iter().zip(new).enumerate() {
            whole[entry.component(k)] = n - s;
        }
        let values = entry.stored();
        align(problem, block, &mut whole, false);
        (entry.plus)(&problem.values[values], &whole, stored);
    }

    /// Angle by which a block has turned since its step was `before`.
    pub fn turn_since(&mut self, problem: &Problem, block: usize, before: &[f64]) -> f64 {
        let entry = &problem.blocks[block];
        self.whole.clear();
        self.whole.resize(entry.shape.tangent, 0.0);
        let range = self.range(block);
        for (k, (s, b)) in self.steps[range].iter().zip(before).enumerate() {
            self.whole[entry.component(k)] = s - b;
        }
        (entry.turn)(&self.whole)
    }

    /// From here on, values are those to go back to.
    pub fn begin(&mut self) {
        self.journal.clear();
        self.old_values.clear();
        for block in self.noted.drain(..) {
            self.is_noted[block] = false;
        }
    }

    /// Puts the values back to where they were at the last [`Steps::begin`]; steps are void then.
    pub fn put_back(&self, problem: &mut Problem) {
        for [value, length, at] in &self.journal {
            problem.values[*value..value + length]
                .copy_from_slice(&self.old_values[*at..at + length]);
        }
    }
}

/// Turns tangent vectors of a block, one after the other, into the world's axes or back from them.
pub(super) fn align(problem: &Problem, block: usize, rows: &mut [f64], to_world: bool) {
    let entry = &problem.blocks[block];
    if entry.mask == ALL {
        let values = &problem.values[entry.stored()];
        (entry.align)(values, rows, to_world);
    }
}
