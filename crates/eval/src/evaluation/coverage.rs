//! How much of the truth an estimate speaks about.

use lsfb_geometry::StampedPose;
use lsfb_types::Timestamp;
use serde::Serialize;

use crate::association::PosePair;

/// A time without poses, and how the estimate came back from it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Relocalization {
    /// When it came back, seconds after its first pose.
    pub back_after_secs: f64,
    /// How long there was no pose, seconds.
    pub gap_secs: f64,
    /// By how much the translation error behind the gap differs from that before it, metres: what coming back cost. Absent where the
    /// truth has no pose there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error_change_m: Option<f64>,
}

/// The gaps of an estimate that are longer than `gap_secs`, in order of time. `errors_m` are those of `aligned`.
pub(super) fn relocalizations(
    estimate: &[StampedPose],
    aligned: &[PosePair],
    errors_m: &[f64],
    gap_secs: f64,
) -> Vec<Relocalization> {
    let error_at = |time: Timestamp| {
        let index = aligned.partition_point(|p| p.estimate.time < time);
        let pair = aligned.get(index).filter(|p| p.estimate.time == time);
        pair.and(errors_m.get(index)).copied()
    };
    let start = estimate
        .first()
        .map_or(Timestamp::from_nanos(0), |p| p.time);
    let neighbours = estimate.windows(2);
    let gaps = neighbours.filter(|w| w[1].time.secs_since(w[0].time) > gap_secs);
    gaps.map(|w| Relocalization {
        back_after_secs: w[1].time.secs_since(start),
        gap_secs: w[1].time.secs_since(w[0].time),
        error_change_m: error_at(w[1].time)
            .zip(error_at(w[0].time))
            .map(|(after, before)| after - before),
    })
    .collect()
}

/// How much of the truth the estimate speaks about.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// Share of the truth's poses between two neighbouring poses of the estimate, with a judged one near, 0 to 1.
    pub fraction: f64,
    /// Longest time between two neighbouring poses of the estimate, seconds.
    pub longest_gap_secs: f64,
    /// By how much the estimate begins after the truth, seconds: the time until it was initialised. Zero where it does not.
    pub initialisation_secs: f64,
    /// By how much it ends before the truth, seconds. Zero where it does not.
    pub missing_end_secs: f64,
}

/// The first item from an index on that holds.
fn first_from<T>(items: &[T], from: usize, holds: impl Fn(&T) -> bool) -> usize {
    let rest = items.get(from..).unwrap_or_default();
    from + rest.iter().take_while(|item| !holds(item)).count()
}

/// All in order of time; `pairs` are those of the two that are judged. Poses of the estimate whose stamps match no true one are judged
/// nowhere: where they alone are, nothing is known of their errors, and the truth is not covered.
pub(super) fn coverage(
    truth: &[StampedPose],
    estimate: &[StampedPose],
    pairs: &[PosePair],
    gap_secs: f64,
) -> Coverage {
    let gap = |earlier: &StampedPose, later: &StampedPose| later.time.secs_since(earlier.time);
    // The first that is not before a true pose; it only moves on.
    let mut next_judged = 0;
    let mut is_judged = |t: &StampedPose| {
        let later = |p: &PosePair| p.truth.time >= t.time;
        next_judged = first_from(pairs, next_judged, later);
        let next = next_judged;
        let around = [next.checked_sub(1), Some(next)];
        let mut around = around.into_iter().flatten().filter_map(|i| pairs.get(i));
        around.any(|p| gap(&p.truth, t).abs() <= gap_secs)
    };
    let mut next_estimated = 0;
    let covered = truth
        .iter()
        .filter(|t| {
            next_estimated = first_from(estimate, next_estimated, |e| e.time >= t.time);
            let next = next_estimated;
            match (
                next.checked_sub(1).and_then(|i| estimate.get(i)),
                estimate.get(next),
            ) {
                (_, Some(after)) if after.time == t.time => true,
                (Some(before), Some(after)) => gap(before, after) <= gap_secs,
                _ => false,
            }
        })
        .filter(|t| is_judged(t))
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
