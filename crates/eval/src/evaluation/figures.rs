//! What is known of an estimate once the truth has spoken.

use lsfb_geometry::Trajectory;
use lsfb_types::{Finding, Timestamp, Verdict};
use serde::Serialize;

use super::coverage::{Coverage, Relocalization};
use crate::Statistics;
use crate::consistency::Consistency;
use crate::pairs::PairSelection;
use crate::read::Orientations;
use crate::recall::Recall;
use crate::relation::DeltaUnit;
use crate::smoothness::Smoothness;
use crate::success::SuccessRate;

/// Findings that leave no result where they fail.
const NO_RESULT: [&str; 2] = ["matches", "few-poses"];

/// A relative error of both parts of the pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RpeFigures {
    /// How far apart the two poses of a pair are.
    pub delta: f64,
    /// What `delta` counts.
    pub delta_unit: DeltaUnit,
    /// Which pairs were taken.
    pub selection: PairSelection,
    /// How many.
    pub pairs: usize,
    /// Pairs left out as poses between are missing; per second alone.
    pub left_out_pairs: usize,
    /// How far apart the pairs are, by the median, in `delta_unit`.
    pub median_delta: f64,
    /// The longest of them.
    pub longest_delta: f64,
    /// Pairs more than a fifth longer than `delta`.
    pub long_pairs: usize,
    /// Difference of the distances travelled, metres: needs no orientation.
    pub distance_m: Statistics,
    /// Translation in the frame of the first pose, metres; absent without orientations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub translation_m: Option<Statistics>,
    /// Rotation, degrees; absent without orientations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_deg: Option<Statistics>,
}

/// The absolute translation error after one alignment, for comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AlignedError {
    /// none, yaw, SE(3), Sim(3).
    pub alignment: &'static str,
    /// Root mean square, metres; absent where the alignment does not exist.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rmse_m: Option<f64>,
    /// Why it does not exist.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why_not: Option<String>,
}

/// Smoothness of an estimate beside that of its truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SmoothnessFigures {
    /// Of the aligned estimate; absent where it has too few poses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimate: Option<Smoothness>,
    /// Of the truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<Smoothness>,
}

/// Errors of one matched pose after alignment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Stamp of the estimate.
    pub time: Timestamp,
    /// Distance, metres.
    pub translation_m: f64,
    /// Angle, degrees; absent without orientations.
    pub rotation_deg: Option<f64>,
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
    /// Whether rotations were known and judged.
    pub orientations: Orientations,
    /// How much of the truth the estimate speaks about.
    pub coverage: Coverage,
    /// Gaps of the estimate that count as lost tracking, and what coming back from them cost.
    pub relocalizations: Vec<Relocalization>,
    /// Path of the whole truth, metres.
    pub truth_path_m: f64,
    /// Path of the whole estimate, metres of its own scale.
    pub estimate_path_m: f64,
    /// Alignment taken away: none, yaw, SE(3), Sim(3), origin, given.
    pub alignment: &'static str,
    /// `truth_from_estimate` of that alignment: rotation x y z w.
    pub alignment_rotation_xyzw: [f64; 4],
    /// `truth_from_estimate` of that alignment: translation, metres.
    pub alignment_translation_m: [f64; 3],
    /// Scale of that alignment; 1 but for Sim(3).
    pub alignment_scale: f64,
    /// By how many per cent the estimate is larger than the truth, by a Sim(3) alignment of its own; absent where the
    /// matched positions determine none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_error_percent: Option<f64>,
    /// 100 · |1 − s| with the scale s of the Sim(3) alignment, which takes the estimate to the truth: the paper's scale error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_error_abs_percent: Option<f64>,
    /// Absolute error of the translation, metres.
    pub ate_translation_m: Statistics,
    /// Absolute error of the rotation, degrees; absent without orientations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ate_rotation_deg: Option<Statistics>,
    /// The absolute translation error after each alignment there is.
    pub ate_by_alignment: Vec<AlignedError>,
    /// Relative errors, in the order of the configuration.
    pub rpe: Vec<RpeFigures>,
    /// How often the pose was found; empty without orientations.
    pub recall: Vec<Recall>,
    /// How many frames matched a map, where the estimate's file says it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub success: Option<SuccessRate>,
    /// How smooth the estimate is.
    pub smoothness: SmoothnessFigures,
    /// Whether the errors are as large as the estimate's covariance says; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub consistency: Option<Consistency>,
    /// What a reader should know of these figures.
    #[serde(skip)]
    pub findings: Vec<Finding>,
    /// Errors pose by pose, in order of time.
    #[serde(skip)]
    pub errors: Vec<PoseError>,
    /// The whole estimate in the world of the truth; of poses with one stamp the first.
    #[serde(skip)]
    pub aligned_estimate: Trajectory,
}

impl Evaluation {
    /// Why these figures are no result: too few poses are shared. They may follow from the alignment alone.
    pub fn no_result(&self) -> Option<String> {
        let reason =
            |f: &&Finding| f.verdict == Verdict::Fail && NO_RESULT.contains(&f.code.as_ref());
        self.findings.iter().find(reason).map(|f| f.what.clone())
    }
}
