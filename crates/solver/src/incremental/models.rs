//! Linear models of residuals, each made where its blocks were at the time, and how far they can be trusted.

use crate::evaluation::squared_norm;
use crate::kernels::{multiply_add, vectorized};
use crate::problem::{Problem, ResidualId};
use crate::residual::{CONSTANT, Linearization, Parameters, Slot};
use crate::{Error, Kernel, Undefined};

use super::marks::Marks;
use super::steps::{Part, Steps, align};

/// Share of the curvature along a residual that is kept at least, as a root: what makes the normal matrix positive where a
/// kernel is linear.
const LEAST_ROOT: f64 = 0.1;

/// Share of its norm that a residual may change by between two linearizations if its kernel's curvature is to be used: far
/// from the optimum it says nothing.
const SETTLED: f64 = 0.1;

/// How far a residual may be from where it was linearized, in its own unit, which is one standard deviation.
#[derive(Clone, Copy)]
pub(super) struct Trust {
    /// Change of the residual.
    pub change: f64,
    /// Change of its gradient that the model does not foresee, by the kernel alone.
    pub kernel: f64,
    /// Whether residuals that are undefined are tried again.
    pub tries_undefined: bool,
}

/// One residual: `½ ‖b + J s‖²` over the steps `s` of its blocks. One line of the processor's cache, since most models are looked
/// at and few are made anew.
#[derive(Clone, Copy, Default)]
#[repr(align(64))]
struct Model {
    slots: [u32; 2],
    /// First of its numbers: `b`, the Jacobians of its blocks, each row by row, and `J s` where it was linearized.
    start: usize,
    dimension: u32,
    /// Length of `b` and Jacobians.
    length: u32,
    /// Root of the kernel's weight; 0 where the residual was never linearized or is undefined.
    root: f64,
    /// What is taken away from the Jacobian along the residual, as a share.
    bend: f64,
    /// Norm where it was linearized, before weighting.
    norm: f64,
    /// Whether the last linearization found the Jacobians of the one before: such a residual is linear, and its model true
    /// wherever its blocks are.
    is_linear: bool,
}

/// What of a residual is asked for only where it is linearized.
#[derive(Clone, Copy, Default)]
struct Linearized {
    cost: f64,
    /// Sum of its Jacobians' entries before weighting.
    sum: f64,
}

/// Where one block of a residual has its steps, and the residual its Jacobian; of length 0 where there is none.
#[derive(Clone, Copy)]
struct Term {
    step: u32,
    length: u32,
    jacobian: u32,
}

/// All residuals, by their numbers in the problem.
#[derive(Default)]
pub(super) struct Models {
    models: Vec<Model>,
    linearized: Vec<Linearized>,
    slots: Vec<Slot>,
    /// One for each slot.
    terms: Vec<Term>,
    numbers: Vec<f64>,
    scratch: Vec<f64>,
}

/// `target = J s`, of the Jacobians in a record.
#[inline(always)]
fn product<const FUSED: bool>(record: &[f64], terms: &[Term], steps: &[f64], target: &mut [f64]) {
    target.fill(0.0);
    for term in terms.iter().filter(|term| term.length > 0) {
        let step = &steps[term.step as usize..][..term.length as usize];
        let rows = &record[term.jacobian as usize..];
        match step.len() {
            3 => product_fixed::<FUSED, 3>(rows, step, target),
            6 => product_fixed::<FUSED, 6>(rows, step, target),
            n => {
                for (t, row) in target.iter_mut().zip(rows.chunks_exact(n.max(1))) {
                    *t += row.iter().zip(step).map(|(j, s)| j * s).sum::<f64>();
                }
            }
        }
    }
}

