//! An estimate judged by the truth.

mod config;
mod conventions;
mod coverage;
mod figures;
mod input;
mod odd_poses;
mod relative;
mod remarks;

use lsfb_geometry::align::Alignment;
use lsfb_geometry::{Matrix6, StampedPose, Trajectory, path_length_m};

use crate::alignment::{AlignmentMode, align, apply};
use crate::association::{PosePair, associate};
use crate::consistency::consistency;
use crate::metrics::absolute_errors;
use crate::read::{Orientations, TrajectoryFile};
use crate::recall::recall;
use crate::relation::PoseRelation;
use crate::smoothness::smoothness;
use crate::{Error, Statistics};

pub use config::{DuplicateStamps, EvalConfig};
pub use coverage::{Coverage, Relocalization};
pub use figures::{AlignedError, Evaluation, PoseError, RpeFigures, SmoothnessFigures};

use coverage::{coverage, relocalizations};
use input::{check, check_pairs};
use relative::relative_figures;

/// Judges `estimate` by `truth`. Both must be in order of time.
pub fn evaluate(
    truth: &[StampedPose],
    estimate: &[StampedPose],
    config: &EvalConfig,
) -> Result<Evaluation, Error> {
    let mut found = judge(truth, estimate, &[], config)?;
    let repeated = remarks::duplicates(found.duplicate_stamps);
    found.findings.extend(repeated);
    Ok(found)
}

/// The same for files as they were read: with their findings, without rotations where one has none, and with the estimate's
/// covariances.
pub fn evaluate_files(
    truth: &TrajectoryFile,
    estimate: &TrajectoryFile,
    config: &EvalConfig,
) -> Result<Evaluation, Error> {
    let both = [
        truth.orientations,
        estimate.orientations,
        config.orientations,
    ];
    let config = EvalConfig {
        orientations: match both.contains(&Orientations::Missing) {
            true => Orientations::Missing,
            false => Orientations::Known,
        },
        ..config.clone()
    };
    let covariances = match config.orientations {
        Orientations::Known => estimate.covariances.as_slice(),
        Orientations::Missing => &[],
    };
    let mut found = judge(&truth.poses, &estimate.poses, covariances, &config)?;
    found.success = estimate.success;
    let of_files = truth.findings.iter().chain(&estimate.findings);
    found.findings.splice(0..0, of_files.cloned());
    let by_number = remarks::rows_by_number(truth, estimate);
    found.findings.extend(by_number);
    Ok(found)
}

