//! How fast a rotor turns, by the times of its own scans.

use std::collections::VecDeque;

/// Turns that are looked at before the speed is said.
const TURNS: usize = 10;
/// Sensors turn 5 to 20 times a second: other intervals are those of a clock that was set, or of scans that were cut short.
const POSSIBLE_NS: std::ops::RangeInclusive<i64> = 45_000_000..=250_000_000;
const SECOND_NS: f64 = 1e9;

/// Share by which a rotor may turn at another speed than it was set to.
const TOLERANCE: f64 = 0.1;

/// The turns of a rotor: the first, and the last.
#[derive(Clone, Debug, Default)]
pub(super) struct Turns {
    last_ns: Option<i64>,
    intervals_ns: Vec<i64>,
    recent_ns: VecDeque<i64>,
}

impl Turns {
    /// A scan began at this time of the sensor's own. Whether the rotor can have turned since the one before it: where it stands or
    /// trembles, azimuths jump back with each packet, and what looks like scans lasts a few milliseconds.
    pub(super) fn note(&mut self, device_ns: i64) -> bool {
        let last_ns = self.last_ns.replace(device_ns);
        let interval_ns = last_ns.map(|last_ns| device_ns - last_ns);
        let Some(interval_ns) = interval_ns.filter(|ns| POSSIBLE_NS.contains(ns)) else {
            return interval_ns.is_none_or(|ns| !(0..*POSSIBLE_NS.start()).contains(&ns));
        };
        self.recent_ns.push_back(interval_ns);
        if self.recent_ns.len() > TURNS {
            self.recent_ns.pop_front();
        }
        if self.intervals_ns.len() < TURNS {
            self.intervals_ns.push(interval_ns);
            self.intervals_ns.sort_unstable();
        }
        true
    }

    /// Whether it turns at another speed than this lately: one that was just set takes seconds until it does.
    pub(super) fn misses(&self, set_hz: f64) -> bool {
        let mut recent_ns: Vec<i64> = self.recent_ns.iter().copied().collect();
        recent_ns.sort_unstable();
        short_hz(&recent_ns).is_some_and(|hz| (hz / set_hz - 1.0).abs() > TOLERANCE)
    }

    /// Turns a second; `None` before enough of them.
    pub(super) fn rate_hz(&self) -> Option<f64> {
        short_hz(&self.intervals_ns)
    }
}

/// Turns a second by sorted intervals; `None` where there are not enough. Scans may be missing, so the shorter ones count; the shortest
/// of all may be that of a scan that was cut short.
fn short_hz(intervals_ns: &[i64]) -> Option<f64> {
    let is_enough = intervals_ns.len() == TURNS;
    let short_ns = intervals_ns.get(TURNS / 4).filter(|_| is_enough)?;
    Some(SECOND_NS / *short_ns as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_scans_do_not_slow_the_rotor_down() {
        let mut turns = Turns::default();
        // The first revolution is cut anywhere, then every third scan is missing.
        for n in [0, 6, 10, 30, 40, 60, 70, 90, 100, 120, 130, 150, 160, 180] {
            assert_eq!(turns.rate_hz().is_some(), turns.intervals_ns.len() == TURNS);
            turns.note(n * 10_000_000);
        }
        assert!((turns.rate_hz().unwrap() - 10.0).abs() < 1e-9);
    }

    #[test]
    fn a_rotor_that_stands_does_not_turn() {
        let mut turns = Turns::default();
        assert!(turns.note(0));
        assert!(turns.note(100_000_000));
        assert!(!turns.note(101_327_000), "a packet later");
        assert!(!turns.note(102_654_000));
        assert!(turns.note(202_654_000));
        // Packets were lost, or the clock was set.
        assert!(turns.note(5_000_000_000));
        assert!(turns.note(1_000_000_000));
    }

    /// Five turns a second from the very start, where ten were asked for: their own rate says nothing of that.
    #[test]
    fn a_rotor_that_never_takes_the_speed_it_was_set_to_is_noticed() {
        let mut turns = Turns::default();
        let mut now_ns = 0;
        let mut turn = |turns: &mut Turns, interval_ns: i64, count: usize| {
            for _ in 0..count {
                now_ns += interval_ns;
                turns.note(now_ns);
            }
        };
        turn(&mut turns, 200_000_000, 8);
        assert!(!turns.misses(10.0), "too early to say");
        turn(&mut turns, 200_000_000, 4);
        assert!(turns.misses(10.0) && !turns.misses(5.0));
        // It only took its time.
        turn(&mut turns, 100_000_000, 10);
        assert!(!turns.misses(10.0));
    }
}
