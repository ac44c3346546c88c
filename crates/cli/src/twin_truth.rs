//! Estimates from simulated recordings judged by the truth that lies beside them, through `eval`.

use std::path::Path;

use lsfb_eval::alignment::AlignmentMode;
use lsfb_eval::pairs::PairSelection;
use lsfb_eval::relation::DeltaUnit;
use lsfb_eval::{
    Consistency, DuplicateStamps, EvalConfig, Evaluation, ReadOptions, RpeConfig, evaluate,
    evaluate_files, read_poses, read_trajectory,
};
use lsfb_geometry::{Quaternion, Se3, StampedPose, UnitQuaternion};

/// Length of way over which drift is measured, metres.
pub const DRIFT_OVER_M: f64 = 10.0;

/// The scanner's trajectory, judged.
pub struct JudgedScan {
    pub evaluation: Evaluation,
    pub truth: Vec<StampedPose>,
    /// Truth's world from the map's.
    pub truth_from_map: Se3,
}

/// A walk's trajectory, judged.
pub struct JudgedWalk {
    /// After an alignment of its own.
    pub own: Evaluation,
    /// Placed by the map alone, the map placed by the scanner.
    pub in_map: Evaluation,
    pub truth: Vec<StampedPose>,
}

fn config(alignment: AlignmentMode) -> EvalConfig {
    EvalConfig {
        alignment,
        duplicates: DuplicateStamps::Refuse,
        // A walk on the spot has no ten metres.
        rpe: Vec::new(),
        rpe_where_possible: vec![RpeConfig {
            delta: DRIFT_OVER_M,
            unit: DeltaUnit::Metres,
            selection: PairSelection::All,
        }],
        ..EvalConfig::default()
    }
}

/// Judges the trajectory of a scan.
pub fn judge_scan(truth: &Path, estimate: &Path) -> anyhow::Result<JudgedScan> {
    let truth = read_poses(truth)?;
    let evaluation = evaluate(&truth, &read_poses(estimate)?, &config(AlignmentMode::Se3))?;
    let [x, y, z, w] = evaluation.alignment_rotation_xyzw;
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    let truth_from_map = Se3::new(rotation, evaluation.alignment_translation_m.into());
    Ok(JudgedScan {
        evaluation,
        truth,
        truth_from_map,
    })
}

/// Judges the trajectory of a walk in the map of a scan.
pub fn judge_walk(
    truth: &Path,
    estimate: &Path,
    truth_from_map: Se3,
) -> anyhow::Result<JudgedWalk> {
    let (truth, poses) = (read_poses(truth)?, read_poses(estimate)?);
    let with = |alignment| evaluate(&truth, &poses, &config(alignment));
    Ok(JudgedWalk {
        own: with(AlignmentMode::Se3)?,
        in_map: with(AlignmentMode::Given(truth_from_map))?,
        truth,
    })
}

/// Whether the covariances of a walk's poses are as large as their errors where the map places them; `covariances` is the file of poses with
/// covariance. `None` where none of them is one.
pub fn consistency_in_map(
    truth: &Path,
    covariances: &Path,
    truth_from_map: Se3,
) -> anyhow::Result<Option<Consistency>> {
    let read = |path| read_trajectory(path, &ReadOptions::default());
    let config = config(AlignmentMode::Given(truth_from_map));
    Ok(evaluate_files(&read(truth)?, &read(covariances)?, &config)?.consistency)
}

/// Error of positions after an alignment of their own, rms, metres; `None` where they are too few for one.
pub fn ate_rms_m(truth: &[StampedPose], estimate: &[StampedPose]) -> Option<f64> {
    let found = evaluate(truth, estimate, &config(AlignmentMode::Se3)).ok()?;
    Some(found.ate_translation_m.rmse)
}
