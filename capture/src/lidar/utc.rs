//! Whether satellites hold UTC: a sensor that sends its time all the while has it from its receiver only as long as that has a fix.

use lsfb_drivers::lidar::Position;
use lsfb_types::Timestamp;

/// A sentence that is lost on the line, or damaged, is one second.
const PATIENCE_NS: i64 = 3_000_000_000;
const NO_FIX: &str = "UTC is not backed by GNSS because its receiver has no fix: PPS is only as good as the receiver's own clock";
const NEVER_A_FIX: &str = "UTC is not backed by GNSS because its receiver has no fix: its time is estimated from arrivals";
const NEVER_A_PULSE: &str =
    "UTC is not backed by GNSS (no PPS, no fix): its time is estimated from arrivals";

/// Looks for a fix in position packets.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Utc {
    /// Arrival of the last packet whose sentence named the second, and at first of the first packet.
    held: Option<Timestamp>,
    was_named: bool,
    problem: Option<&'static str>,
    stretches: u64,
}

impl Utc {
    /// Takes a position packet; without a pulse a clock that once had one is in holdover, which is said elsewhere.
    pub(super) fn note(&mut self, position: &Position, arrival: Timestamp) {
        let held = *self.held.get_or_insert(arrival);
        let before = self.problem;
        if position.sentence.is_some() {
            (self.held, self.was_named, self.problem) = (Some(arrival), true, None);
        } else if arrival - held > PATIENCE_NS {
            self.problem = match (self.was_named, position.pps_locked) {
                (true, true) => Some(NO_FIX),
                (true, false) => None,
                (false, true) => Some(NEVER_A_FIX),
                (false, false) => Some(NEVER_A_PULSE),
            };
        }
        self.stretches += u64::from(before.is_none() && self.problem.is_some());
    }

    /// What is wrong now; `None` where nothing is, or nothing is known.
    pub(super) fn problem(&self) -> Option<&'static str> {
        self.problem
    }

    /// How often its receiver was without a fix for long.
    pub(super) fn stretches(&self) -> u64 {
        self.stretches
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is said after each second of position packets: whether a pulse came, and whether a second was named.
    fn said(seconds: &[(bool, bool)]) -> (Vec<Option<&'static str>>, u64) {
        let mut utc = Utc::default();
        let mut said = Vec::new();
        for (second, (pps_locked, is_named)) in (0_i64..).zip(seconds) {
            for tenth in 0..10 {
                let arrival = Timestamp::from_nanos(second * 1_000_000_000 + tenth * 100_000_000);
                let position = Position {
                    toh_ns: arrival.nanos(),
                    pps_locked: *pps_locked,
                    sentence: is_named.then_some(arrival),
                    temperature_celsius: None,
                };
                utc.note(&position, arrival);
            }
            said.push(utc.problem());
        }
        (said, utc.stretches())
    }

    #[test]
    fn a_pulse_alone_is_not_utc() {
        let (found, stretches) = said(&[(true, false); 6]);
        assert_eq!(found[1..3], [None; 2]);
        assert_eq!((found[5], stretches), (Some(NEVER_A_FIX), 1));
        let (found, _) = said(&[(false, false); 6]);
        assert_eq!(found[5], Some(NEVER_A_PULSE));
    }

    #[test]
    fn a_fix_that_goes_is_missed_and_a_sentence_that_is_lost_is_not() {
        let held = [(true, true); 3];
        let lost = [(true, false); 5];
        let (found, stretches) =
            said(&[&held[..], &lost, &held, &[(true, false); 2], &held].concat());
        assert_eq!(found[7], Some(NO_FIX));
        assert!(found[8..].iter().all(Option::is_none), "{found:?}");
        assert_eq!(stretches, 1);
        // Without its pulse it is in holdover, which is said elsewhere.
        let (found, stretches) = said(&[&held[..], &[(false, false); 5]].concat());
        assert_eq!((found[7], stretches), (None, 0));
    }
}
