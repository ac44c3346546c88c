//! How much of the truth an estimate speaks about.

use lsfb_geometry::StampedPose;
use serde::Serialize;

/// How much of the truth the estimate speaks about.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// Share of the truth's poses between two neighbouring poses of the estimate, 0 to 1.
    pub fraction: f64,
    /// Longest time between two neighbouring poses of the estimate, seconds.
    pub longest_gap_secs: f64,
    /// By how much the estimate begins after the truth, seconds: the time until it was initialised. Zero where it does not.
    pub initialisation_secs: f64,
    /// By how much it ends before the truth, seconds. Zero where it does not.
    pub missing_end_secs: f64,
}

/// Both in order of time.
pub(super) fn coverage(truth: &[StampedPose], estimate: &[StampedPose], gap_secs: f64) -> Coverage {
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
    let later = |a: Option<&StampedPose>, b: Option<&StampedPose>| match (a, b) {
        (Some(a), Some(b)) => gap(a, b).max(0.0),
        _ => 0.0,
    };
    Coverage {
        fraction: covered as f64 / truth.len().max(1) as f64,
        longest_gap_secs: estimate
            .windows(2)
            .map(|w| gap(&w[0], &w[1]))
            .fold(0.0, f64::max),
        initialisation_secs: later(truth.first(), estimate.first()),
        missing_end_secs: later(estimate.last(), truth.last()),
    }
}