/// Sums of neighbouring components first, which do not wait for one another.
#[inline(always)]
fn product_fixed<const FUSED: bool, const N: usize>(
    rows: &[f64],
    step: &[f64],
    target: &mut [f64],
) {
    let (rows, _) = rows.as_chunks::<N>();
    let Some(step) = step.first_chunk::<N>() else {
        return;
    };
    for (t, row) in target.iter_mut().zip(rows) {
        let mut sums = [0.0; 3];
        for (k, (j, s)) in row.iter().zip(step).enumerate() {
            sums[k % 3] = multiply_add::<FUSED>(*j, *s, sums[k % 3]);
        }
        *t += sums[0] + sums[1] + sums[2];
    }
}

/// Takes the share `bend` away from the Jacobians along the residual.
fn bend(record: &mut [f64], slots: &[Slot], steps: &Steps, dimension: usize, bend: f64) {
    let (residual, jacobians) = record.split_at_mut(dimension);
    let share = bend / squared_norm(residual);
    for slot in slots.iter().filter(|slot| slot.jacobian != CONSTANT) {
        let n = steps.dimension(slot.block as usize);
        let jacobian = &mut jacobians[slot.jacobian as usize - dimension..][..dimension * n];
        for c in 0..n {
            let rows = residual.iter().enumerate();
            let along: f64 = rows.map(|(r, x)| x * jacobian[r * n + c]).sum();
            for (r, x) in residual.iter().enumerate() {
                jacobian[r * n + c] -= share * along * x;
            }
        }
    }
}

#[inline(always)]
#[allow(
    clippy::type_complexity,
    reason = "what is compiled for vector units takes its arguments as one tuple"
)]
fn find_stale<const FUSED: bool>(
    (models, problem, steps, residuals, trust, stale): (
        &mut Models,
        &Problem,
        &Steps,
        &[usize],
        Trust,
        &mut Marks,
    ),
) {
    for k in residuals {
        if !stale.has(*k) && models.is_stale::<FUSED>(problem, steps, *k, trust) {
            stale.add(*k);
        }
    }
}

#[inline(always)]
fn any_stale<const FUSED: bool>(
    (models, problem, steps, residuals, trust): (&mut Models, &Problem, &Steps, &[u32], Trust),
) -> bool {
    let mut residuals = residuals.iter();
    residuals.any(|k| models.is_stale::<FUSED>(problem, steps, *k as usize, trust))
}

impl Models {
    /// Makes room for what the problem has more.
    pub fn grow(&mut self, problem: &Problem) {
        let residuals = problem.residuals.len();
        self.models.resize(residuals, Model::default());
        self.linearized.resize(residuals, Linearized::default());
    }

    /// Whether a residual was registered, and not removed since.
    pub fn is_known(&self, k: usize) -> bool {
        self.models.get(k).is_some_and(|m| m.length > 0)
    }

    /// Registers a residual whose blocks are finite.
    pub fn register(&mut self, problem: &Problem, steps: &Steps, k: usize) -> Result<(), Error> {
        let dimension = problem.residuals[k].rows();
        let first = self.slots.len();
        let mut next = dimension;
        for block in problem.blocks_of(ResidualId(k)) {
            let entry = &problem.blocks[block.0];
            let stored = &problem.values[entry.stored()];
            if !stored.iter().all(|x| x.is_finite()) {
                self.slots.truncate(first);
                self.terms.truncate(first);
                return Err(Error::BlockNotFinite { block: block.0 });
            }
            let is_held = steps.part(block.0) == Part::Held;
            let jacobian = if is_held { CONSTANT } else { next as u32 };
            let length = if is_held { 0 } else { entry.free() };
            self.terms.push(Term {
                step: steps.range(block.0).start as u32,
                length: length as u32,
                jacobian,
            });
            next += dimension * length;
            self.slots.push(problem.slot(*block, jacobian));
        }
        self.models[k] = Model {
            slots: [first as u32, self.slots.len() as u32],
            start: self.numbers.len(),
            dimension: dimension as u32,
            length: next as u32,
            ..Model::default()
        };
        self.numbers
            .resize(self.numbers.len() + next + dimension, 0.0);
        Ok(())
    }

