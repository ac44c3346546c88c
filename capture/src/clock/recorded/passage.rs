//! Whether a recording was made in real time: elsewhere arrivals say nothing about clocks.

use lsfb_types::median;

use super::source::Triple;

/// Parts of a recording that are compared at most, at least a second each, and how many are needed.
const MOST_PARTS: usize = 16;
const LEAST_PARTS: usize = 3;
/// What the least delay of a part differs by from that of the part before, at most: seconds, and as a share of the time between.
const SAME_DELAY_SECS: f64 = 0.03;
const SAME_DELAY_SHARE: f64 = 0.003;

/// How time passed on a counter and at its arrivals.
pub(super) struct Passage {
    pub(super) is_real_time: bool,
    /// Seconds of the counter per second of arrivals, in the middle one of the parts.
    pub(super) factor: f64,
}

/// In real time the least delay of each part of a recording is that of the part before but for the few in which a clock was set;
/// a replay has hardly two alike. `None` where the recording is too short to tell.
pub(super) fn passage(triples: &[Triple]) -> Option<Passage> {
    let (first, last) = (triples.first()?, triples.last()?);
    let since = |t: &Triple| {
        let counted_ns = t.device_ns.saturating_sub(first.device_ns);
        (
            counted_ns as f64 * 1e-9,
            t.arrival.secs_since(first.arrival),
        )
    };
    let (counted_secs, arrived_secs) = since(last);
    let parts = (counted_secs.max(arrived_secs) as usize).min(MOST_PARTS);
    if parts < LEAST_PARTS || triples.len() < 2 * parts {
        return None;
    }
    let (mut least_delays, mut factors) = (Vec::new(), Vec::new());
    for part in triples.chunks(triples.len() / parts) {
        let delays = part
            .iter()
            .map(since)
            .map(|(counted, arrived)| arrived - counted);
        let (from, to) = (since(part.first()?), since(part.last()?));
        least_delays.push((from.1, delays.fold(f64::INFINITY, f64::min)));
        factors.push((to.0 - from.0) / (to.1 - from.1).max(1e-9));
    }
    let differ = |pair: &&[(f64, f64)]| {
        let tolerance_secs = SAME_DELAY_SECS + SAME_DELAY_SHARE * (pair[1].0 - pair[0].0);
        (pair[1].1 - pair[0].1).abs() > tolerance_secs
    };
    let different = least_delays.windows(2).filter(differ).count();
    Some(Passage {
        is_real_time: 3 * different <= 2 * (least_delays.len() - 1),
        factor: median(factors)?,
    })
}
