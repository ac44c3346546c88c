//! What the reader of a trajectory should know, as every command and page says it.

use lsfb_types::{Finding, Limit, Verdict};

use super::config::{BENDING_SIGMAS, UNLIKELY_SIGMAS};
use super::imu_refinement::ImuRefinement;
use super::map_agreement::MapAgreement;
use super::report::{
    CameraRefinement, GroundTruthReport, GroundTruthWarning, LeftOutReason, Together,
};

/// Standard deviations of a pose by its own walk, in the worst direction, beyond which the others contradict it.
const CONTRADICTED_SIGMAS: f64 = 3.0;

/// Of the share of points that may be absent so much is usual where the place is as it was mapped; what is more is said.
const USUAL_OF_ABSENT: f64 = 0.75;

impl GroundTruthWarning {
    /// Whether something that was recorded could not be read.
    pub fn loses_data(&self) -> bool {
        matches!(
            self,
            Self::DamagedImages { .. } | Self::DamagedSamples { .. }
        )
    }

    /// Of samples that were not used because a sensor repeated itself, seconds.
    pub(super) fn of_frozen_samples(secs: f64) -> Option<Self> {
        (secs > 0.0).then_some(Self::FrozenSamples { secs })
    }

    /// As every command and page says it.
    pub fn finding(&self) -> Finding {
        let warn = |code: &'static str, subject: &str, what: String| {
            Finding::new(code, Verdict::Warn, subject, what)
        };
        // There should be nothing of it.
        let unwanted = |code, subject, value: f64, unit, what: String| {
            let finding = warn(code, subject, what).value(value, unit);
            finding.limit(Limit::AtMost(0.0))
        };
        match self {
            Self::LeftOut {
                reason,
                secs,
                spans,
            } => {
                let (what, remedy) = reason.words();
                let spans = match spans {
                    1 => "1 stretch".to_owned(),
                    count => format!("{count} stretches"),
                };
                let what = format!("{secs:.1} s of the walk are left out in {spans}: {what}");
                warn(reason.code(), "trajectory", what)
                    .value(*secs, "s")
                    .limit(Limit::AtMost(0.0))
                    .remedy(remedy)
            }
            Self::CameraOff { found } => found.off(BENDING_SIGMAS),
            Self::WithoutImu { in_rig } => warn(
                "without-imu",
                "IMU",
                format!(
                    "the recording has no IMU samples{}: the poses come from images alone; lengths \
                     and the vertical are the map's and are not checked, and there is no pose where \
                     too little of the map is in view",
                    if *in_rig { ", although the rig file has an IMU" } else { "" }
                ),
            )
            .remedy("record the IMU together with the images"),
            Self::ImuGaps { intervals } => unwanted(
                "imu-gaps",
                "IMU",
                *intervals as f64,
                "",
                format!("samples are missing in {intervals} of the intervals between frames"),
            )
            .remedy("record the IMU without gaps"),
            Self::ImuPause {
                after_secs,
                secs,
                longest_secs,
            } => warn(
                "imu-pause",
                "IMU",
                format!(
                    "no samples from {after_secs:.2} s to {:.2} s after the first image: the parts before and after cannot be joined",
                    after_secs + secs
                ),
            )
            .value(*secs, "s")
            .limit(Limit::AtMost(*longest_secs))
            .remedy("record the IMU without gaps"),
            Self::DamagedImages { images } => unwanted(
                "damaged-images",
                "images",
                *images as f64,
                "",
                format!("{images} are damaged and were skipped"),
            ),
            Self::DamagedSamples { samples } => unwanted(
                "damaged-samples",
                "IMU",
                *samples as f64,
                "",
                format!("{samples} are damaged or have the stamp of another sample, and were skipped"),
            ),
            Self::RepeatedSamples { samples } => unwanted(
                "repeated-samples",
                "IMU",
                *samples as f64,
                "",
                format!("{samples} are duplicates, stamp and all, of another sample; each was used once"),
            )
            .remedy("check what recorded it: messages were stored twice"),
            Self::RepeatedStamps { images } => unwanted(
                "repeated-stamps",
                "images",
                *images as f64,
                "",
                format!("{images} have the stamp of another image of their camera and were not used"),
            )
            .remedy("stamp every image when it is taken"),
            Self::FrozenImages { images } => unwanted(
                "frozen-images",
                "images",
                *images as f64,
                "",
                format!("{images} are duplicates of the previous image although the device moved, and were not used"),
            )
            .remedy("check the camera and its driver"),
            Self::FrozenSamples { secs } => unwanted(
                "frozen-samples",
                "IMU",
                *secs,
                "s",
                format!("for {secs:.1} s a sensor repeats one reading although the device moved; these samples were not used"),
            )
            .remedy("check the IMU and its driver"),
            Self::PlaceNotChecked { secs } => unwanted(
                "place-not-checked",
                "trajectory",
                *secs,
                "s",
                format!(
                    "for {secs:.1} s too few map points were mapped from near the walk to \
                     distinguish this place from another built alike"
                ),
            )
            .remedy("walk where the scanner went, or make sure that no other place looks like it"),
            Self::LooksAlike { other } => warn(
                "looks-alike",
                "trajectory",
                format!(
                    "{} map points are found where the walk is, and {} if all of it were {:.1} m away and rotated by {:.0}°, where the map looks much the same",
                    other.matches_here, other.matches_there, other.away_m, other.turn_deg
                ),
            )
            .remedy("make sure that it is this place, or extend the walk to a place that is unique"),
            Self::FoundElsewhere {
                away_m,
                turn_deg,
                absent_share,
            } => warn(
                "found-elsewhere",
                "trajectory",
                format!(
                    "most of its images were recognised {away_m:.1} m away and rotated by \
                     {turn_deg:.0}°, but {:.0} % of the map points that should be in view there are \
                     absent; here they are present",
                    1e2 * absent_share
                ),
            )
            .value(1e2 * absent_share, "%")
            .remedy("make sure that it is this place; the map has two places that look alike"),
            Self::NotAtRest {
                rounds,
                changing,
                moved_m,
                turned_deg,
            } => warn(
                "not-at-rest",
                "poses",
                format!(
                    "did not converge within {rounds} iterations: another would change {changing} \
                     observations; the last one moved poses by up to {:.1} mm and {turned_deg:.2}°",
                    1e3 * moved_m
                ),
            )
            .value(1e3 * *moved_m, "mm")
            .remedy("check the calibration of the device, and whether the map still matches this place"),
            Self::FailedMap { what } => warn(
                "failed-map",
                "map",
                format!("it failed its checks when it was made, and was used because of accept_failed_map: {what}"),
            )
            .remedy("fix that and map the place again"),
        }
    }
}

