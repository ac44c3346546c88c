//! Which frames are certain enough for the trajectory, and why the others are not.

use std::ops::Range;

use lsfb_geometry::{Matrix6, StampedPose};

use super::GroundTruthConfig;
use super::in_view::InView;
use super::report::{LeftOutReason, Span};
use super::walk::{FrameState, Walk};
use crate::worst_sigma::worst_sigmas;

/// Largest standard deviation, in the worst direction, of an attitude that is exported, radians. With an IMU none comes near it; of images alone it leaves out what is between
/// those that see enough, where a body may have turned anyhow.
const MAX_ROTATION_SIGMA_RAD: f64 = 0.02;

/// Frames that see some points of the map for no longer than this, seconds, with none of them localized, may see them by chance.
const CHANCE_SECS: f64 = 0.2;

/// Frames of the trajectory, and what was left out of it.
pub(super) struct Trusted {
    pub poses: Vec<StampedPose>,
    /// Beside the poses: the frames of the walk.
    pub frames: Vec<usize>,
    /// Beside the poses.
    pub covariances: Vec<Matrix6<f64>>,
    /// Beside the poses: how far halves of the map's points move them, metres.
    pub disagreements_m: Vec<f64>,
    /// Poses that see too little of the map to be placed alone.
    pub bridged: usize,
    pub left_out: Vec<Span>,
}

impl Trusted {
    /// Why most of what is left out is left out.
    pub fn main_reason(&self) -> Option<LeftOutReason> {
        LeftOutReason::ALL.into_iter().max_by_key(|reason| {
            let spans = self.left_out.iter().filter(|span| span.reason == *reason);
            spans.map(|span| span.to_ns - span.from_ns + 1).sum::<i64>()
        })
    }
}

/// What the solve says about the frames.
pub(super) struct Solution<'a> {
    pub states: &'a [FrameState],
    /// Frames whose localized pose agrees with the walk.
    pub accepted: &'a [bool],
    /// Covariances of the poses; `None` where nothing determines one.
    pub covariances: &'a [Option<Matrix6<f64>>],
    /// How far halves of the map's points move each position, metres.
    pub disagreements_m: &'a [f64],
    /// What was found of the points that should be in view.
    pub in_view: &'a [InView],
}

/// Leaves out the stretches that see too little of the map for too long, and poses that are not certain enough.
pub(super) fn trusted(walk: &Walk, found: &Solution, config: &GroundTruthConfig) -> Trusted {
    let reasons = reasons(walk, found, config);
    let mut result = Trusted {
        poses: Vec::new(),
        frames: Vec::new(),
        covariances: Vec::new(),
        disagreements_m: Vec::new(),
        bridged: 0,
        left_out: Vec::new(),
    };
    for (k, frame) in walk.frames.iter().enumerate() {
        let reason = match (reasons[k], &found.covariances[k]) {
            (None, Some(covariance)) => {
                result.poses.push(StampedPose {
                    time: frame.time,
                    world_from_rig: found.states[k].nav.world_from_rig,
                });
                result.frames.push(k);
                result.covariances.push(*covariance);
                result.disagreements_m.push(found.disagreements_m[k]);
                result.bridged += usize::from(frame.fixed.len() < config.min_map_points);
                continue;
            }
            (reason, _) => reason.unwrap_or(LeftOutReason::Uncertain),
        };
        let goes_on = k > 0 && reasons[k - 1] == Some(reason);
        match result.left_out.last_mut() {
            Some(span) if goes_on => span.to_ns = frame.time.nanos(),
            _ => result
                .left_out
                .push(Span::new(frame.time, frame.time, reason)),
        }
    }
    result
}

