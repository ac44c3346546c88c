use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::divide::divide;
use crate::layout::Layout;
use crate::problem::{Problem, ResidualId};
use crate::residual::{Linearization, Parameters};
use crate::{Error, Undefined};

/// Residuals per parallel task.
const GRAIN: usize = 256;

/// Longest residual whose cost is evaluated without memory of its own.
const SHORT: usize = 64;

/// Costs of all residuals at one set of values, in the order of [`Layout::order`].
pub(crate) struct Evaluation {
    /// Residuals that were undefined at the starting values are left out for good.
    pub active: Vec<bool>,
    /// `½ ρ` of each residual.
    pub costs: Vec<f64>,
    /// Square of the factor on the scales of redescending kernels; 1 but for graduated solves.
    pub relaxation: f64,
    /// Residuals that were undefined in the last linearization.
    pub undefined: AtomicUsize,
    /// Lowest position of a residual that was not finite in the last linearization.
    pub not_finite: AtomicUsize,
    longest: usize,
}

/// What one evaluation of the costs gives.
#[derive(Clone, Copy)]
pub(crate) struct TotalCost {
    /// Sum of the costs.
    pub cost: f64,
    /// First residual that is not finite.
    pub not_finite: Option<usize>,
}

impl Evaluation {
    pub fn new(problem: &Problem, layout: &Layout) -> Self {
        let count = layout.order.len();
        let dimensions = layout
            .order
            .iter()
            .map(|k| problem.residuals[*k as usize].rows());
        Self {
            active: vec![true; count],
            costs: vec![0.0; count],
            relaxation: 1.0,
            undefined: AtomicUsize::new(0),
            not_finite: AtomicUsize::new(usize::MAX),
            longest: dimensions.max().unwrap_or(0),
        }
    }

    /// Costs at the starting values, which decide which residuals take part.
    pub fn start(&mut self, problem: &Problem, layout: &Layout, values: &[f64]) -> TotalCost {
        self.active.fill(true);
        // Nothing to fall back on yet: infinity never comes out of a kernel of finite residuals by itself.
        self.costs.fill(f64::NEG_INFINITY);
        let mut found = vec![0.0; self.costs.len()];
        self.total(problem, layout, values, &mut found);
        for (active, cost) in self.active.iter_mut().zip(&mut found) {
            if *cost == f64::NEG_INFINITY {
                *active = false;
                *cost = 0.0;
            }
        }
        self.costs = found;
        sum(&self.costs)
    }

    /// Costs at `values`. A residual that has become undefined keeps the cost it had: it neither rewards nor forbids
    /// the step that made it so.
    pub fn total(
        &self,
        problem: &Problem,
        layout: &Layout,
        values: &[f64],
        costs: &mut [f64],
    ) -> TotalCost {
        divide(
            0..costs.len(),
            GRAIN,
            &mut *costs,
            &|costs: &mut [f64], range, middle| costs.split_at_mut(middle - range.start),
            &|range, costs| self.costs_of(problem, layout, values, range, costs),
        );
        sum(costs)
    }

    fn costs_of(
        &self,
        problem: &Problem,
        layout: &Layout,
        values: &[f64],
        range: Range<usize>,
        costs: &mut [f64],
    ) {
        let mut short = [0.0; SHORT];
        let mut long = Vec::new();
        let scratch = if self.longest <= SHORT {
            &mut short[..]
        } else {
            long.resize(self.longest, 0.0);
            &mut long[..]
        };
        for (position, cost) in range.zip(costs) {
            if !self.active[position] {
                *cost = 0.0;
                continue;
            }
            let entry = &problem.residuals[layout.order[position] as usize];
            let record = &mut scratch[..entry.rows()];
            *cost = match evaluate(problem, layout, position, values, record, false) {
                Ok(()) => {
                    let kernel = entry.kernel.relaxed(self.relaxation);
                    0.5 * kernel.at(squared_norm(record)).cost
                }
                Err(Undefined) => self.costs[position],
            };
        }
    }

    /// Prepares for a linearization.
    pub fn begin(&self) {
        self.undefined.store(0, Ordering::Relaxed);
        self.not_finite.store(usize::MAX, Ordering::Relaxed);
    }

    /// The error of a linearization that met a residual which is not finite.
    pub fn outcome(&self, problem: &Problem, layout: &Layout) -> Result<(), Error> {
        match self.not_finite.load(Ordering::Relaxed) {
            usize::MAX => Ok(()),
            position => Err(not_finite(problem, layout, position)),
        }
    }

    /// Fills the records of a range of positions at `values`, weighted by the robust kernels.
    pub fn linearize(
        &self,
        problem: &Problem,
        layout: &Layout,
        values: &[f64],
        range: Range<usize>,
        records: &mut [f64],
    ) {
        let base = layout.record_start[range.start];
        for k in range {
            let record =
                &mut records[layout.record_start[k] - base..layout.record_start[k + 1] - base];
            let defined =
                self.active[k] && evaluate(problem, layout, k, values, record, true).is_ok();
            if !defined {
                record.fill(0.0);
                self.undefined
                    .fetch_add(usize::from(self.active[k]), Ordering::Relaxed);
                continue;
            }
            let entry = &problem.residuals[layout.order[k] as usize];
            let kernel = entry.kernel.relaxed(self.relaxation);
            let weight = kernel.at(squared_norm(&record[..entry.rows()])).weight;
            if weight != 1.0 {
                let root = weight.sqrt();
                record.iter_mut().for_each(|x| *x *= root);
            }
            // Without a way out early, which would keep it from being vectorized.
            if !record.iter().fold(true, |all, x| all & x.is_finite()) {
                self.not_finite.fetch_min(k, Ordering::Relaxed);
            }
        }
    }
}

/// The error that names the residual at a position, which is not finite.
pub(crate) fn not_finite(problem: &Problem, layout: &Layout, position: usize) -> Error {
    let residual = layout.order[position] as usize;
    Error::ResidualNotFinite {
        residual,
        blocks: problem
            .blocks_of(ResidualId(residual))
            .iter()
            .map(|block| block.index())
            .collect(),
    }
}

/// Evaluates the residual at a position into its record.
pub(crate) fn evaluate(
    problem: &Problem,
    layout: &Layout,
    position: usize,
    values: &[f64],
    record: &mut [f64],
    with_jacobians: bool,
) -> Result<(), Undefined> {
    let slots = layout.slots_of(position);
    problem.residuals[layout.order[position] as usize].evaluate(
        &Parameters { values, slots },
        &mut Linearization {
            record,
            slots,
            with_jacobians,
        },
    )
}

pub(crate) fn squared_norm(residual: &[f64]) -> f64 {
    residual.iter().map(|r| r * r).sum()
}

/// One after the other: the same sum on any number of threads.
fn sum(costs: &[f64]) -> TotalCost {
    TotalCost {
        cost: costs.iter().sum(),
        not_finite: costs.iter().position(|c| !c.is_finite()),
    }
}
