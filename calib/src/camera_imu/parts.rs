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
    /// By the weights alone, whatever the delay is.
    pub covariance: Covariance,
    /// How stretches of time scatter beside that.
    pub scatter: Scatter,
    /// By how much what the models do not know would move them.
    pub bias: DVector<f64>,
    /// How much later than the gyroscope the accelerometer measures, seconds, where that is asked for and clear.
    pub delay_s: Option<f64>,
}

/// What a problem that knows more than the models of lenses and board says of blocks at the values found without. `delay` is the
/// accelerometer's, one more thing that the models do not know: hardly an IMU has none, whether it is clear or not.
pub(super) fn known(
    problem: &Problem,
    blocks: &[BlockId],
    delay: Option<BlockId>,
    timed: &[(f64, ResidualId)],
) -> Result<Known, Error> {
    let asked: Vec<BlockId> = blocks.iter().copied().chain(delay).collect();
    let all = stretches(problem, &asked, timed)?;
    let mut found = Known {
        scatter: all.scatter(),
        covariance: all.covariance,
        bias: all.step,
        delay_s: None,
    };
    if delay.is_some() {
        let row = found.bias.len() - 1;
        let sigma = found.covariance.joint()[(row, row)].max(0.0).sqrt();
        let sigma_s = sigma * found.scatter.factors(row + 1)[row];
        let delay_s = found.bias[row];
        found.delay_s = (delay_s.abs() > CLEAR_DELAY * sigma_s).then_some(delay_s);
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
