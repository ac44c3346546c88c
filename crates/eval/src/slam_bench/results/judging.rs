//! What a run left behind, read and judged.

use std::path::Path;

use super::RunResult;
use crate::alignment::AlignmentMode;
use crate::slam_bench::plan::Plan;
use crate::{
    Error, EvalConfig, Evaluation, ReadOptions, TrajectoryFile, evaluate_files, read_trajectory,
};

/// The trajectory of a run that lies in `folder`.
pub(in crate::slam_bench) fn read_estimate(
    folder: &Path,
    run: &RunResult,
) -> Result<TrajectoryFile, Error> {
    let path = folder.join(&run.trajectory);
    let options = ReadOptions {
        times: run.times.as_ref().map(|times| folder.join(times)),
        ..ReadOptions::default()
    };
    read_trajectory(&path, &options)
}

/// As the table has it.
pub(in crate::slam_bench) fn judge(
    plan: &Plan,
    truth: &TrajectoryFile,
    estimate: &TrajectoryFile,
    alignment: AlignmentMode,
) -> Result<Evaluation, Error> {
    let config = EvalConfig {
        max_difference_secs: plan.max_difference_secs,
        alignment,
        rpe: Vec::new(),
        ..EvalConfig::default()
    };
    evaluate_files(truth, estimate, &config)
}
