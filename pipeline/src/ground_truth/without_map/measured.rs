//! The longest part of a walk that its IMU measured without a long pause: where it recorded nothing, the parts on both sides have no motion
//! between them that anything tells, and each would be a walk of its own.

use std::ops::Range;

use lsfb_types::Timestamp;

use super::{MotionConfig, TrackedWalk};
use crate::ground_truth::report::{LeftOutReason, Span};
use crate::{Error, Refusal};

/// Shortest part that is a walk, seconds.
const SHORTEST_SECS: f64 = 1.0;
/// So much of a pause between two frames parts them, seconds: less is integrated over.
const PARTING_SECS: f64 = 0.05;

/// What the IMU measured of a walk.
pub(super) struct Measured {
    /// The longest part.
    pub walk: TrackedWalk,
    /// Stretches before and after it.
    pub left_out: Vec<Span>,
    /// Pauses that are too long, those before the first and after the last sample too.
    pub pauses: Vec<[Timestamp; 2]>,
}

/// [`Refusal::ImuGap`] where no part is long enough.
pub(super) fn longest_measured(
    mut walk: TrackedWalk,
    config: &MotionConfig,
) -> Result<Measured, Error> {
    let pauses = long_pauses(&walk, config.max_imu_gap_secs);
    let Some(longest) = pauses
        .iter()
        .max_by_key(|[from, to]| to.nanos() - from.nanos())
    else {
        return Ok(Measured {
            walk,
            left_out: Vec::new(),
            pauses,
        });
    };
    let time = |k: usize| walk.frames[k].time;
    let secs = |part: &Range<usize>| time(part.end - 1).secs_since(time(part.start));
    let parts = parts(&walk, &pauses);
    let part = parts
        .into_iter()
        .max_by(|a, b| secs(a).total_cmp(&secs(b)))
        .filter(|part| secs(part) >= SHORTEST_SECS);
    let Some(part) = part else {
        return Err(Refusal::ImuGap {
            from: longest[0],
            to: longest[1],
            longest_secs: config.max_imu_gap_secs,
        }
        .into());
    };
    let rests = [0..part.start, part.end..walk.frames.len()];
    let rests = rests.into_iter().filter(|rest| !rest.is_empty());
    let span = |rest: Range<usize>| {
        let (from, to) = (time(rest.start), time(rest.end - 1));
        Span::new(from, to, LeftOutReason::NotMeasured)
    };
    let left_out = rests.map(span).collect();
    walk.views.retain(|v| part.contains(&v.frame));
    for view in &mut walk.views {
        view.frame -= part.start;
    }
    walk.frames = walk.frames.drain(part).collect();
    Ok(Measured {
        walk,
        left_out,
        pauses,
    })
}

/// Pauses between the first frame and the last.
fn long_pauses(walk: &TrackedWalk, longest_secs: f64) -> Vec<[Timestamp; 2]> {
    let (Some(first), Some(last)) = (walk.frames.first(), walk.frames.last()) else {
        return Vec::new();
    };
    let (first, last) = (first.time, last.time);
    let mut edges = vec![first];
    edges.extend(walk.imu.iter().map(|s| s.time.clamp(first, last)));
    edges.push(last);
    let pairs = edges.windows(2).map(|pair| [pair[0], pair[1]]);
    pairs
        .filter(|[from, to]| to.secs_since(*from) > longest_secs)
        .collect()
}

/// Runs of frames without a pause between neighbours.
fn parts(walk: &TrackedWalk, pauses: &[[Timestamp; 2]]) -> Vec<Range<usize>> {
    let mut parts = Vec::new();
    let mut start = 0;
    for (k, pair) in walk.frames.windows(2).enumerate() {
        let parted = pauses.iter().any(|[from, to]| {
            let (from, to) = (pair[0].time.max(*from), pair[1].time.min(*to));
            to.secs_since(from) > PARTING_SECS
        });
        if parted {
            parts.push(start..k + 1);
            start = k + 1;
        }
    }
    if start < walk.frames.len() {
        parts.push(start..walk.frames.len());
    }
    parts
}
