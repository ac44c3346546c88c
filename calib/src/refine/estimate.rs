//! What an adjustment is worth: which numbers it determines, and how well, by how blocks of images agree.

use lsfb_geometry::{Matrix6, Se3, Vector6};

use super::adjustment::{
    Adjusted, BY_HAND, CLOCK_S, Normal, SHARED, Shared, SharedMatrix, SharedVector, total,
};

/// Share of errors of surfaces and of the odometry that is common to all blocks, so that their scatter does not show it: walls
/// are met from the same side again and again.
const COMMON: f64 = 0.3;

/// Squared normalized distance of six numbers that one in ten thousand exceeds.
const UNLIKELY: f64 = 27.86;

/// The six numbers with what they are worth.
pub(super) struct Estimate {
    /// Covariance of the camera's pose on the LiDAR, perturbed on the right, and of the clock. Of numbers held: as known by hand.
    pub covariance: SharedMatrix,
    /// By how much blocks differ more than their noise says: variances were multiplied by it.
    pub inflation: f64,
    /// Blocks that say something.
    pub blocks: usize,
    pub halves: Halves,
}

/// Two halves of a recording against each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Halves {
    pub difference: Vector6<f64>,
    /// Pose steps of either half, from the whole.
    pub steps: [SharedVector; 2],
    /// Squared distance normalized by the covariance of both: 6 is expected.
    pub square: f64,
}

impl Halves {
    pub fn disagree(&self) -> bool {
        self.square > UNLIKELY
    }
}

/// From the blocks' equations at what was found.
pub(super) fn estimate(found: &Adjusted, start: &Se3, held: &[usize]) -> Option<Estimate> {
    let (normals, shared) = (&found.normals, &found.shared);
    let (mut square, mut freedom, mut blocks) = (0.0, 0usize, 0);
    for normal in normals {
        let (own, numbers) = own_square(normal);
        square += own;
        freedom += numbers;
        blocks += usize::from(numbers > 0);
    }
    let spare = freedom.saturating_sub(SHARED - held.len()).max(1) as f64;
    let inflation = (square / spare).max(1.0);
    let mut covariance = covariance(normals, start, shared, held, inflation)?;
    for k in 0..6 {
        let common = COMMON
            * if k < 3 {
                found.noise.turn_rad
            } else {
                found.noise.plane_m
            };
        covariance[(k, k)] += common * common;
    }
    Some(Estimate {
        covariance,
        inflation,
        blocks,
        halves: halves(normals, start, shared, held, inflation)?,
    })
}

/// Covariance of what was found, given that numbers held are wrong by as much as hands measure.
fn covariance(
    normals: &[Normal],
    start: &Se3,
    shared: &Shared,
    held: &[usize],
    inflation: f64,
) -> Option<SharedMatrix> {
    let less: Vec<Normal> = normals
        .iter()
        .map(|n| Normal {
            information: n.information / inflation,
            gradient: n.gradient / inflation,
        })
        .collect();
    let all = total(&less, start, shared, &[]).information;
    // With numbers held in place the others follow them: J = −A_ff⁻¹ A_fh.
    let mut own = all;
    let mut follow = SharedMatrix::identity();
    for k in held {
        own.fill_row(*k, 0.0);
        own.fill_column(*k, 0.0);
        own[(*k, *k)] = 1.0;
    }
    let inverse = own.try_inverse()?;
    let mut out = inverse;
    for k in held {
        out[(*k, *k)] = 0.0;
        let mut by_held = -all.column(*k).into_owned();
        for other in held {
            by_held[*other] = 0.0;
        }
        let mut column: SharedVector = inverse * by_held;
        column[*k] = 1.0;
        follow.set_column(*k, &column);
    }
    for k in held {
        let sigma = BY_HAND[k / 3];
        let column = follow.column(*k).into_owned();
        out += column * column.transpose() * (sigma * sigma);
    }
    Some(0.5 * (out + out.transpose()))
}

/// A block's squared distance from what all found, and in how many numbers.
fn own_square(normal: &Normal) -> (f64, usize) {
    let scale = |k: usize| if k < 6 { BY_HAND[k / 3] } else { CLOCK_S };
    let scales = SharedVector::from_fn(|k, _| scale(k));
    let information =
        SharedMatrix::from_fn(|i, k| normal.information[(i, k)] * scales[i] * scales[k]);
    let gradient = normal.gradient.component_mul(&scales);
    let eigen = information.symmetric_eigen();
    let along = eigen.eigenvectors.transpose() * gradient;
    // Where a block knows less than was known by hand it says nothing.
    let known = || (0..SHARED).filter(|k| eigen.eigenvalues[*k] > 1.0);
    let square = known()
        .map(|k| along[k] * along[k] / eigen.eigenvalues[k])
        .sum();
    (square, known().count())
}

fn halves(
    normals: &[Normal],
    start: &Se3,
    shared: &Shared,
    held: &[usize],
    inflation: f64,
) -> Option<Halves> {
    let half = |first: usize| {
        let part: Vec<Normal> = normals.iter().skip(first).step_by(2).copied().collect();
        total(&part, start, shared, held)
    };
    let parts = [half(0), half(1)];
    let steps = [parts[0].step()?, parts[1].step()?];
    let six = |n: &Normal| -> Option<Matrix6<f64>> {
        Some(
            n.information
                .try_inverse()?
                .fixed_view::<6, 6>(0, 0)
                .into_owned(),
        )
    };
    let both = (six(&parts[0])? + six(&parts[1])?) * inflation;
    let difference: Vector6<f64> = (steps[0] - steps[1]).fixed_rows::<6>(0).into();
    let weighted = both.cholesky()?.solve(&difference);
    Some(Halves {
        difference,
        steps,
        square: difference.dot(&weighted),
    })
}
