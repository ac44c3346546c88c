//! The error of one pose, and of one step between two.

use lsfb_geometry::{Matrix3, Se3, StampedPose, so3};

use crate::Error;
use crate::association::PosePair;
use crate::pairs::{IndexPair, PairSelection, select};
use crate::relation::{DeltaUnit, PoseRelation};

/// Absolute pose errors of aligned pairs, one per pair (ATE).
pub fn absolute_errors(pairs: &[PosePair], relation: PoseRelation) -> Result<Vec<f64>, Error> {
    if relation == PoseRelation::PointDistanceErrorRatio {
        return Err(Error::RelativeOnly { relation });
    }
    Ok(pairs
        .iter()
        .map(|pair| {
            let (truth, estimate) = (&pair.truth.world_from_rig, &pair.estimate.world_from_rig);
            match relation {
                PoseRelation::TranslationPart | PoseRelation::PointDistance => {
                    (estimate.translation - truth.translation).norm()
                }
                _ => magnitude(&(estimate.inverse() * *truth), relation),
            }
        })
        .collect())
}

/// What a relative error compares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativeSpec {
    /// Which part of the error counts.
    pub relation: PoseRelation,
    /// How far apart the two poses of a pair are.
    pub delta: f64,
    /// What `delta` counts.
    pub unit: DeltaUnit,
    /// Which pairs are taken.
    pub selection: PairSelection,
}

/// Errors of the motion between two poses `delta` apart along the estimate (RPE); aligned or not makes no difference but
/// for the scale. Pairs that truly did not move have no `PointDistanceErrorRatio` and are left out of it.
pub fn relative_errors(pairs: &[PosePair], spec: RelativeSpec) -> Result<Vec<f64>, Error> {
    let estimates: Vec<StampedPose> = pairs.iter().map(|p| p.estimate).collect();
    let selected = select(&estimates, spec.delta, spec.unit, spec.selection)?;
    errors_of(pairs, &selected.pairs, spec)
}

/// The same of pairs that were selected before.
pub(crate) fn errors_of(
    pairs: &[PosePair],
    selected: &[IndexPair],
    spec: RelativeSpec,
) -> Result<Vec<f64>, Error> {
    let errors: Vec<f64> = selected
        .iter()
        .filter_map(|&indices| relative_error(pairs, indices, spec.relation))
        .collect();
    if errors.is_empty() {
        return Err(Error::NoPairs {
            poses: pairs.len(),
            delta: spec.delta,
            unit: spec.unit,
        });
    }
    Ok(errors)
}

fn relative_error(pairs: &[PosePair], indices: IndexPair, relation: PoseRelation) -> Option<f64> {
    let (from, to) = (pairs.get(indices.from)?, pairs.get(indices.to)?);
    let distance = |a: &Se3, b: &Se3| (a.translation - b.translation).norm();
    let (truth_from, truth_to) = (from.truth.world_from_rig, to.truth.world_from_rig);
    let (estimate_from, estimate_to) = (from.estimate.world_from_rig, to.estimate.world_from_rig);
    let true_m = distance(&truth_from, &truth_to);
    let off_m = (true_m - distance(&estimate_from, &estimate_to)).abs();
    match relation {
        PoseRelation::PointDistance => Some(off_m),
        PoseRelation::PointDistanceErrorRatio => (true_m > 0.0).then(|| 100.0 * off_m / true_m),
        _ => {
            let truth_step = truth_from.inverse() * truth_to;
            let estimate_step = estimate_from.inverse() * estimate_to;
            Some(magnitude(&(truth_step.inverse() * estimate_step), relation))
        }
    }
}

/// Size of an error transform; distances are no matter of one transform and count as its translation.
fn magnitude(error: &Se3, relation: PoseRelation) -> f64 {
    let off_identity = || (error.rotation_matrix() - Matrix3::identity()).norm_squared();
    match relation {
        PoseRelation::RotationPart => off_identity().sqrt(),
        PoseRelation::FullTransformation => {
            (off_identity() + error.translation.norm_squared()).sqrt()
        }
        PoseRelation::RotationAngleRad => so3::log(&error.rotation).norm(),
        PoseRelation::RotationAngleDeg => so3::log(&error.rotation).norm().to_degrees(),
        PoseRelation::TranslationPart
        | PoseRelation::PointDistance
        | PoseRelation::PointDistanceErrorRatio => error.translation.norm(),
    }
}