fn norm(values: &[f64; 3]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

impl LeftOutReason {
    /// Its name, as that of the finding about it.
    pub fn code(self) -> &'static str {
        match self {
            Self::NotRecognised => "not-recognised",
            Self::Uncertain => "uncertain",
            Self::Contradicted => "contradicted",
            Self::MapPartsDisagree => "map-parts-disagree",
            Self::PointsAbsent => "points-absent",
            Self::NotFollowed => "not-followed",
            Self::NotMeasured => "not-measured",
        }
    }

    /// What is wrong, and what to do.
    fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::NotRecognised => (
                "too little of the map was recognised in their images",
                "map what can be seen there as well",
            ),
            Self::Uncertain => (
                "their poses are too uncertain (max_position_sigma_m, or an attitude above 1.1°)",
                "walk where more of the map is in view, or raise the limit",
            ),
            Self::Contradicted => (
                "their images were localized at poses that contradict the IMU and the rest of the walk",
                "check whether the map still matches this place",
            ),
            Self::MapPartsDisagree => (
                "their poses move when half of the map's points are withheld (max_disagreement_m)",
                "map the place again with more views of it, or walk where more of the map is in view",
            ),
            Self::PointsAbsent => (
                "too many map points that should be in view are absent (max_absent_share): the place \
                 has changed, or it is another place built alike",
                "map it again, or raise the limit if no other place looks like it",
            ),
            Self::NotFollowed => (
                "too few features could be tracked in their images (min_sights)",
                "light the place, keep the lenses free, and look at objects with texture",
            ),
            Self::NotMeasured => (
                "the IMU recorded nothing in between, so that they cannot be joined to the longest part of the walk (max_imu_gap_secs)",
                "record the IMU without gaps",
            ),
        }
    }
}

impl CameraRefinement {
    /// What was found of it, where that is as the rig file says.
    pub(super) fn finding(&self) -> Finding {
        let what = format!(
            "focal length {:+.3} ± {:.3} %, clock {:+.2} ± {:.2} ms, readout {:.2} ± {:.2} ms",
            self.focal_share * 1e2,
            self.focal_sigma * 1e2,
            self.clock_s * 1e3,
            self.clock_sigma_s * 1e3,
            self.readout_s * 1e3,
            self.readout_sigma_s * 1e3,
        );
        Finding::new("camera", Verdict::Pass, &self.camera, what)
    }

