//! How fast a rotor turns, by the times of its own scans.

/// Turns that are looked at before the speed is said.
const TURNS: usize = 10;
/// Sensors turn 5 to 20 times a second: other intervals are those of a clock that was set, or of scans that were cut short.
const POSSIBLE_NS: std::ops::RangeInclusive<i64> = 45_000_000..=250_000_000;
const SECOND_NS: f64 = 1e9;

/// The first turns of a rotor.
#[derive(Clone, Debug, Default)]
pub(super) struct Turns {
    last_ns: Option<i64>,
    intervals_ns: Vec<i64>,
}

impl Turns {
    /// A scan began at this time of the sensor's own.
    pub(super) fn note(&mut self, device_ns: i64) {
        let last_ns = self.last_ns.replace(device_ns);
        let interval_ns = last_ns.map(|last_ns| device_ns - last_ns);
        if let Some(interval_ns) = interval_ns.filter(|ns| POSSIBLE_NS.contains(ns))
            && self.intervals_ns.len() < TURNS
        {
            self.intervals_ns.push(interval_ns);
            self.intervals_ns.sort_unstable();
        }
    }

    /// Turns a second; `None` before enough of them. Scans may be missing, so the shorter intervals count; the shortest of all may be
    /// that of a scan that was cut short.
    pub(super) fn rate_hz(&self) -> Option<f64> {
        let is_enough = self.intervals_ns.len() == TURNS;
        let short_ns = self.intervals_ns.get(TURNS / 4).filter(|_| is_enough)?;
        Some(SECOND_NS / *short_ns as f64)
    }
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
}
