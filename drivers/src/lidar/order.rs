//! What the time between two packets of one sensor says.

use lsfb_types::Timestamp;

use super::scan_builder::HOUR_NS;

/// UDP on one network reorders within milliseconds; a larger step back is a clock that was set.
pub(crate) const LATE_NS: i64 = 100_000_000;
/// Packets in a row that come late: from then on it was the one before them whose time is wrong.
pub(crate) const MOST_LATE: u32 = 8;
/// A device clock and a host clock that disagree by more between two packets: one of them was set.
const CLOCK_JUMP_NS: i64 = 500_000_000;

/// When a packet was sent, and when it came.
#[derive(Clone, Copy, Debug)]
pub struct Instants {
    /// Past the sensor's hour, nanoseconds.
    pub toh_ns: i64,
    /// On the host's clock.
    pub arrival: Timestamp,
}

impl Instants {
    /// Whether the sensor's clock was set, or began anew, before it sent `next`.
    pub fn is_set_before(self, next: Self) -> bool {
        matches!(step(self, next), Step::ClockJump)
    }
}

/// What the time between two packets says.
pub(crate) enum Step {
    Next { elapsed_ns: i64 },
    Duplicate,
    Late,
    ClockJump,
}

/// Whether a sensor that fills a packet in `period_ns` cannot have sent the next one so soon. One whose clock stands says nothing.
pub(crate) fn is_crowded(elapsed_ns: i64, period_ns: i64) -> bool {
    elapsed_ns > 0 && 4 * elapsed_ns < 3 * period_ns
}

/// From one packet to the one that arrived after it.
pub(crate) fn step(from: Instants, to: Instants) -> Step {
    let elapsed_ns = elapsed_ns(from.toh_ns, to.toh_ns);
    let disagreement = (elapsed_ns - (to.arrival - from.arrival)).abs();
    if elapsed_ns == 0 {
        Step::Duplicate
    } else if (-LATE_NS..0).contains(&elapsed_ns) {
        Step::Late
    } else if elapsed_ns < 0 || (elapsed_ns > CLOCK_JUMP_NS && disagreement > CLOCK_JUMP_NS) {
        Step::ClockJump
    } else {
        Step::Next { elapsed_ns }
    }
}

/// How far a counter that wraps with the hour went from `from_ns` to `to_ns`: at most half an hour either way.
pub(crate) fn elapsed_ns(from_ns: i64, to_ns: i64) -> i64 {
    (to_ns - from_ns + HOUR_NS / 2).rem_euclid(HOUR_NS) - HOUR_NS / 2
}
