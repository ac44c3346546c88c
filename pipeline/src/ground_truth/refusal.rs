//! Why a walk is refused, as far as it can be told: what looks like a poor map may be an IMU that is not as it says, or another place.

use std::path::Path;

use lsfb_perception::statistics::median;
use lsfb_types::{Finding, Verdict};

use super::GroundTruthConfig;
use super::accel_axes::misread_axis;
use super::imu_refinement::ImuRefinement;
use super::in_view::InView;
use super::report::LeftOutReason;
use super::start::Start;
use super::trusted::Trusted;
use super::walk::Walk;
use crate::{Error, Refusal};

/// What is known of a solved walk that may be refused.
pub(super) struct Judged<'a> {
    pub path: &'a Path,
    pub walk: &'a Walk,
    /// Frames that were looked up in the map on their own.
    pub looked_up: usize,
    pub start: &'a Start,
    pub imu: Option<&'a ImuRefinement>,
    pub trusted: &'a Trusted,
    /// What was found of the points that should be in view, in all of the walk.
    pub in_view: &'a InView,
    pub disagreements_m: &'a [f64],
}

impl Judged<'_> {
    /// Why nothing of the walk may be given, if so.
    pub fn refusal(&self, config: &GroundTruthConfig) -> Option<Error> {
        let path = || self.path.to_owned();
        let (recognised, frames) = (self.start.accepted_count, self.looked_up);
        let moved_m = || median(self.disagreements_m.to_vec()).unwrap_or(f64::INFINITY);
        let is_few = (recognised as f64) < config.min_recognised_share * frames as f64;
        let is_unchecked = is_few && !self.in_view.is_judged();
        if !is_unchecked && !self.trusted.poses.is_empty() {
            return None;
        }
        if let Some(misread) = misread_axis(self.walk) {
            return Some(misread.refusal(self.path));
        }
        let reason = self.trusted.main_reason();
        if reason == Some(LeftOutReason::MapPartsDisagree)
            && let Some(failures) = self.failed_imu()
        {
            let refusal = Refusal::ImuContradicts {
                path: path(),
                frames,
                moved_m: moved_m(),
                failures,
            };
            return Some(refusal.into());
        }
        let refusal = match reason {
            _ if is_unchecked => Refusal::FewRecognised {
                path: path(),
                recognised,
                frames,
                needed_share: config.min_recognised_share,
                moved_m: moved_m(),
                points: self.in_view.points,
                absent_percent: 100.0 * self.in_view.absent_share(),
            },
            // Of another floor parts of the map disagree as well, and that much is absent says why.
            Some(LeftOutReason::PointsAbsent | LeftOutReason::MapPartsDisagree)
                if self.in_view.is_doubtful(config) =>
            {
                self.points_absent(config)
            }
            Some(LeftOutReason::MapPartsDisagree) => Refusal::MapPartsDisagree {
                path: path(),
                frames,
                moved_m: moved_m(),
                limit_m: config.max_disagreement_m,
            },
            Some(LeftOutReason::PointsAbsent) => self.points_absent(config),
            _ => Refusal::NothingCertain {
                path: path(),
                frames,
                limit_m: config.max_position_sigma_m,
            },
        };
        Some(refusal.into())
    }

    fn points_absent(&self, config: &GroundTruthConfig) -> Refusal {
        Refusal::PointsAbsent {
            path: self.path.to_owned(),
            points: self.in_view.points,
            absent_percent: 100.0 * self.in_view.absent_share(),
            limit: config.max_absent_share,
        }
    }

    /// What is wrong with the IMU so far that the walk fails by it alone.
    fn failed_imu(&self) -> Option<Vec<Finding>> {
        let findings = self.imu?.findings().into_iter();
        let failed: Vec<Finding> = findings.filter(|f| f.verdict == Verdict::Fail).collect();
        (!failed.is_empty()).then_some(failed)
    }
}