/// For each frame why it is left out, if it is.
fn reasons(
    walk: &Walk,
    found: &Solution,
    config: &GroundTruthConfig,
) -> Vec<Option<LeftOutReason>> {
    // The IMU carries from one stretch to the next: one in which too little was to be seen is where the rest of the walk is.
    let whole = InView::of_walk(found.in_view);
    let placed = placed_by_map(walk, found.accepted, config);
    let supported = |k: usize| placed[k];
    let is_doubtful = |stretch: usize| {
        let own = &found.in_view[stretch];
        let here = with_neighbours(found.in_view, stretch, |frames| {
            longest_secs(walk, frames, |k| !supported(k)) <= config.max_bridge_secs
        });
        // Those beside it excuse what is absent from it, not that it shows another place.
        (own.is_doubtful(config) && (own.is_refuted() || here.is_doubtful(config)))
            || (!own.is_judged() && whole.is_doubtful(config))
    };
    let doubts: Vec<bool> = (0..found.in_view.len()).map(is_doubtful).collect();
    let doubtful = |k: usize| {
        let mut stretches = found.in_view.iter().zip(&doubts);
        stretches.any(|(stretch, is_doubtful)| *is_doubtful && stretch.frames.contains(&k))
    };
    let count = walk.frames.len();
    let mut reasons = Vec::with_capacity(count);
    while reasons.len() < count {
        let k = reasons.len();
        let end = (k..count)
            .find(|j| supported(*j) != supported(k))
            .unwrap_or(count);
        let secs = walk.frames[end - 1].time.secs_since(walk.frames[k].time);
        let limit = if k > 0 && end < count {
            config.max_bridge_secs
        } else {
            config.max_extrapolation_secs
        };
        let refused = |j: usize| walk.frames[j].localized.is_some() && !found.accepted[j];
        let whole = if supported(k) || secs <= limit {
            None
        } else if (k..end).any(refused) {
            Some(LeftOutReason::Contradicted)
        } else {
            Some(LeftOutReason::NotRecognised)
        };
        reasons.extend((k..end).map(|j| {
            let uncertain = !found.covariances[j].is_some_and(|c| is_certain(&c, config));
            let disputed = found.disagreements_m[j] > config.max_disagreement_m;
            // What halves of the map say makes a pose uncertain too, and says why.
            whole
                .or(disputed.then_some(LeftOutReason::MapPartsDisagree))
                .or(doubtful(j).then_some(LeftOutReason::PointsAbsent))
                .or(uncertain.then_some(LeftOutReason::Uncertain))
        }));
    }
    reasons
}

/// Whether the map places each frame: it sees enough points, by itself or with those beside it for longer than chance has it.
fn placed_by_map(walk: &Walk, accepted: &[bool], config: &GroundTruthConfig) -> Vec<bool> {
    let sees_enough = walk
        .frames
        .iter()
        .map(|f| f.fixed.len() >= config.min_map_points);
    let mut placed: Vec<bool> = sees_enough.collect();
    let mut first = 0;
    for run in placed.chunk_by_mut(|a, b| a == b) {
        let (last, next) = (first + run.len() - 1, first + run.len());
        let secs = walk.frames[last].time.secs_since(walk.frames[first].time);
        if secs <= CHANCE_SECS && !accepted[first..next].contains(&true) {
            run.fill(false);
        }
        first = next;
    }
    placed
}

/// What was found in a stretch and in those before and behind it, as far as a walk that goes on through the map joins them: of two things that are
/// absent from ten seconds of a long walk it may be said that they have gone, not that those seconds are elsewhere.
fn with_neighbours(
    stretches: &[InView],
    own: usize,
    is_joined: impl Fn(Range<usize>) -> bool,
) -> InView {
    let joined = |a: usize, b: usize| {
        let (Some(a), Some(b)) = (stretches.get(a), stretches.get(b)) else {
            return false;
        };
        is_joined(a.frames.start..b.frames.end)
    };
    let first = own - usize::from(own > 0 && joined(own - 1, own));
    let last = own + usize::from(joined(own, own + 1));
    InView::of_walk(&stretches[first..=last])
}

/// Longest time for which something holds of one of some frames after the other, seconds.
fn longest_secs(walk: &Walk, frames: Range<usize>, holds: impl Fn(usize) -> bool) -> f64 {
    let mut longest_secs = 0.0_f64;
    let mut since = None;
    for k in frames {
        if !holds(k) {
            since = None;
            continue;
        }
        let first = *since.get_or_insert(k);
        let secs = walk.frames[k].time.secs_since(walk.frames[first].time);
        longest_secs = longest_secs.max(secs);
    }
    longest_secs
}

fn is_certain(covariance: &Matrix6<f64>, config: &GroundTruthConfig) -> bool {
    let [rotation_rad, place_m] = worst_sigmas(covariance);
    rotation_rad <= MAX_ROTATION_SIGMA_RAD && place_m <= config.max_position_sigma_m
}