/// `covariances` stand beside the poses of the estimate, or are none.
fn judge(
    truth: &[StampedPose],
    estimate: &[StampedPose],
    covariances: &[Matrix6<f64>],
    config: &EvalConfig,
) -> Result<Evaluation, Error> {
    config.check_bounds("")?;
    let duplicate_stamps =
        check(truth, "truth", config.duplicates)? + check(estimate, "estimate", config.duplicates)?;
    let pairs = associate(truth, estimate, config.max_difference_secs)?;
    check_pairs(&pairs)?;
    let has_rotations = config.orientations == Orientations::Known;
    if !has_rotations && config.alignment == AlignmentMode::Origin {
        return Err(Error::NeedsOrientation {
            purpose: "alignments to the origin",
        });
    }
    let alignment = align(&pairs, config.alignment)?;
    let aligned = aligned_pairs(&pairs, &alignment);
    let translation = absolute_errors(&aligned, PoseRelation::TranslationPart)?;
    let rotation = match has_rotations {
        true => absolute_errors(&aligned, PoseRelation::RotationAngleDeg)?,
        false => vec![0.0; translation.len()],
    };
    let mut findings = Vec::new();
    let mut rpe = Vec::new();
    for &spec in &config.rpe {
        rpe.push(relative_figures(&aligned, spec, config.orientations)?);
    }
    for &spec in &config.rpe_where_possible {
        match relative_figures(&aligned, spec, config.orientations) {
            Ok(figures) => rpe.push(figures),
            Err(why @ Error::NoPairs { .. }) => findings.push(remarks::left_out(&why)),
            Err(error) => return Err(error),
        }
    }
    let coverage = coverage(truth, estimate, &pairs, config.coverage_gap_secs);
    let scale = sim3_scale(&pairs);
    let each_error = || translation.iter().copied().zip(rotation.iter().copied());
    let thresholds = config.recall.iter().filter(|_| has_rotations);
    let aligned_estimate: Vec<StampedPose> =
        estimate.iter().map(|p| moved(p, &alignment)).collect();
    let of_pairs = covariances_of(&pairs, estimate, covariances);
    let consistency = consistency(&aligned, &of_pairs, config.alignment, alignment.scale);
    if consistency.is_none() && !of_pairs.is_empty() {
        findings.push(remarks::no_covariance(of_pairs.len()));
    }
    let found = Evaluation {
        truth_poses: truth.len(),
        estimate_poses: estimate.len(),
        matched_poses: pairs.len(),
        duplicate_stamps,
        orientations: config.orientations,
        coverage,
        relocalizations: relocalizations(
            estimate,
            &aligned,
            &translation,
            config.coverage_gap_secs,
        ),
        truth_path_m: path_length_m(truth),
        estimate_path_m: path_length_m(estimate),
        alignment: config.alignment.label(),
        alignment_rotation_xyzw: alignment
            .target_from_source
            .rotation
            .into_inner()
            .coords
            .into(),
        alignment_translation_m: alignment.target_from_source.translation.into(),
        alignment_scale: alignment.scale,
        scale_error_percent: scale.map(|s| 100.0 * (1.0 / s - 1.0)),
        scale_error_abs_percent: scale.map(|s| 100.0 * (1.0 - s).abs()),
        ate_translation_m: statistics(&translation)?,
        ate_rotation_deg: has_rotations.then(|| statistics(&rotation)).transpose()?,
        ate_by_alignment: by_alignment(&pairs),
        rpe,
        recall: thresholds
            .map(|threshold| recall(each_error(), *threshold, coverage.fraction))
            .collect(),
        success: None,
        smoothness: SmoothnessFigures {
            estimate: smoothness(&aligned_estimate),
            truth: smoothness(truth),
        },
        consistency,
        findings,
        errors: aligned
            .iter()
            .zip(each_error())
            .map(|(pair, (translation_m, rotation_deg))| PoseError {
                time: pair.estimate.time,
                translation_m,
                rotation_deg: has_rotations.then_some(rotation_deg),
            })
            .collect(),
        aligned_estimate: Trajectory::new(aligned_estimate),
    };
    let more = remarks::of(&found, &pairs, &aligned, config.alignment.parameters());
    Ok(Evaluation {
        findings: [found.findings, more].concat(),
        ..found
    })
}

fn moved(pose: &StampedPose, alignment: &Alignment) -> StampedPose {
    StampedPose {
        time: pose.time,
        world_from_rig: apply(alignment, &pose.world_from_rig),
    }
}

fn aligned_pairs(pairs: &[PosePair], alignment: &Alignment) -> Vec<PosePair> {
    pairs
        .iter()
        .map(|pair| PosePair {
            truth: pair.truth,
            estimate: moved(&pair.estimate, alignment),
        })
        .collect()
}

/// The covariance of each pair's estimate; none where there are none.
fn covariances_of(
    pairs: &[PosePair],
    estimate: &[StampedPose],
    covariances: &[Matrix6<f64>],
) -> Vec<Matrix6<f64>> {
    let of = |pair: &PosePair| {
        let first = estimate.partition_point(|p| p.time < pair.estimate.time);
        let same = estimate
            .get(first..)?
            .iter()
            .position(|p| *p == pair.estimate)?;
        covariances.get(first + same).copied()
    };
    pairs.iter().filter_map(of).collect()
}

fn by_alignment(pairs: &[PosePair]) -> Vec<AlignedError> {
    use AlignmentMode::{None, Se3, Sim3, Yaw};
    let error = |mode: AlignmentMode| -> Result<f64, Error> {
        let alignment = align(pairs, mode)?;
        let square = |pair: &PosePair| {
            let found = alignment.apply(&pair.estimate.world_from_rig.translation);
            (found - pair.truth.world_from_rig.translation).norm_squared()
        };
        let sum: f64 = pairs.iter().map(square).sum();
        Ok((sum / pairs.len().max(1) as f64).sqrt())
    };
    let modes = [None, Yaw, Se3, Sim3].into_iter();
    modes
        .map(|mode| {
            let found = error(mode);
            AlignedError {
                alignment: mode.label(),
                rmse_m: found.as_ref().ok().copied(),
                why_not: found.err().map(|why| why.to_string()),
            }
        })
        .collect()
}

fn statistics(errors: &[f64]) -> Result<Statistics, Error> {
    Statistics::of(errors).ok_or(Error::TooFewMatches {
        matched: 0,
        needed: 1,
        purpose: "statistics",
    })
}

fn sim3_scale(pairs: &[PosePair]) -> Option<f64> {
    let scale = align(pairs, AlignmentMode::Sim3).ok()?.scale;
    (scale > 0.0).then_some(scale)
}

#[cfg(test)]
mod tests;
