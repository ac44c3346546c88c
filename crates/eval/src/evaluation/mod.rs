use lsfb_geometry::align::Alignment;
use lsfb_geometry::{StampedPose, Trajectory};
use lsfb_types::Timestamp;
use serde::Serialize;

use crate::alignment::{AlignmentMode, align, apply};
use crate::association::{PosePair, associate};
use crate::metrics::{RelativeSpec, absolute_errors, relative_errors};
use crate::pairs::PairSelection;
use crate::relation::{DeltaUnit, PoseRelation};
use crate::{Error, Statistics};

/// What becomes of poses that share one stamp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DuplicateStamps {
    /// Each counts, as evo has it; [`Evaluation::duplicate_stamps`] says how many there were.
    #[default]
    Keep,
    /// They are an error.
    Refuse,
}

/// One relative error to compute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RpeConfig {
    /// How far apart the two poses of a pair are.
    pub delta: f64,
    /// What `delta` counts.
    pub unit: DeltaUnit,
    /// Which pairs are taken.
    pub selection: PairSelection,
}

/// How a trajectory is judged.
#[derive(Clone, Debug, PartialEq)]
pub struct EvalConfig {
    /// Largest difference of two stamps that belong together, seconds.
    pub max_difference_secs: f64,
    /// What is taken away before errors are measured.
    pub alignment: AlignmentMode,
    /// Poses that share one stamp.
    pub duplicates: DuplicateStamps,
    /// The relative errors wanted.
    pub rpe: Vec<RpeConfig>,
    /// Neighbouring poses of the estimate further apart than this leave the truth between them uncovered, seconds.
    pub coverage_gap_secs: f64,
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self {
            max_difference_secs: 0.01,
            alignment: AlignmentMode::Se3,
            duplicates: DuplicateStamps::Keep,
            rpe: vec![RpeConfig {
                delta: 1.0,
                unit: DeltaUnit::Metres,
                selection: PairSelection::Consecutive,
            }],
            coverage_gap_secs: 1.0,
        }
    }
}

/// How much of the truth the estimate speaks about.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// Share of the truth's poses between two neighbouring poses of the estimate, 0 to 1.
    pub fraction: f64,
    /// Longest time between two neighbouring poses of the estimate, seconds.
    pub longest_gap_secs: f64,
}

/// A relative error of both parts of the pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RpeFigures {
    /// How far apart the two poses of a pair are.
    pub delta: f64,
    /// What `delta` counts.
    pub delta_unit: DeltaUnit,
    /// Which pairs were taken.
    pub selection: PairSelection,
    /// Translation, metres.
    pub translation_m: Statistics,
    /// Rotation, degrees.
    pub rotation_deg: Statistics,
}

/// Errors of one matched pose after alignment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Stamp of the estimate.
    pub time: Timestamp,
    /// Distance, metres.
    pub translation_m: f64,
    /// Angle, degrees.
    pub rotation_deg: f64,
}

/// What is known of an estimate once the truth has spoken. Serialized, it is the object of `lsfb eval --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Poses of the truth.
    pub truth_poses: usize,
    /// Poses of the estimate.
    pub estimate_poses: usize,
    /// Pairs that count.
    pub matched_poses: usize,
    /// Poses of either that repeat the stamp before them.
    pub duplicate_stamps: usize,
    /// How much of the truth the estimate speaks about.
    pub coverage: Coverage,
    /// Path of the whole truth, metres.
    pub truth_path_m: f64,
    /// Path of the whole estimate, metres of its own scale.
    pub estimate_path_m: f64,
    /// Alignment taken away: none, SE(3), Sim(3), origin, given.
    pub alignment: &'static str,
    /// `truth_from_estimate` of that alignment: rotation x y z w.
    pub alignment_rotation_xyzw: [f64; 4],
    /// `truth_from_estimate` of that alignment: translation, metres.
    pub alignment_translation_m: [f64; 3],
    /// Scale of that alignment; 1 but for Sim(3).
    pub alignment_scale: f64,
    /// By how many per cent the estimate is larger than the truth, by a Sim(3) alignment of its own; absent where the
    /// matched positions determine none.
    pub scale_error_percent: Option<f64>,
    /// Absolute error of the translation, metres.
    pub ate_translation_m: Statistics,
    /// Absolute error of the rotation, degrees.
    pub ate_rotation_deg: Statistics,
    /// Relative errors, in the order of the configuration.
    pub rpe: Vec<RpeFigures>,
    /// Errors pose by pose, in order of time.
    #[serde(skip)]
    pub errors: Vec<PoseError>,
    /// The whole estimate in the world of the truth; of poses with one stamp the first.
    #[serde(skip)]
    pub aligned_estimate: Trajectory,
}

