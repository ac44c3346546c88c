//! Where a clock was set: exchanges bound what the host's clock is ahead of the device's, and two whose bounds exclude each other
//! are of two clocks. Steps shorter than the time on the link are not seen.

use super::Exchange;

/// Exchanges from which a line is drawn.
const FEWEST: usize = 5;
/// By how much the two clocks run apart at most: a quartz, and a host that is being disciplined.
const MOST_DRIFT: f64 = 300e-6;
/// Coarseness of stamps: browsers round theirs to a millisecond.
const COARSE_NS: i64 = 1_000_000;

/// Host time less device time, nanoseconds, lies between these at a moment of the host's clock.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    at_ns: i64,
    least_ns: i64,
    most_ns: i64,
}

impl Bounds {
    fn of(exchange: &Exchange) -> Option<Self> {
        Some(Self {
            at_ns: exchange.t2_ns,
            least_ns: exchange
                .t3_ns
                .checked_sub(exchange.t4_ns)?
                .checked_sub(COARSE_NS)?,
            most_ns: exchange
                .t2_ns
                .checked_sub(exchange.t1_ns)?
                .checked_add(COARSE_NS)?,
        })
    }

    /// What is left of these when `later` is known too; `None`: they exclude each other.
    fn and(self, later: Self) -> Option<Self> {
        let drift_ns = (later.at_ns.abs_diff(self.at_ns) as f64 * MOST_DRIFT) as i64;
        let both = Self {
            at_ns: later.at_ns,
            least_ns: later.least_ns.max(self.least_ns.saturating_sub(drift_ns)),
            most_ns: later.most_ns.min(self.most_ns.saturating_add(drift_ns)),
        };
        (both.least_ns <= both.most_ns).then_some(both)
    }
}

/// Exchanges of one clock.
struct Part {
    bounds: Bounds,
    exchanges: Vec<Exchange>,
}

impl Part {
    fn push(&mut self, bounds: Bounds, exchange: Exchange) {
        self.bounds = bounds;
        self.exchanges.push(exchange);
    }
}

/// The exchanges of each clock. A clock has begun when some exchanges in a row agree with each other and not with the clock before:
/// one whose stamps are wrong begins none.
pub(super) fn parts(exchanges: impl Iterator<Item = Exchange>) -> Vec<Vec<Exchange>> {
    let mut parts: Vec<Part> = Vec::new();
    let mut begun: Option<Part> = None;
    for exchange in exchanges {
        let Some(own) = Bounds::of(&exchange) else {
            continue;
        };
        let current = parts.last_mut();
        let with_current = current.as_ref().and_then(|part| part.bounds.and(own));
        let with_begun = begun.as_ref().and_then(|part| part.bounds.and(own));
        match (with_current, with_begun, current, begun.as_mut()) {
            // It was under way for so long that it tells nothing.
            (Some(_), Some(_), ..) => {}
            (Some(bounds), None, Some(current), _) => {
                current.push(bounds, exchange);
                begun = None;
            }
            (None, Some(bounds), _, Some(begun)) => begun.push(bounds, exchange),
            _ => {
                begun = Some(Part {
                    bounds: own,
                    exchanges: vec![exchange],
                });
            }
        }
        if begun
            .as_ref()
            .is_some_and(|part| part.exchanges.len() >= FEWEST)
        {
            parts.extend(begun.take());
        }
    }
    parts.into_iter().map(|part| part.exchanges).collect()
}