    /// A residual is no longer there.
    pub fn forget(&mut self, k: usize) {
        if let Some(model) = self.models.get_mut(k) {
            *model = Model::default();
        }
    }

    /// Rows of a residual, where its blocks lie, and its numbers: `b`, then the Jacobians.
    #[inline]
    pub fn model(&self, k: usize) -> (usize, &[Slot], &[f64]) {
        let model = &self.models[k];
        (
            model.dimension as usize,
            &self.slots[model.slots[0] as usize..model.slots[1] as usize],
            &self.numbers[model.start..][..model.length as usize],
        )
    }

    /// Whether a residual's model is true wherever its blocks are.
    pub fn is_linear(&self, k: usize) -> bool {
        self.models[k].is_linear
    }

    /// Cost of a residual where it was linearized last; `None` where it never was, or is undefined.
    pub fn cost(&self, k: usize) -> Option<f64> {
        (self.models[k].root > 0.0).then_some(self.linearized[k].cost)
    }

    /// Linearizes a residual at the problem's values, to which the steps led.
    pub fn linearize(&mut self, problem: &Problem, steps: &Steps, k: usize) -> Result<(), Error> {
        let entry = &problem.residuals[k];
        let (model, linearized) = (&mut self.models[k], &mut self.linearized[k]);
        if entry.residual.is_none() {
            return Ok(());
        }
        let dimension = model.dimension as usize;
        let own = model.slots[0] as usize..model.slots[1] as usize;
        let (slots, terms) = (&self.slots[own.clone()], &self.terms[own]);
        let numbers = &mut self.numbers[model.start..][..model.length as usize + dimension];
        let (record, shift) = numbers.split_at_mut(model.length as usize);
        let parameters = Parameters {
            values: &problem.values,
            slots,
        };
        let mut out = Linearization {
            record,
            slots,
            with_jacobians: true,
        };
        if entry.evaluate(&parameters, &mut out) == Err(Undefined) {
            // It keeps the cost it had, and pulls at nothing.
            record.fill(0.0);
            shift.fill(0.0);
            model.root = 0.0;
            return Ok(());
        }
        if !record.iter().all(|x| x.is_finite()) {
            let blocks = problem.blocks_of(ResidualId(k)).iter();
            return Err(Error::ResidualNotFinite {
                residual: k,
                blocks: blocks.map(|b| b.0).collect(),
            });
        }
        for slot in slots.iter().filter(|slot| slot.jacobian != CONSTANT) {
            let block = slot.block as usize;
            let length = dimension * steps.dimension(block);
            let rows = &mut record[slot.jacobian as usize..][..length];
            align(problem, block, rows, true);
        }
        let squared = squared_norm(&record[..dimension]);
        let sum = record[dimension..].iter().sum();
        let is_same = model.root > 0.0 && sum == linearized.sum;
        model.is_linear = is_same && entry.kernel == Kernel::Squared;
        linearized.sum = sum;
        let (robust, norm) = (entry.kernel.at(squared), squared.sqrt());
        let is_settled = model.root > 0.0 && (norm - model.norm).abs() < SETTLED * norm;
        model.bend = if is_settled {
            let kept = (1.0 - entry.kernel.shortfall(squared)).max(0.0).sqrt();
            1.0 - kept.max(LEAST_ROOT)
        } else {
            0.0
        };
        model.root = robust.weight.sqrt();
        model.norm = norm;
        linearized.cost = 0.5 * robust.cost;
        if model.bend > 0.0 {
            bend(record, slots, steps, dimension, model.bend);
        }
        if model.root != 1.0 {
            record.iter_mut().for_each(|x| *x *= model.root);
        }
        product::<false>(record, terms, steps.all(), shift);
        for (b, shift) in record.iter_mut().zip(&*shift) {
            *b = *b / (1.0 - model.bend) - shift;
        }
        Ok(())
    }

    /// Whether the model of any of some residuals cannot be trusted any more where the steps are now.
    pub fn any_stale(
        &mut self,
        problem: &Problem,
        steps: &Steps,
        residuals: &[u32],
        trust: Trust,
    ) -> bool {
        let models = self;
        vectorized!(any_stale(models, problem, steps, residuals, trust))
    }

