//! What the reader of a trajectory is warned of.

use std::ops::Range;

use super::config::UNLIKELY_SIGMAS;
use super::in_view::InView;
use super::recorded_walk::RecordedWalk;
use super::report::{GroundTruthReport, GroundTruthWarning, LeftOutReason, Span};
use super::walk::Walk;
use crate::frames::FeatureFrame;

/// A walk that fits its place so many times as well as any other is unmistakable.
const UNMISTAKABLE: f64 = 2.0;

/// What of the walk lies before and after the frames that were looked at.
pub(super) fn out_of_reach(frames: &[FeatureFrame], reach: &Range<usize>) -> Vec<Span> {
    let before = frames[..reach.start]
        .first()
        .zip(frames[..reach.start].last());
    let after = frames[reach.end..].first().zip(frames[reach.end..].last());
    let both = before.into_iter().chain(after);
    both.map(|(first, last)| Span::new(first.time, last.time, LeftOutReason::NotRecognised))
        .collect()
}

/// By what was left out and what was read.
pub(super) fn warnings(
    report: &GroundTruthReport,
    recorded: &RecordedWalk,
) -> Vec<GroundTruthWarning> {
    let read = &recorded.read;
    let mut warnings = Vec::new();
    for reason in LeftOutReason::ALL {
        let spans = report.left_out.iter().filter(|s| s.reason == reason);
        let (count, ns) = spans.fold((0, 0), |(count, ns), span| {
            (count + 1, ns + span.to_ns - span.from_ns)
        });
        if count > 0 {
            warnings.push(GroundTruthWarning::LeftOut {
                reason,
                secs: ns as f64 / 1e9,
                spans: count,
            });
        }
    }
    for found in &report.cameras {
        if found.largest_sigmas > UNLIKELY_SIGMAS {
            let found = found.clone();
            warnings.push(GroundTruthWarning::CameraOff { found });
        }
    }
    let alike = report
        .other_place
        .filter(|other| other.is_possible(UNMISTAKABLE));
    warnings.extend(alike.map(|other| GroundTruthWarning::LooksAlike { other }));
    let some = |count: u64| (count > 0).then_some(count);
    let counted = [
        some(report.imu_gaps).map(|intervals| GroundTruthWarning::ImuGaps { intervals }),
        some(read.damaged).map(|images| GroundTruthWarning::DamagedImages { images }),
        some(recorded.damaged_samples)
            .map(|samples| GroundTruthWarning::DamagedSamples { samples }),
        some(recorded.repeated_samples)
            .map(|samples| GroundTruthWarning::RepeatedSamples { samples }),
        some(read.repeated_stamps).map(|images| GroundTruthWarning::RepeatedStamps { images }),
        some(recorded.frozen).map(|images| GroundTruthWarning::FrozenImages { images }),
        GroundTruthWarning::of_frozen_samples(recorded.frozen_secs),
    ];
    warnings.extend(counted.into_iter().flatten());
    warnings
}

/// Where the place could not be told from one that is built alike.
pub(super) fn not_checked(walk: &Walk, in_view: &[InView]) -> Option<GroundTruthWarning> {
    let unjudged = in_view.iter().filter(|v| !v.is_judged());
    let secs = unjudged.filter_map(|v| {
        let (first, last) = (v.frames.clone().next()?, v.frames.clone().next_back()?);
        Some(walk.frames[last].time.secs_since(walk.frames[first].time))
    });
    let secs: f64 = secs.sum();
    (secs > 0.0).then_some(GroundTruthWarning::PlaceNotChecked { secs })
}