/// Judges `estimate` by `truth`. Both must be in order of time.
pub fn evaluate(
    truth: &[StampedPose],
    estimate: &[StampedPose],
    config: &EvalConfig,
) -> Result<Evaluation, Error> {
    let duplicate_stamps =
        check(truth, "truth", config.duplicates)? + check(estimate, "estimate", config.duplicates)?;
    let pairs = associate(truth, estimate, config.max_difference_secs)?;
    let alignment = align(&pairs, config.alignment)?;
    let aligned = aligned_pairs(&pairs, &alignment);
    let translation = absolute_errors(&aligned, PoseRelation::TranslationPart)?;
    let rotation = absolute_errors(&aligned, PoseRelation::RotationAngleDeg)?;
    let rpe = config
        .rpe
        .iter()
        .map(|&spec| relative_figures(&aligned, spec))
        .collect::<Result<_, _>>()?;
    let quaternion = alignment.target_from_source.rotation.into_inner().coords;
    Ok(Evaluation {
        truth_poses: truth.len(),
        estimate_poses: estimate.len(),
        matched_poses: pairs.len(),
        duplicate_stamps,
        coverage: coverage(truth, estimate, config.coverage_gap_secs),
        truth_path_m: path_m(truth),
        estimate_path_m: path_m(estimate),
        alignment: config.alignment.label(),
        alignment_rotation_xyzw: quaternion.into(),
        alignment_translation_m: alignment.target_from_source.translation.into(),
        alignment_scale: alignment.scale,
        scale_error_percent: scale_error_percent(&pairs),
        ate_translation_m: statistics(&translation)?,
        ate_rotation_deg: statistics(&rotation)?,
        rpe,
        errors: aligned
            .iter()
            .zip(translation.iter().zip(&rotation))
            .map(|(pair, (&translation_m, &rotation_deg))| PoseError {
                time: pair.estimate.time,
                translation_m,
                rotation_deg,
            })
            .collect(),
        aligned_estimate: Trajectory::new(estimate.iter().map(|p| moved(p, &alignment)).collect()),
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

fn relative_figures(aligned: &[PosePair], spec: RpeConfig) -> Result<RpeFigures, Error> {
    let errors = |relation| {
        let spec = RelativeSpec {
            relation,
            delta: spec.delta,
            unit: spec.unit,
            selection: spec.selection,
        };
        statistics(&relative_errors(aligned, spec)?)
    };
    Ok(RpeFigures {
        delta: spec.delta,
        delta_unit: spec.unit,
        selection: spec.selection,
        translation_m: errors(PoseRelation::TranslationPart)?,
        rotation_deg: errors(PoseRelation::RotationAngleDeg)?,
    })
}

fn statistics(errors: &[f64]) -> Result<Statistics, Error> {
    Statistics::of(errors).ok_or(Error::TooFewMatches {
        matched: 0,
        needed: 1,
        purpose: "statistics",
    })
}

fn scale_error_percent(pairs: &[PosePair]) -> Option<f64> {
    let scale = align(pairs, AlignmentMode::Sim3).ok()?.scale;
    (scale > 0.0).then(|| 100.0 * (1.0 / scale - 1.0))
}

fn path_m(poses: &[StampedPose]) -> f64 {
    poses
        .windows(2)
        .map(|w| (w[1].world_from_rig.translation - w[0].world_from_rig.translation).norm())
        .sum()
}

fn coverage(truth: &[StampedPose], estimate: &[StampedPose], gap_secs: f64) -> Coverage {
    let gap = |earlier: &StampedPose, later: &StampedPose| later.time.secs_since(earlier.time);
    let covered = truth
        .iter()
        .filter(|t| {
            let next = estimate.partition_point(|e| e.time < t.time);
            match (
                next.checked_sub(1).and_then(|i| estimate.get(i)),
                estimate.get(next),
            ) {
                (_, Some(after)) if after.time == t.time => true,
                (Some(before), Some(after)) => gap(before, after) <= gap_secs,
                _ => false,
            }
        })
        .count();
    Coverage {
        fraction: covered as f64 / truth.len().max(1) as f64,
        longest_gap_secs: estimate
            .windows(2)
            .map(|w| gap(&w[0], &w[1]))
            .fold(0.0, f64::max),
    }
}

/// Number of poses that repeat the stamp before them.
fn check(
    poses: &[StampedPose],
    role: &'static str,
    duplicates: DuplicateStamps,
) -> Result<usize, Error> {
    if poses.is_empty() {
        return Err(Error::Empty { role });
    }
    let not_finite = poses.iter().position(|p| {
        let pose = &p.world_from_rig;
        !pose.translation.iter().all(|v| v.is_finite())
            || !pose.rotation.coords.iter().all(|v| v.is_finite())
    });
    if let Some(index) = not_finite {
        return Err(Error::NotFinite {
            role,
            index,
            time_secs: poses[index].time.to_string(),
        });
    }
    if let Some(index) = poses.windows(2).position(|w| w[1].time < w[0].time) {
        return Err(Error::Reordered {
            role,
            index: index + 1,
            time_secs: poses[index + 1].time.to_string(),
        });
    }
    let mut repeated = poses.windows(2).filter(|w| w[0].time == w[1].time);
    match (repeated.next(), duplicates) {
        (None, _) => Ok(0),
        (Some(_), DuplicateStamps::Keep) => Ok(1 + repeated.count()),
        (Some(first), DuplicateStamps::Refuse) => Err(Error::Duplicated {
            role,
            count: 1 + repeated.count(),
            time_secs: first[0].time.to_string(),
        }),
    }
}

#[cfg(test)]
mod tests;
