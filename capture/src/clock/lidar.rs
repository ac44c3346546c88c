//! The clock of a LiDAR that says in packets beside its data whether it follows a pulse.

use lsfb_drivers::lidar::Instants;
use lsfb_types::Timestamp;

use super::{ClockEstimate, HOUR_NS, OneWayClock, Unwrap, nearest_hour};

/// A sensor sends some hundred position packets a second. Without any for so long it is not known whether a pulse still comes.
const PATIENCE_NS: i64 = 3_000_000_000;

/// What one position packet says about the sensor's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PositionFix {
    /// Time past the hour, nanoseconds.
    pub toh_ns: i64,
    /// Whether the sensor's second follows the pulse.
    pub pps_locked: bool,
    /// UTC of the sentence, where it is valid. It belongs to an earlier second than the packet.
    pub sentence: Option<Timestamp>,
}

/// The clock of a LiDAR: time past the hour, microseconds.
///
/// A lock holds for the counter on which it was found. A counter that jumps (its pulse came and set it; the sensor was restarted) is
/// another, and so is that of position packets which are ahead of the data: they are believed when the data follow.
#[derive(Clone, Debug, Default)]
pub struct LidarClock {
    /// Absolute time of the last locked position packet.
    locked: Option<Timestamp>,
    /// The last time that was told since then: in which hour the counter is, however long ago the pulse was lost.
    told: Option<Timestamp>,
    /// Position packets said that the sensor runs free.
    free: bool,
    /// The pulse, or what says so, is gone since the last locked position packet.
    holdover: bool,
    lock_losses: u64,
    /// The last data packet.
    counter: Option<Instants>,
    /// The last locked position packet, where its counter is not that of the data yet, and its second.
    awaited: Option<(Instants, Timestamp)>,
    /// Epochs of the clock until a lock was ended by a jump.
    epochs_before: u32,
    unwrap: Unwrap,
    one_way: OneWayClock,
}

impl LidarClock {
    /// Takes a position packet, and says its time where it is known by the sensor alone.
    pub fn fix(&mut self, fix: &PositionFix, arrival: Timestamp) -> Option<Timestamp> {
        let now = Instants {
            toh_ns: fix.toh_ns,
            arrival,
        };
        if self.counter.is_some_and(|data| data.is_set_before(now)) {
            self.fix_of_another_counter(fix, now);
            return None;
        }
        self.awaited = None;
        match (fix.pps_locked, fix.sentence, self.locked) {
            (true, Some(sentence), _) => self.lock(nearest_hour(fix.toh_ns, sentence)),
            // Still locked, but this sentence did not come through: go on from the last one.
            (true, None, Some(last)) => {
                self.lock(nearest_hour(fix.toh_ns, self.told.unwrap_or(last)));
            }
            // The second that was locked goes on by the sensor's own quartz.
            (false, _, Some(_)) => self.hold_over(),
            _ => self.free = true,
        }
        self.locked?;
        Some(self.time(fix.toh_ns, arrival))
    }

    /// The sensor was restarted or set, and data that say so are still on their way.
    fn fix_of_another_counter(&mut self, fix: &PositionFix, now: Instants) {
        let named = fix.sentence.filter(|_| fix.pps_locked);
        self.awaited = named.map(|sentence| (now, nearest_hour(fix.toh_ns, sentence)));
        match self.locked {
            Some(_) if !fix.pps_locked => self.hold_over(),
            Some(_) => {}
            None => self.free = true,
        }
    }

    fn lock(&mut self, time: Timestamp) {
        (self.locked, self.told) = (Some(time), Some(time));
        self.holdover = false;
    }

    fn hold_over(&mut self) {
        self.lock_losses += u64::from(!self.holdover);
        self.holdover = true;
    }

    /// When the sensor was last known to follow the pulse, where it does so no more.
    pub fn holdover_since(&self) -> Option<Timestamp> {
        self.locked.filter(|_| self.holdover)
    }

    /// How often the pulse was lost.
    pub fn lock_losses(&self) -> u64 {
        self.lock_losses
    }

    /// Whether it is known how to read the counter: locked, or known to run free.
    pub fn is_decided(&self) -> bool {
        self.locked.is_some() || self.free
    }

    /// Whether the sensor's second follows a pulse.
    pub fn is_locked(&self) -> bool {
        self.locked.is_some()
    }

    /// How a sensor that runs free is read; `None` for one that is locked.
    pub fn estimate(&self) -> Option<ClockEstimate> {
        if self.locked.is_some() {
            return None;
        }
        self.one_way.estimate().map(|estimate| ClockEstimate {
            epoch: estimate.epoch.saturating_add(self.epochs_before),
            ..estimate
        })
    }

