//! Stretches in which too little is followed: darkness, a covered lens, a camera that is silent.

use super::{MotionConfig, TrackedWalk};

/// Each with the frames around it, which see enough, if there are any; in order of time but for those at the ends.
pub(super) fn blind_stretches(
    walk: &TrackedWalk,
    sights_in_use: &[usize],
    config: &MotionConfig,
) -> Vec<[usize; 2]> {
    let time = |k: usize| walk.frames[k].time;
    let sees_enough = |k: &usize| sights_in_use[*k] >= config.min_sights;
    let count = walk.frames.len();
    let seeing: Vec<usize> = (0..count).filter(sees_enough).collect();
    let pairs = seeing.windows(2).map(|pair| [pair[0], pair[1]]);
    // Frames that are wanted as rarely as that are no gap.
    let longest_secs = config.max_blind_secs.max(1.5 * config.frame_secs);
    let between = pairs.filter(|[a, b]| time(*b).secs_since(time(*a)) > longest_secs);
    let mut blind: Vec<[usize; 2]> = between.collect();
    match (seeing.first(), seeing.last(), count.checked_sub(1)) {
        // Before the first and after the last of these nothing holds the IMU's drift, however short.
        (Some(first), Some(last), Some(end)) => {
            blind.extend((*first > 0).then_some([0, *first]));
            blind.extend((*last < end).then_some([*last, end]));
        }
        (_, _, Some(end)) => blind.push([0, end]),
        _ => {}
    }
    blind
}