    /// What was found of one that is not as the rig file says: beyond so many standard deviations of that the motion is bent by it.
    pub(super) fn off(&self, bending_sigmas: f64) -> Finding {
        let what = format!(
            "it is {:.1} standard deviations off the rig file (rotation {:.2}°, translation {:.1} mm, focal length {:+.2} %, clock {:+.1} ms)",
            self.largest_sigmas,
            norm(&self.turn_deg),
            norm(&self.shift_m) * 1e3,
            self.focal_share * 1e2,
            self.clock_s * 1e3,
        );
        let (verdict, limit) = match self.largest_sigmas > bending_sigmas {
            true => (Verdict::Fail, bending_sigmas),
            false => (Verdict::Warn, UNLIKELY_SIGMAS),
        };
        Finding::new("camera-off", verdict, &self.camera, what)
            .value(self.largest_sigmas, "")
            .limit(Limit::AtMost(limit))
            .remedy("calibrate this camera again")
    }
}

impl Together {
    pub(super) fn finding(&self) -> Finding {
        let Self {
            others,
            map_points,
            common_points,
            moved_m,
            moved_sigmas,
        } = self;
        let walks = match others {
            1 => "another walk".to_owned(),
            count => format!("{count} other walks"),
        };
        let found = |verdict, what| Finding::new("together", verdict, "trajectory", what);
        if map_points + common_points == 0 {
            let what = format!(
                "it has nothing in common with {walks}: the result is the same as solving it alone"
            );
            return found(Verdict::Warn, what)
                .remedy("solve walks together that pass the same places");
        }
        let limit = Limit::AtMost(CONTRADICTED_SIGMAS);
        let what = format!(
            "{map_points} map points and {common_points} others that {walks} also saw moved poses by up to {:.1} mm",
            moved_m * 1e3
        );
        found(Verdict::Warn, what)
            .judged(*moved_sigmas, "σ", limit)
            .remedy("the walks contradict each other: solve each alone, and look at its findings")
    }
}

impl GroundTruthReport {
    /// Whether nothing is left out: every message was read, every frame has a pose.
    pub fn is_whole(&self) -> bool {
        self.left_out.is_empty() && !self.warnings.iter().any(GroundTruthWarning::loses_data)
    }

    /// Share of the images that a camera sent once more.
    pub(super) fn frozen_share(&self) -> f64 {
        let frozen = self.warnings.iter().find_map(|warning| match warning {
            GroundTruthWarning::FrozenImages { images } => Some(*images),
            _ => None,
        });
        let all = self.frames * self.cameras.len() as u64;
        frozen.unwrap_or(0) as f64 / all.max(1) as f64
    }

    /// Everything that was looked at, good or not.
    pub fn findings(&self) -> Vec<Finding> {
        let share = 100.0 * self.poses as f64 / self.frames.max(1) as f64;
        let whole = Verdict::Warn.unless(self.left_out.is_empty());
        let coverage = format!("{} of {} frames have a pose", self.poses, self.frames);
        let largest_m = self.largest_disagreement_m;
        let agreement = format!(
            "halves of the map's points move positions by at most {:.1} cm",
            largest_m * 1e2
        );
        let absent = 100.0 * self.absent_share;
        let in_view = format!(
            "{} map points that should be in view were searched for, and {absent:.1} % of the \
             evidence says that they are absent; a place that looks the same at all of them could \
             not be distinguished from this one",
            self.points_in_view
        );
        let mut findings = vec![
            Finding::new("coverage", whole, "trajectory", coverage)
                .value(share, "%")
                .limit(Limit::AtLeast(100.0)),
            Finding::new("cross-check", Verdict::Pass, "trajectory", agreement)
                .value(largest_m * 1e2, "cm")
                .limit(Limit::AtMost(self.max_disagreement_m * 1e2)),
            match self.place_checked {
                false => Finding::new("points-in-view", Verdict::Unknown, "trajectory", in_view),
                true => {
                    let usual = Limit::AtMost(100.0 * USUAL_OF_ABSENT * self.max_absent_share);
                    Finding::new("points-in-view", Verdict::Warn, "trajectory", in_view)
                        .judged(absent, "%", usual)
                        .remedy("make sure that no other place looks like it, or map it again")
                }
            },
        ];
        findings.extend(self.imu.iter().flat_map(ImuRefinement::findings));
        let frozen_share = self.frozen_share();
        let of_map = |map: &MapAgreement| map.findings(frozen_share);
        findings.extend(self.map.iter().flat_map(of_map));
        findings.extend(self.together.iter().map(Together::finding));
        findings.extend(self.cameras.iter().map(CameraRefinement::finding));
        findings.extend(self.warnings.iter().map(GroundTruthWarning::finding));
        findings
    }
}
