//! Relative errors, and whether their pairs are as far apart as they are named by.

use lsfb_geometry::StampedPose;
use lsfb_types::{Finding, Limit, Verdict, median};

use super::{RpeFigures, statistics};
use crate::Error;
use crate::association::PosePair;
use crate::metrics::{RelativeSpec, errors_of};
use crate::pairs::{CONSECUTIVE_TOLERANCE, RpeConfig, select};
use crate::read::Orientations;
use crate::relation::{DeltaUnit, PoseRelation};

/// A pair so many times as long as the delta lies across missing poses.
const MOST_LONGER: f64 = 2.0;

pub(super) fn relative_figures(
    aligned: &[PosePair],
    spec: RpeConfig,
    orientations: Orientations,
) -> Result<RpeFigures, Error> {
    if orientations == Orientations::Missing
        && matches!(spec.unit, DeltaUnit::Degrees | DeltaUnit::Radians)
    {
        return Err(Error::NeedsOrientation {
            purpose: "relative errors per angle",
        });
    }
    let estimates: Vec<StampedPose> = aligned.iter().map(|p| p.estimate).collect();
    let selected = select(&estimates, spec.delta, spec.unit, spec.selection)?;
    let errors = |relation| {
        let spec = RelativeSpec {
            relation,
            delta: spec.delta,
            unit: spec.unit,
            selection: spec.selection,
        };
        statistics(&errors_of(aligned, &selected.pairs, spec)?)
    };
    let with_rotations = |relation| match orientations {
        Orientations::Known => errors(relation).map(Some),
        Orientations::Missing => Ok(None),
    };
    // A pair of the longest allowed delta is no long one for the last bit of a sum.
    let most = spec.delta * (1.0 + CONSECUTIVE_TOLERANCE) * (1.0 + 1e-9);
    Ok(RpeFigures {
        delta: spec.delta,
        delta_unit: spec.unit,
        selection: spec.selection,
        pairs: selected.pairs.len(),
        left_out_pairs: selected.left_out,
        median_delta: median(selected.deltas.clone()).unwrap_or(spec.delta),
        longest_delta: selected.deltas.iter().copied().fold(0.0, f64::max),
        long_pairs: selected.deltas.iter().filter(|d| **d > most).count(),
        distance_m: errors(PoseRelation::PointDistance)?,
        translation_m: with_rotations(PoseRelation::TranslationPart)?,
        rotation_deg: with_rotations(PoseRelation::RotationAngleDeg)?,
    })
}

/// Pairs of a relative error that are of another delta than it is named by, or were left out for that.
pub(super) fn deltas(rpe: &RpeFigures) -> Option<Finding> {
    let unit = rpe.delta_unit;
    let per = format!("relative error per {} {unit}", rpe.delta);
    if rpe.left_out_pairs > 0 {
        let all = rpe.pairs + rpe.left_out_pairs;
        let what = format!(
            "{} of {all} pairs are left out because poses are missing: the next one is more than {:.0} % beyond the delta",
            rpe.left_out_pairs,
            100.0 * CONSECUTIVE_TOLERANCE
        );
        return Some(
            Finding::new("rpe-pairs", Verdict::Warn, per, what)
                .value(rpe.left_out_pairs as f64, "")
                .remedy("compare it only with estimates that have the same gaps, or evaluate every frame"),
        );
    }
    let most = rpe.delta * (1.0 + CONSECUTIVE_TOLERANCE);
    let is_long = rpe.median_delta > most || rpe.longest_delta > MOST_LONGER * rpe.delta;
    (is_long && rpe.long_pairs > 0).then(|| {
        let what = format!(
            "{} of {} pairs are more than {:.0} % longer than the delta: {:.3} {unit} median, {:.3} {unit} at most",
            rpe.long_pairs,
            rpe.pairs,
            100.0 * CONSECUTIVE_TOLERANCE,
            rpe.median_delta,
            rpe.longest_delta
        );
        Finding::new("rpe-pairs", Verdict::Warn, per, what)
            .value(rpe.median_delta, unit.symbol())
            .limit(Limit::AtMost(most))
            .remedy("use pairs of the requested length (--rpe-all-pairs), or a delta that is large compared with the steps between poses")
    })
}
