//! Standard deviations of the batch from disjoint stretches of time.

use lsfb_solver::{BlockId, Covariance, Influence, Influences, Problem, ResidualId, influences};
use nalgebra::DVector;

use crate::Error;
use crate::scatter::{Scatter, moved};

/// Shortest stretch whose errors are taken to be independent of the next one's, seconds.
const PART_S: f64 = 0.5;

/// How well blocks are known.
pub(super) struct Known {
    /// By the weights alone.
    pub covariance: Covariance,
    /// How stretches of time scatter beside that.
    pub scatter: Scatter,
    /// By how much what the models do not know would move them.
    pub bias: DVector<f64>,
}

/// What a problem that knows more than the models of lenses and board says of blocks at the values found without.
pub(super) fn known(
    problem: &Problem,
    blocks: &[BlockId],
    timed: &[(f64, ResidualId)],
) -> Result<Known, Error> {
    let all = stretches(problem, blocks, timed)?;
    Ok(Known {
        scatter: all.scatter(),
        covariance: all.covariance,
        bias: all.step,
    })
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
