//! The two halves of a recording against each other.
//!
//! What one half would find alone is read off the normal equations of the whole, to first order: with `C` the covariance of the
//! whole, a half that has the noise `M = C Jᵀ J C` in its shift `d = −C Jᵀ r` has the information `N = C⁻¹ M C⁻¹` and lies
//! `N⁻¹ C⁻¹ d` from the whole. What belongs to no time (priors) both have. The motion, which lies in one half or the other, is eliminated.

use lsfb_solver::{BlockId, Influence, Problem, ResidualId};
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::parts::{Stretches, stretches};
use crate::Error;
use crate::scatter::{Scatter, moved};

/// One number as either half of the recording has it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SplitEstimate {
    /// Its name in [`super::JointCovariance::names`].
    pub name: String,
    /// What either half finds less what the whole recording does, first half first, in SI units and pixels.
    pub from_whole: [f64; 2],
    /// Standard deviations, from the scatter within each half.
    pub sigma: [f64; 2],
    /// By how much what the models of lenses and board do not know would move it: halves may differ by that as well.
    pub unmodelled: f64,
}

impl SplitEstimate {
    /// The second half less the first, with its standard deviation.
    pub fn difference(&self) -> [f64; 2] {
        let [first, second] = self.sigma;
        let unmodelled = self.unmodelled * 2f64.sqrt();
        [
            self.from_whole[1] - self.from_whole[0],
            first.hypot(second).hypot(unmodelled),
        ]
    }

    /// Standard deviations that halves are apart.
    pub fn deviations(&self) -> f64 {
        let [difference, sigma] = self.difference();
        difference.abs() / sigma.max(f64::MIN_POSITIVE)
    }
}

/// What is not compared: biases wander, and gravity takes what they leave.
const IN_TIME: [&str; 3] = ["gyroscope bias", "accelerometer bias", "gravity"];

/// One half: where it lies from the whole, and its standard deviations.
struct Half {
    from_whole: DVector<f64>,
    sigma: DVector<f64>,
}

/// Either half, by row of the blocks' joint covariance; `None` where one does not determine all rows that the whole does.
/// `names` are those of the first rows; rows without one are not reported.
pub(super) fn halves(
    problem: &Problem,
    blocks: &[BlockId],
    timed: &[(f64, ResidualId)],
    names: &[Option<String>],
    unmodelled: &DVector<f64>,
) -> Result<Vec<SplitEstimate>, Error> {
    let Stretches {
        covariance,
        step,
        parts,
    } = stretches(problem, blocks, timed)?;
    let covariance = covariance.joint();
    let (first, second) = parts.split_at(parts.len() / 2);
    let alone = [first, second].map(|own| half(covariance, &step, &parts, own));
    let [Some(first), Some(second)] = alone else {
        return Ok(Vec::new());
    };
    let rows = names.iter().enumerate();
    Ok(rows
        .filter_map(|(k, name)| {
            let name = name
                .clone()
                .filter(|name| !IN_TIME.iter().any(|word| name.starts_with(word)))?;
            Some(SplitEstimate {
                name,
                from_whole: [first.from_whole[k], second.from_whole[k]],
                sigma: [first.sigma[k], second.sigma[k]],
                unmodelled: unmodelled[k],
            })
        })
        .collect())
}

fn half(
    covariance: &DMatrix<f64>,
    step: &DVector<f64>,
    all: &[Influence],
    own: &[Influence],
) -> Option<Half> {
    let size = covariance.nrows();
    // Rows of zeros are of what was not searched.
    let rows: Vec<usize> = (0..size).filter(|k| covariance[(*k, *k)] > 0.0).collect();
    let scale =
        DVector::from_iterator(rows.len(), rows.iter().map(|k| covariance[(*k, *k)].sqrt()));
    let scaled = |matrix: &DMatrix<f64>| {
        DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
            matrix[(rows[i], rows[j])] / (scale[i] * scale[j])
        })
    };
    let sum = |parts: &[Influence]| {
        let noise = parts
            .iter()
            .fold(DMatrix::zeros(size, size), |sum, p| sum + &p.noise);
        let shift = parts
            .iter()
            .fold(DVector::zeros(size), |sum, p| sum + &p.shift);
        (scaled(&noise), shift)
    };
    let information = scaled(covariance).cholesky()?.inverse();
    let (noise_of_all, shift_of_all) = sum(all);
    let (noise, shift) = sum(own);
    // Beside its own residuals a half has those that belong to no time.
    let known = &information - &information * (noise_of_all - noise) * &information;
    let alone = ((&known + known.transpose()) * 0.5).cholesky()?.inverse();
    let shift = shift + step - shift_of_all;
    let shift = DVector::from_fn(rows.len(), |i, _| shift[rows[i]] / scale[i]);
    let found = &alone * (&information * shift);
    let mut from_whole = DVector::zeros(size);
    for (i, row) in rows.iter().enumerate() {
        from_whole[*row] = found[i] * scale[i];
    }
    let about_own = moved(covariance, own.to_vec(), &from_whole);
    let factors = Scatter::of_neighbours(covariance, &about_own).factors(size);
    let mut sigma = DVector::zeros(size);
    for (i, row) in rows.iter().enumerate() {
        sigma[*row] = alone[(i, i)].max(0.0).sqrt() * scale[i] * factors[*row];
    }
    Some(Half { from_whole, sigma })
}
