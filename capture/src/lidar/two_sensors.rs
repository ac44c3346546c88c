//! Two sensors that send as one: two of one model at their factory address on one network, or the captures of both in one file. Neither
//! address nor model tells them apart, and their returns would make one cloud; no single sensor sends as they do.

use lsfb_drivers::lidar::Counters;

/// Data packets that are looked at together.
const WINDOW: u64 = 100;
/// Share of them that no single sensor sends: of two, every second one. Networks and clocks that are set cost a few.
const SHARE: f64 = 0.3;

/// Looks for a second sensor in what a decoder counts.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TwoSensors {
    /// Data packets, and those that were out of turn, until the window began.
    window: [u64; 2],
    are_two: bool,
}

impl TwoSensors {
    /// Takes what a decoder has counted until now.
    pub(super) fn note(&mut self, counters: &Counters) {
        // Sooner than a sensor can, before the one before, by another clock, or of another model.
        let out_of_turn =
            counters.crowded + counters.reordered + counters.clock_jumps + counters.mode_changes;
        let now = [counters.packets + counters.reordered, out_of_turn];
        let [packets, strange] = [0, 1].map(|k| now[k].saturating_sub(self.window[k]));
        if packets >= WINDOW {
            self.are_two |= strange as f64 > SHARE * packets as f64;
            self.window = now;
        }
    }

    /// Whether there were two; from then on nobody knows whose a packet is.
    pub(super) fn are_two(&self) -> bool {
        self.are_two
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether two are found where so many of a hundred packets are out of turn, for ten seconds of them.
    fn found(crowded: u64, reordered: u64, clock_jumps: u64) -> bool {
        found_with(crowded, reordered, clock_jumps, 0)
    }

    fn found_with(crowded: u64, reordered: u64, clock_jumps: u64, mode_changes: u64) -> bool {
        let mut sensors = TwoSensors::default();
        for n in 1..=75 {
            sensors.note(&Counters {
                packets: n * (100 - reordered),
                crowded: n * crowded,
                reordered: n * reordered,
                clock_jumps: n * clock_jumps,
                mode_changes: n * mode_changes,
                ..Counters::default()
            });
        }
        sensors.are_two()
    }

    #[test]
    fn every_second_packet_out_of_turn_is_a_second_sensor_and_a_bad_network_is_none() {
        assert!(found(50, 0, 0) && found(0, 48, 2) && found(0, 0, 50));
        assert!(!found(0, 0, 0) && !found(5, 10, 1));
        // Of two models, or in two modes; a mode that is set is one change.
        assert!(found_with(0, 0, 0, 99) && !found_with(0, 0, 0, 1));
        // A clock that is set once.
        let mut sensors = TwoSensors::default();
        sensors.note(&Counters {
            packets: 50,
            clock_jumps: 2,
            ..Counters::default()
        });
        sensors.note(&Counters {
            packets: 150,
            clock_jumps: 3,
            ..Counters::default()
        });
        assert!(!sensors.are_two());
    }
}
