//! Poses that are none: held where the walk went on, filled in, or far beside the others.

use lsfb_types::{Finding, Limit, Verdict};

use crate::association::PosePair;

/// Poses at exactly one place stand still, or for nothing, where the truth's lie farther apart, metres.
const MOVED_M: f64 = 0.05;
/// So many of them, and such a share, are no chance.
const LEAST_HELD: usize = 20;
const HELD_SHARE: f64 = 0.01;
/// Share of the poses that may be beside all others.
const OUTLIERS: f64 = 0.05;
/// What is left of the error without them, where they are named.
const LESS: f64 = 0.5;

/// Poses that repeat a place exactly while the truth moves: a system that was lost and went on writing, a lower rate filled up, zeros where
/// there was no pose.
pub(super) fn held(pairs: &[PosePair]) -> Option<Finding> {
    let place = |p: &PosePair| {
        let at = p.estimate.world_from_rig.translation;
        [at.x, at.y, at.z].map(|v| (v + 0.0).to_bits())
    };
    let mut sorted: Vec<([u64; 3], usize)> = pairs
        .iter()
        .enumerate()
        .map(|(i, pair)| (place(pair), i))
        .collect();
    sorted.sort_unstable();
    let truth = |i: usize| pairs.get(i).map(|p| p.truth.world_from_rig.translation);
    let moved_m = |group: &[([u64; 3], usize)]| {
        let first = group.first().and_then(|(_, i)| truth(*i));
        let apart = group
            .iter()
            .filter_map(|(_, i)| Some((truth(*i)? - first?).norm()));
        apart.fold(0.0, f64::max)
    };
    let held: Vec<(usize, f64, usize)> = sorted
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|group| group.len() > 1)
        .map(|group| (group.len(), moved_m(group), group[0].1))
        .filter(|(_, moved_m, _)| *moved_m > MOVED_M)
        .collect();
    let count: usize = held.iter().map(|(poses, _, _)| poses).sum();
    let share = count as f64 / pairs.len().max(1) as f64;
    let (most, moved_m, first) = held.into_iter().max_by_key(|(poses, _, _)| *poses)?;
    let at = pairs.get(first)?.estimate.world_from_rig.translation;
    (count >= LEAST_HELD && share > HELD_SHARE).then(|| {
        let [x, y, z]: [f64; 3] = at.into();
        let what = format!(
            "{count} of {} poses are exactly equal to another although the truth moved: {most} at ({x:.3}, {y:.3}, {z:.3}), while it moved by up to {moved_m:.2} m",
            pairs.len()
        );
        Finding::new("held", Verdict::Warn, "positions", what)
            .value(100.0 * share, "%")
            .limit(Limit::AtMost(100.0 * HELD_SHARE))
            .remedy("leave out poses that the system does not know: held or filled-in poses count as errors, and as covered")
    })
}

/// A few poses that make most of the error. Errors are those after alignment, beside the pairs.
pub(super) fn outliers(pairs: &[PosePair], errors_m: &[f64]) -> Option<Finding> {
    let mut order: Vec<usize> = (0..errors_m.len().min(pairs.len())).collect();
    order.sort_by(|a, b| errors_m[*b].total_cmp(&errors_m[*a]));
    let most = (OUTLIERS * order.len() as f64).floor() as usize;
    let square = |i: &usize| errors_m[*i].powi(2);
    let mut left: f64 = order.iter().skip(most).map(square).sum();
    // Errors, rms, without the worst one, two and so on, the most first.
    let mut without: Vec<f64> = (0..most)
        .rev()
        .map(|count| {
            let rms = (left / (order.len() - count - 1).max(1) as f64).sqrt();
            left += square(&order[count]);
            rms
        })
        .collect();
    without.reverse();
    let all_m = (left / order.len().max(1) as f64).sqrt();
    // As few as do it.
    let found = without.iter().position(|rest_m| *rest_m < LESS * all_m)?;
    let (count, rest_m) = (found + 1, without[found]);
    let worst = pairs.get(order[0])?;
    let what = format!(
        "{} most of the error: without {} it is {rest_m:.4} m rms instead of {all_m:.4} m; the worst is off by {:.3} m at {} s",
        match count {
            1 => "one pose makes".to_owned(),
            count => format!("{count} of {} poses make", order.len()),
        },
        if count == 1 { "it" } else { "them" },
        errors_m[order[0]],
        worst.estimate.time
    );
    Some(
        Finding::new("outliers", Verdict::Warn, "positions", what)
            .value(count as f64, "")
            .remedy("look at these poses: the mean error describes neither them nor the others; the median does"),
    )
}