    /// Takes a data packet: whether its counter goes on, and its arrival for a sensor that runs free. What was decoded of packets
    /// before it has its time already.
    pub fn observe(&mut self, toh_ns: i64, arrival: Timestamp) {
        let now = Instants { toh_ns, arrival };
        let before = self.counter.replace(now);
        if before.is_some_and(|before| before.is_set_before(now)) {
            self.jump(now);
        }
        if self.locked.is_none() {
            let device_ns = self.unwrap.unwrap(toh_ns.rem_euclid(HOUR_NS), HOUR_NS);
            self.one_way.push(device_ns, arrival);
        }
    }

    /// The counter is another from here on: that of a position packet that came before, or one of which nothing is known.
    fn jump(&mut self, now: Instants) {
        let awaited = self.awaited.take();
        if let Some((_, time)) = awaited.filter(|(fix, _)| !fix.is_set_before(now)) {
            self.lock(time);
        } else if self.locked.is_some() {
            *self = Self {
                lock_losses: self.lock_losses + u64::from(!self.holdover),
                counter: self.counter,
                epochs_before: self.epochs_before + self.one_way.epochs() + 1,
                ..Self::default()
            };
        }
    }

    /// Time of a counter value that arrived at `arrival`.
    pub fn time(&mut self, toh_ns: i64, arrival: Timestamp) -> Timestamp {
        let Some(locked) = self.locked else {
            let device_ns = self.unwrap.unwrap(toh_ns.rem_euclid(HOUR_NS), HOUR_NS);
            self.one_way.push(device_ns, arrival);
            return self.one_way.time(device_ns);
        };
        let time = nearest_hour(toh_ns, self.told.unwrap_or(locked));
        self.told = Some(time);
        if time - locked > PATIENCE_NS {
            self.hold_over();
        }
        time
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Arrival of packets where it does not matter.
    const AT: Timestamp = Timestamp::from_nanos(7);

    /// Stamps of a long scan indoors went back by an hour half an hour after the pulse was lost.
    #[test]
    fn hours_go_on_without_the_pulse() {
        let hour = Timestamp::from_nanos(1_772_359_200_000_000_000);
        let mut clock = LidarClock::default();
        let fix = |toh_ns: i64, pps_locked: bool| PositionFix {
            toh_ns,
            pps_locked,
            sentence: pps_locked.then_some(hour),
        };
        clock.fix(&fix(0, true), AT);
        for minute in 1..200 {
            let after_ns = minute * (HOUR_NS / 60);
            clock.fix(&fix(after_ns % HOUR_NS, false), AT);
            let time = clock.time(after_ns % HOUR_NS, Timestamp::from_nanos(3));
            assert_eq!(time, hour.plus_nanos(after_ns), "minute {minute}");
        }
        assert_eq!(clock.holdover_since(), Some(hour));
        // The pulse is back, and its sentence is not there yet.
        let after_ns = 200 * (HOUR_NS / 60);
        let fix = PositionFix {
            sentence: None,
            ..fix(after_ns % HOUR_NS, true)
        };
        clock.fix(&fix, AT);
        let time = clock.time(after_ns % HOUR_NS, Timestamp::from_nanos(3));
        assert_eq!(time, hour.plus_nanos(after_ns));
    }

    #[test]
    fn a_locked_sensor_ignores_arrival() {
        let sentence = Timestamp::from_nanos(1_772_359_199_000_000_000);
        let mut clock = LidarClock::default();
        assert!(!clock.is_decided());
        let fix = PositionFix {
            toh_ns: HOUR_NS - 1_000_000,
            pps_locked: true,
            sentence: Some(sentence),
        };
        clock.fix(&fix, AT);
        let hour = Timestamp::from_nanos(1_772_359_200_000_000_000);
        assert_eq!(
            clock.time(20_000, Timestamp::from_nanos(3)),
            hour.plus_nanos(20_000)
        );
        assert_eq!(
            clock.time(HOUR_NS - 20_000, Timestamp::from_nanos(9)),
            hour.plus_nanos(-20_000)
        );
        // The next sentence is lost; the lock is not.
        let fix = PositionFix {
            toh_ns: 500_000,
            pps_locked: true,
            sentence: None,
        };
        clock.fix(&fix, AT);
        assert_eq!(
            clock.time(600_000, Timestamp::from_nanos(9)),
            hour.plus_nanos(600_000)
        );
    }

    #[test]
    fn a_pulse_that_is_lost_is_told_and_the_second_goes_on() {
        let sentence = Timestamp::from_nanos(1_772_359_200_000_000_000);
        let mut clock = LidarClock::default();
        let fix = |toh_ns, pps_locked| PositionFix {
            toh_ns,
            pps_locked,
            sentence: Some(sentence),
        };
        clock.fix(&fix(1_000, true), AT);
        assert_eq!((clock.holdover_since(), clock.lock_losses()), (None, 0));
        clock.fix(&fix(2_000, false), AT);
        clock.fix(&fix(3_000, false), AT);
        assert_eq!(
            (clock.holdover_since(), clock.lock_losses()),
            (Some(sentence.plus_nanos(1_000)), 1)
        );
        let time = clock.time(5_000, Timestamp::from_nanos(7));
        assert_eq!(time, sentence.plus_nanos(5_000));
        clock.fix(&fix(6_000, true), AT);
        assert_eq!((clock.holdover_since(), clock.lock_losses()), (None, 1));
    }
    const NOON: Timestamp = Timestamp::from_nanos(1_772_366_400_000_000_000);
    /// Data and position packets come alternately, this far apart.
    const EVERY_NS: i64 = 5_000_000;

    /// A sensor whose counter is `ahead_ns` of the host's clock past the hour, as it is heard for `secs`: with what it names the second, if
    /// anything, and its state of the pulse, if it sends that at all.
    struct Heard {
        clock: LidarClock,
        now: Timestamp,
    }

    impl Heard {
        fn new() -> Self {
            let clock = LidarClock::default();
            Self { clock, now: NOON }
        }

        /// Returns the largest error of what was told, seconds.
        fn hear(&mut self, secs: f64, ahead_ns: i64, pps_locked: Option<bool>) -> f64 {
            let mut worst_ns = 0;
            for n in 0..(secs * 1e9).round() as i64 / EVERY_NS {
                self.now = self.now.plus_nanos(EVERY_NS);
                let toh_ns = (self.now - NOON + ahead_ns).rem_euclid(HOUR_NS);
                if n % 2 == 1 {
                    // The packet is decoded with what was known before it.
                    if self.clock.is_decided() {
                        let time = self.clock.time(toh_ns, self.now);
                        worst_ns = worst_ns.max((time - self.now).abs());
                    }
                    self.clock.observe(toh_ns, self.now);
                } else if let Some(pps_locked) = pps_locked {
                    let fix = PositionFix {
                        toh_ns,
                        pps_locked,
                        sentence: pps_locked.then_some(self.now.plus_nanos(-500_000_000)),
                    };
                    self.clock.fix(&fix, self.now);
                }
            }
            worst_ns as f64 * 1e-9
        }
    }

    /// Its stamps were minutes off, and called good to a microsecond.
    #[test]
    fn a_sensor_that_is_restarted_is_not_locked_any_more() {
        let mut heard = Heard::new();
        assert!(heard.hear(2.0, 0, Some(true)) < 1e-9);
        assert!(heard.clock.is_locked());
        // Its counter begins at 0, a quarter of an hour into the hour; without a pulse.
        let begun_ns = -(heard.now - NOON) + 900_000_000_000;
        heard.hear(0.02, begun_ns, Some(false));
        assert!(!heard.clock.is_locked());
        assert_eq!(heard.clock.lock_losses(), 1);
        let worst_secs = heard.hear(2.0, begun_ns, Some(false));
        assert!(worst_secs < 1e-3, "{worst_secs}");
        let epoch = heard.clock.estimate().map(|estimate| estimate.epoch);
        assert_eq!(epoch, Some(2), "the locked one was the first");
        // The pulse sets it: position packets say so before the data do, or after.
        heard.hear(EVERY_NS as f64 * 1e-9, 0, Some(true));
        assert!(!heard.clock.is_locked(), "data are to follow");
        heard.hear(0.02, 0, Some(true));
        assert!(heard.clock.is_locked());
        assert!(heard.hear(2.0, 0, Some(true)) < 1e-9);
    }

    /// What position packets say of a counter that the data do not have yet told the data's time.
    #[test]
    fn a_lock_begins_with_the_data_that_were_set_by_it() {
        let mut heard = Heard::new();
        let free_ns = 1_200_000_000_000;
        assert!(heard.hear(2.0, free_ns, Some(false)) < 1e-3);
        let fix = PositionFix {
            toh_ns: heard.now - NOON,
            pps_locked: true,
            sentence: Some(NOON),
        };
        assert_eq!(heard.clock.fix(&fix, heard.now), None);
        let worst_secs = heard.hear(0.1, free_ns, None);
        assert!(worst_secs < 1e-3, "{worst_secs}");
        heard.hear(2.0 * EVERY_NS as f64 * 1e-9, 0, None);
        assert!(heard.clock.is_locked(), "by the packet that was ahead");
        assert!(heard.hear(1.0, 0, Some(true)) < 1e-9);
        assert_eq!(heard.clock.lock_losses(), 0);
    }

    /// It was locked, to a microsecond, for ever.
    #[test]
    fn without_position_packets_nobody_knows_of_a_pulse() {
        let mut heard = Heard::new();
        heard.hear(2.0, 0, Some(true));
        let last = heard.now;
        heard.hear(2.5, 0, None);
        assert_eq!(heard.clock.holdover_since(), None);
        heard.hear(1.0, 0, None);
        let since = heard.clock.holdover_since().expect("it holds over");
        assert!((since - last).abs() <= 2 * EVERY_NS, "{since}");
        assert_eq!(heard.clock.lock_losses(), 1);
        assert!(heard.hear(600.0, 0, None) < 1e-9, "the second goes on");
        heard.hear(0.01, 0, Some(true));
        assert_eq!(heard.clock.holdover_since(), None);
    }
}
