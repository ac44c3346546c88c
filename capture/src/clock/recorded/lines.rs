//! A clock as lines over stretches of time that overlap: the line of a quartz bends with its temperature.

use std::ops::Range;

use lsfb_types::Timestamp;

use super::super::{ClockEstimate, StampPair, fit_pairs};
use super::ClockConfig;
use super::source::Triple;

/// Pairs whose counter advances; batches repeat none, late ones say nothing.
pub(super) fn rising(triples: &[Triple]) -> Vec<StampPair> {
    let mut last = None;
    triples
        .iter()
        .filter(|t| {
            let rises = last.is_none_or(|last| t.device_ns > last);
            if rises {
                last = Some(t.device_ns);
            }
            rises
        })
        .map(|t| StampPair {
            device_ns: t.device_ns,
            arrival: t.arrival,
        })
        .collect()
}

/// Lines of overlapping stretches, in order.
pub(super) fn windows(
    pairs: &[StampPair],
    tick_ns: u64,
    config: &ClockConfig,
) -> Vec<ClockEstimate> {
    let stretches = stretches(pairs, config).into_iter();
    stretches
        .filter_map(|range| fit_pairs(pairs.get(range).unwrap_or_default(), tick_ns))
        .collect()
}

/// Stretches of pairs that overlap by half, in order.
pub(super) fn stretches(pairs: &[StampPair], config: &ClockConfig) -> Vec<Range<usize>> {
    let window_ns = ((config.window_secs.max(1.0)) * 1e9) as i64;
    let (Some(first), Some(last)) = (pairs.first(), pairs.last()) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    let mut start = first.device_ns;
    loop {
        let end = start.saturating_add(window_ns);
        let from = pairs.partition_point(|p| p.device_ns < start);
        // A last stretch that would be short belongs to the one before.
        let is_last = last.device_ns.saturating_sub(end) < window_ns / 2;
        let to = if is_last {
            pairs.len()
        } else {
            pairs.partition_point(|p| p.device_ns < end)
        };
        found.push(from..to);
        if is_last {
            return found;
        }
        start = start.saturating_add(window_ns / 2);
        // A counter that jumped far ahead leaves nothing in between.
        if let Some(next) = pairs.get(to)
            && next.device_ns > start.saturating_add(window_ns)
        {
            start = next.device_ns;
        }
    }
}

/// Between two lines the weight goes over from one to the other.
pub(super) fn time_of(lines: &[ClockEstimate], device_ns: i64) -> Option<Timestamp> {
    let after = lines.partition_point(|line| line.reference_device_ns <= device_ns);
    let (before, next) = (
        after.checked_sub(1).and_then(|n| lines.get(n)),
        lines.get(after),
    );
    match (before, next) {
        (Some(a), Some(b)) => {
            let span = b.reference_device_ns.saturating_sub(a.reference_device_ns);
            let run = device_ns.saturating_sub(a.reference_device_ns);
            let share = run as f64 / span.max(1) as f64;
            let (early, late) = (a.time(device_ns), b.time(device_ns));
            Some(early.plus_nanos(((late - early) as f64 * share) as i64))
        }
        (Some(line), None) | (None, Some(line)) => Some(line.time(device_ns)),
        (None, None) => None,
    }
}
