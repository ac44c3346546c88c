//! Poses in order of time, and what was wrong with their order.

use std::path::Path;

use lsfb_geometry::{Matrix6, Se3, StampedPose};
use lsfb_types::{Finding, Timestamp, Verdict};

use super::{Orientations, TrajectoryFile};
use crate::Error;

/// Two poses of one stamp that are further apart than this are two answers.
const ONE_PLACE_M: f64 = 1e-6;
/// Second answers that lie farther apart than this, metres, and are a larger share of all poses, make the file no trajectory.
const OTHER_M: f64 = 0.01;
const MOST_OTHER: f64 = 0.1;

/// A pose as it stands in the file.
#[derive(Clone, Debug)]
pub(super) struct Unordered {
    pub time: Timestamp,
    pub world_from_rig: Se3,
    /// Boxed: most files have none, and a row is then a fifth of the size.
    pub covariance: Option<Box<Matrix6<f64>>>,
}

/// Sorts, and counts what had to be: stamps that go back, and stamps that occur twice.
pub(super) fn put_in_order(
    path: &Path,
    mut poses: Vec<Unordered>,
    orientations: Orientations,
    mut findings: Vec<Finding>,
) -> Result<TrajectoryFile, Error> {
    let subject = super::name(path);
    let back = poses.windows(2).filter(|w| w[1].time < w[0].time);
    let back: Vec<f64> = back.map(|w| w[0].time.secs_since(w[1].time)).collect();
    if !back.is_empty() {
        let most_secs = back.iter().copied().fold(0.0, f64::max);
        let times = crate::count(back.len(), "time", "times");
        let what = format!("stamps go back {times}, by up to {most_secs:.3} s; poses were sorted");
        findings.push(
            Finding::new("unsorted-stamps", Verdict::Warn, &subject, what)
                .value(back.len() as f64, "")
                .remedy("check that these are not several runs in one file"),
        );
        poses.sort_by_key(|p| p.time);
    }
    let repeated: Vec<f64> = poses
        .windows(2)
        .filter(|w| w[0].time == w[1].time)
        .map(|w| (w[0].world_from_rig.translation - w[1].world_from_rig.translation).norm())
        .collect();
    let differing = repeated.iter().filter(|m| **m > ONE_PLACE_M).count();
    if 2 * differing > poses.len() {
        return Err(Error::CoarseStamps {
            path: path.to_owned(),
            poses: poses.len(),
            distinct: poses.len() - repeated.len(),
        });
    }
    if !repeated.is_empty() {
        let lines = crate::count(repeated.len(), "pose repeats", "poses repeat");
        let apart_m = repeated.iter().copied().fold(0.0, f64::max);
        let what = match differing {
            0 => format!("{lines} the previous stamp, at the same position"),
            n => format!(
                "{lines} the previous stamp, {n} of them at another position (up to {apart_m:.3} m): which is right is unknown, and not all of them are evaluated"
            ),
        };
        // Of few the rest is still a result.
        let is_other = differing as f64 > MOST_OTHER * poses.len() as f64 && apart_m > OTHER_M;
        let verdict = if is_other {
            Verdict::Fail
        } else {
            Verdict::Warn
        };
        findings.push(
            Finding::new("duplicate-stamps", verdict, &subject, what)
                .value(repeated.len() as f64, "")
                .remedy("keep one pose per stamp"),
        );
    }
    let covariances: Vec<Matrix6<f64>> = poses
        .iter()
        .filter_map(|p| p.covariance.as_deref().copied())
        .collect();
    if !covariances.is_empty() && covariances.len() < poses.len() {
        let without = poses.len() - covariances.len();
        let what = format!(
            "{without} of {} poses have no covariance: covariances are not used",
            poses.len()
        );
        findings.push(Finding::new("covariance", Verdict::Warn, &subject, what));
    }
    let is_complete = covariances.len() == poses.len();
    Ok(TrajectoryFile {
        poses: poses
            .iter()
            .map(|p| StampedPose {
                time: p.time,
                world_from_rig: p.world_from_rig,
            })
            .collect(),
        orientations,
        covariances: if is_complete { covariances } else { Vec::new() },
        success: None,
        findings,
    })
}
