use rayon::prelude::*;

use crate::layout::Layout;
use crate::problem::{Problem, ResidualId};
use crate::residual::{Linearization, Parameters};
use crate::{Error, Undefined};

/// Residuals per parallel task. Fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 256;

/// Costs and Jacobians of all residuals at one set of values.
pub(crate) struct Evaluation {
    /// Residuals that were undefined at the starting values are left out for good.
    pub active: Vec<bool>,
    /// `½ ρ` of each residual.
    pub costs: Vec<f64>,
    /// Residuals and Jacobians, weighted by the robust kernel; see [`Layout::record_start`].
    pub records: Vec<f64>,
    /// Residuals that were undefined in the last linearization.
    pub undefined: usize,
    longest: usize,
}

/// What one evaluation of the costs gives.
pub(crate) struct TotalCost {
    /// Sum of the costs.
    pub cost: f64,
    /// First residual that is not finite.
    pub not_finite: Option<usize>,
}

impl Evaluation {
    pub fn new(problem: &Problem, layout: &Layout) -> Self {
        Self {
            active: vec![true; problem.residuals.len()],
            costs: vec![0.0; problem.residuals.len()],
            records: vec![0.0; layout.record_start[problem.residuals.len()]],
            undefined: 0,
            longest: problem
                .residuals
                .iter()
                .map(|r| r.dimension)
                .max()
                .unwrap_or(0),
        }
    }

    /// Costs at the starting values, which decide which residuals take part.
    pub fn start(&mut self, problem: &Problem, layout: &Layout) -> TotalCost {
        self.active.fill(true);
        let mut costs = std::mem::take(&mut self.costs);
        // Nothing to fall back on yet: infinity never comes out of a kernel of finite residuals by itself.
        costs.fill(f64::NEG_INFINITY);
        let mut found = vec![0.0; costs.len()];
        self.costs = costs;
        self.total(problem, layout, &problem.values, &mut found);
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
        costs.par_chunks_mut(CHUNK).enumerate().for_each_init(
            || vec![0.0; self.longest],
            |record, (chunk, costs)| {
                for (offset, cost) in costs.iter_mut().enumerate() {
                    let k = chunk * CHUNK + offset;
                    if !self.active[k] {
                        *cost = 0.0;
                        continue;
                    }
                    let entry = &problem.residuals[k];
                    let record = &mut record[..entry.dimension];
                    *cost = match evaluate(problem, layout, k, values, record, false) {
                        Ok(()) => 0.5 * entry.kernel.at(squared_norm(record)).cost,
                        Err(Undefined) => self.costs[k],
                    };
                }
            },
        );
        sum(costs)
    }

    /// Fills the records at `values`.
    pub fn linearize(
        &mut self,
        problem: &Problem,
        layout: &Layout,
        values: &[f64],
    ) -> Result<(), Error> {
        let count = problem.residuals.len();
        let mut chunks = Vec::with_capacity(count.div_ceil(CHUNK));
        let mut rest = self.records.as_mut_slice();
        for first in (0..count).step_by(CHUNK) {
            let end = (first + CHUNK).min(count);
            let (records, tail) =
                rest.split_at_mut(layout.record_start[end] - layout.record_start[first]);
            chunks.push((first..end, records));
            rest = tail;
        }
        let active = &self.active;
        let outcomes: Vec<Result<usize, usize>> = chunks
            .into_par_iter()
            .map(|(range, records)| {
                let base = layout.record_start[range.start];
                let mut undefined = 0;
                for k in range {
                    let record = &mut records
                        [layout.record_start[k] - base..layout.record_start[k + 1] - base];
                    let entry = &problem.residuals[k];
                    let defined =
                        active[k] && evaluate(problem, layout, k, values, record, true).is_ok();
                    if !defined {
                        record.fill(0.0);
                        undefined += usize::from(active[k]);
                        continue;
                    }
                    let weight = entry
                        .kernel
                        .at(squared_norm(&record[..entry.dimension]))
                        .weight;
                    if weight != 1.0 {
                        let root = weight.sqrt();
                        record.iter_mut().for_each(|x| *x *= root);
                    }
                    if !record.iter().all(|x| x.is_finite()) {
                        return Err(k);
                    }
                }
                Ok(undefined)
            })
            .collect();
        self.undefined = 0;
        for outcome in outcomes {
            self.undefined += outcome.map_err(|k| not_finite(problem, k))?;
        }
        Ok(())
    }
}

/// The error that names a residual which is not finite.
pub(crate) fn not_finite(problem: &Problem, residual: usize) -> Error {
    Error::ResidualNotFinite {
        residual,
        blocks: problem
            .blocks_of(ResidualId(residual))
            .iter()
            .map(|block| block.index())
            .collect(),
    }
}

/// Evaluates residual `k` into its record.
pub(crate) fn evaluate(
    problem: &Problem,
    layout: &Layout,
    k: usize,
    values: &[f64],
    record: &mut [f64],
    with_jacobians: bool,
) -> Result<(), Undefined> {
    let slots = layout.slots_of(k);
    problem.residuals[k].residual.evaluate(
        &Parameters { values, slots },
        &mut Linearization {
            record,
            slots,
            with_jacobians,
        },
    )
}

fn squared_norm(residual: &[f64]) -> f64 {
    residual.iter().map(|r| r * r).sum()
}

/// One after the other: the same sum on any number of threads.
fn sum(costs: &[f64]) -> TotalCost {
    TotalCost {
        cost: costs.iter().sum(),
        not_finite: costs.iter().position(|c| !c.is_finite()),
    }
}
