//! The reference as ground truth of the estimate's body, without the poses at which the reference jumped.
//!
//! Two trajectories that part do not say which of them is wrong. How they part does: a marker taken for its neighbour turns the reference
//! within one frame, and turns it back within one. What parts slowly, or because the estimate jumped, is an error of the estimate, and truth that
//! were without it would flatter it.

use std::ops::Range;

use lsfb_geometry::{Se3, StampedPose};
use lsfb_types::{Finding, Verdict};

use super::HandEye;
use super::continuous::Continuous;
use super::refine::{OUTLIER, weighted_norm};

/// From one pose to the next the reference jumps where it moves so much more than the estimate, in the unit of outliers: of some thousand poses the noise of a few
/// reaches one.
const JUMP: f64 = 2.0 * OUTLIER;

/// Ground truth of the estimate's body.
#[derive(Clone, Debug, PartialEq)]
pub struct AlignedTruth {
    /// In the reference's world, on the estimate's clock.
    pub poses: Vec<StampedPose>,
    /// Poses of the reference that are not among them, as it jumped there.
    pub left_out: usize,
}

impl AlignedTruth {
    /// What was left out, where something was.
    pub fn finding(&self) -> Option<Finding> {
        let all = self.poses.len() + self.left_out;
        (self.left_out > 0).then(|| {
            let what = format!(
                "{} of the reference's {all} poses are left out of the ground truth because the reference jumps away from the estimate and back",
                self.left_out
            );
            Finding::new("left-out", Verdict::Warn, "reference", what)
                .value(self.left_out as f64, "")
                .remedy("check the markers (swapped, dropped), and that they are on one rigid body")
        })
    }
}

impl HandEye {
    /// The reference as a trajectory of the estimate's body in the reference's world, on the estimate's clock: ground truth for it. The
    /// estimate says at which poses the reference jumped; nothing else of it is in the truth.
    pub fn as_truth(&self, estimate: &[StampedPose], reference: &[StampedPose]) -> AlignedTruth {
        let Some(first) = estimate.first() else {
            return AlignedTruth {
                poses: Vec::new(),
                left_out: 0,
            };
        };
        let on_clock = |pose: &StampedPose| {
            let secs = pose.time.secs_since(first.time);
            let offset_secs =
                self.offset_secs + self.drift * (secs - self.offset_secs - self.middle_secs);
            StampedPose {
                time: pose.time.plus_secs(-offset_secs),
                world_from_rig: pose.world_from_rig * self.body,
            }
        };
        let all: Vec<StampedPose> = reference.iter().map(on_clock).collect();
        let continuous = Continuous::new(estimate, first.time);
        let estimated: Vec<Option<Se3>> = all
            .iter()
            .map(|p| Some(self.world * continuous.at(p.time.secs_since(first.time))?))
            .collect();
        let size = |of: Se3| weighted_norm(&of.log(), self.sigmas);
        let is_off = |i: usize| {
            estimated[i].is_some_and(|e| size(all[i].world_from_rig.inverse() * e) > OUTLIER)
        };
        // By how much more the reference moves than the estimate from one pose to the next.
        let jump = |from: usize, to: usize| -> f64 {
            let (Some(before), Some(after)) = (estimated[from], estimated[to]) else {
                return 0.0;
            };
            size(all[from].world_from_rig.inverse() * all[to].world_from_rig)
                - size(before.inverse() * after)
        };
        let mut jumped = vec![false; all.len()];
        for run in runs(all.len(), is_off) {
            let into = run.start.checked_sub(1).map_or(0.0, |i| jump(i, run.start));
            let out_of = match run.end < all.len() {
                true => jump(run.end - 1, run.end),
                false => 0.0,
            };
            if into.max(out_of) > JUMP {
                jumped[run].fill(true);
            }
        }
        let kept = all.iter().zip(&jumped).filter(|(_, jumped)| !**jumped);
        AlignedTruth {
            poses: kept.map(|(pose, _)| *pose).collect(),
            left_out: jumped.iter().filter(|jumped| **jumped).count(),
        }
    }
}

/// Ranges of indices for which something is so.
fn runs(count: usize, is_so: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for i in (0..count).filter(|i| is_so(*i)) {
        match runs.last_mut() {
            Some(run) if run.end == i => run.end = i + 1,
            _ => runs.push(i..i + 1),
        }
    }
    runs
}