    /// Adds to `stale` those of some residuals whose models cannot be trusted any more where the steps are now.
    pub fn find_stale(
        &mut self,
        problem: &Problem,
        steps: &Steps,
        residuals: &[usize],
        trust: Trust,
        stale: &mut Marks,
    ) {
        let models = self;
        vectorized!(find_stale(models, problem, steps, residuals, trust, stale));
    }

    /// Whether the model of a residual cannot be trusted any more where the steps are now.
    #[inline(always)]
    fn is_stale<const FUSED: bool>(
        &mut self,
        problem: &Problem,
        steps: &Steps,
        k: usize,
        trust: Trust,
    ) -> bool {
        let model = &self.models[k];
        if model.length == 0 || model.is_linear {
            return false;
        }
        if model.root == 0.0 {
            return trust.tries_undefined;
        }
        let dimension = model.dimension as usize;
        let terms = &self.terms[model.slots[0] as usize..model.slots[1] as usize];
        let numbers = &self.numbers[model.start..][..model.length as usize + dimension];
        let (record, shift) = numbers.split_at(model.length as usize);
        self.scratch.resize(dimension, 0.0);
        product::<FUSED>(record, terms, steps.all(), &mut self.scratch);
        let change = &mut self.scratch[..];
        change.iter_mut().zip(shift).for_each(|(c, s)| *c -= s);
        if model.bend == 0.0 && squared_norm(change) > trust.change * trust.change {
            return true;
        }
        // The weighted residual where it was linearized is `before`, the kernel bends along `unit`.
        let (kept, length) = (1.0 - model.bend, model.norm * model.root);
        let before = |row: usize| (record[row] + shift[row]) * kept;
        let unit = |row: usize| {
            if length > 0.0 {
                before(row) / length
            } else {
                0.0
            }
        };
        // Where the kernel is quadratic all the way, the linear model is as true as the residual's.
        let farthest = model.norm + squared_norm(change).sqrt() / model.root;
        if model.bend == 0.0 && farthest <= problem.residuals[k].kernel.quadratic_until() {
            return false;
        }
        let rows = 0..dimension;
        let along: f64 = rows.clone().map(|row| unit(row) * change[row]).sum();
        let whole = |row: usize| change[row] + model.bend / kept * along * unit(row);
        let moved: f64 = rows.clone().map(|row| whole(row).powi(2)).sum();
        if moved > trust.change * trust.change {
            return true;
        }
        // Derivatives by the weighted residual: of the kernel's cost there, and of the model.
        let weight = model.root * model.root;
        let after = rows.clone().map(|row| before(row) + whole(row));
        let after = after.map(|x| x * x).sum::<f64>() / weight;
        let ratio = problem.residuals[k].kernel.at(after).weight / weight;
        let error = rows.map(|row| {
            let foreseen = before(row) + change[row] - model.bend * along * unit(row);
            (ratio * (before(row) + whole(row)) - foreseen).powi(2)
        });
        error.sum::<f64>() > trust.kernel * trust.kernel
    }

    /// Cost of a residual at other values; `None` where it is undefined or removed.
    pub fn cost_at(problem: &Problem, k: usize, values: &[f64]) -> Option<f64> {
        let entry = &problem.residuals[k];
        let slots: Vec<Slot> = problem
            .blocks_of(ResidualId(k))
            .iter()
            .map(|block| problem.slot(*block, CONSTANT))
            .collect();
        let mut record = vec![0.0; entry.rows()];
        let mut out = Linearization {
            record: &mut record,
            slots: &slots,
            with_jacobians: false,
        };
        let parameters = Parameters {
            values,
            slots: &slots,
        };
        entry.evaluate(&parameters, &mut out).ok()?;
        Some(0.5 * entry.kernel.at(squared_norm(&record)).cost)
    }
}
