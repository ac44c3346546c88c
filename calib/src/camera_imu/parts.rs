//! Standard deviations of the batch from disjoint stretches of time.

use lsfb_solver::{BlockId, Covariance, Influence, Influences, Problem, ResidualId, influences};
use nalgebra::DVector;

use crate::Error;
use crate::scatter::{Scatter, moved};

/// Shortest stretch whose errors are taken to be independent of the next one's, seconds.
const PART_S: f64 = 0.5;

/// Standard deviations beyond which a delay of the accelerometer is none of chance.
const CLEAR_DELAY: f64 = 4.0;

/// How well blocks are known.
pub(super) struct Known {
    /// By the weights alone.
    pub covariance: Covariance,
    /// How stretches of time scatter beside that.
    pub scatter: Scatter,
    /// By how much what the models do not know would move them.
    pub bias: DVector<f64>,
    /// How much later than the gyroscope the accelerometer measures, seconds, where that is asked for and clear.
    pub delay_s: Option<f64>,
}

/// What a problem that knows more than the models of lenses and board says of blocks at the values found without. `delay` is the
/// accelerometer's; where it is none of chance it is one more thing that the models do not know, else it is zero.
pub(super) fn known(
    problem: &Problem,
    blocks: &[BlockId],
    delay: Option<BlockId>,
    timed: &[(f64, ResidualId)],
) -> Result<Known, Error> {
    let asked: Vec<BlockId> = blocks.iter().copied().chain(delay).collect();
    let all = stretches(problem, &asked, timed)?;
    let scatter = all.scatter();
    let mut found = Known {
        scatter,
        covariance: all.covariance.clone(),
        bias: all.step.clone(),
        delay_s: None,
    };
    if delay.is_some() {
        let row = all.step.len() - 1;
        let sigma = all.covariance.joint()[(row, row)].max(0.0).sqrt();
        let sigma_s = sigma * found.scatter.factors(row + 1)[row];
        if all.step[row].abs() > CLEAR_DELAY * sigma_s {
            found.delay_s = Some(all.step[row]);
        } else {
            let without = all.conditioned(row);
            found.scatter = without.scatter();
            found.covariance = without.covariance;
            found.bias = without.step;
        }
    }
    Ok(found)
}

/// What stretches of time say of blocks.
pub(super) struct Stretches {
    pub covariance: Covariance,
    /// By how much all of them together would move the blocks.
    pub step: DVector<f64>,
    /// In their order.
    pub parts: Vec<Influence>,
}

impl Stretches {
    /// How they scatter about where all of them together would have the blocks.
    fn scatter(&self) -> Scatter {
        let covariance = self.covariance.joint();
        let parts = moved(covariance, self.parts.clone(), &self.step);
        Scatter::of_neighbours(covariance, &parts)
    }

    /// The same were the dimension of a row known.
    fn conditioned(self, row: usize) -> Self {
        let gain = self.covariance.joint().column(row) / self.covariance.joint()[(row, row)];
        let held = |v: &DVector<f64>| v - &gain * v[row];
        let parts = self.parts.iter().map(|part| {
            let rows = &part.noise - &gain * part.noise.row(row);
            let noise = &rows - rows.column(row) * gain.transpose();
            Influence {
                shift: held(&part.shift),
                noise,
            }
        });
        Self {
            parts: parts.collect(),
            step: held(&self.step),
            covariance: self.covariance.conditioned(row),
        }
    }
}

pub(super) fn stretches(
    problem: &Problem,
    blocks: &[BlockId],
    timed: &[(f64, ResidualId)],
) -> Result<Stretches, Error> {
    let start_s = timed.iter().map(|t| t.0).fold(f64::INFINITY, f64::min);
    let mut parts: Vec<Vec<ResidualId>> = Vec::new();
    for (time_s, residual) in timed {
        let part = ((time_s - start_s) / PART_S) as usize;
        if parts.len() <= part {
            parts.resize(part + 1, Vec::new());
        }
        parts[part].push(*residual);
    }
    parts.retain(|part| !part.is_empty());
    let Influences {
        covariance,
        step,
        groups,
    } = influences(problem, blocks, &parts)?;
    Ok(Stretches {
        covariance,
        step,
        parts: groups,
    })
}
