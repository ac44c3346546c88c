//! Device ticks to [`Timestamp`]: nothing else in the workspace does this.
//!
//! Disciplined devices (PPS and NMEA, external time, UTC) name the second themselves, so that their time does not depend on
//! when bytes arrived. For the others [`OneWayClock`] fits the device's counter to host time from below: delays are never
//! negative, so only the lower envelope of arrivals tells the clock (Zhang, Liu, Xia, "Clock synchronization algorithms
//! for network measurements", INFOCOM 2002).

mod envelope;
mod judgement;
pub(crate) mod model_topic;
mod one_way;
mod recorded;

use lsfb_types::Timestamp;

pub use one_way::{ClockEstimate, ClockStep, OneWayClock, StampPair, fit_pairs};
pub use recorded::{
    ClockConfig, ClockEpoch, ClockReport, DeviceClock, Exchange, ExchangedClock, ExchangedTime,
    ResidualSample, StampOrder, estimate_clocks,
};

const HOUR_NS: i64 = 3_600_000_000_000;

/// The absolute time nearest to `reference` whose time past the hour is `toh_ns`. Real sensors send values slightly above
/// an hour (ros-drivers/velodyne issue 218); they wrap.
pub fn nearest_hour(toh_ns: i64, reference: Timestamp) -> Timestamp {
    let phase = (toh_ns - reference.nanos()).rem_euclid(HOUR_NS);
    let ahead = if phase > HOUR_NS / 2 {
        phase - HOUR_NS
    } else {
        phase
    };
    reference.plus_nanos(ahead)
}

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

/// The clock of a Velodyne sensor: time past the hour, microseconds.
#[derive(Clone, Debug, Default)]
pub struct LidarClock {
    /// Absolute time of the last locked position packet.
    locked: Option<Timestamp>,
    /// The last time that was told since then: in which hour the counter is, however long ago the pulse was lost.
    told: Option<Timestamp>,
    /// Position packets said that the sensor runs free.
    free: bool,
    /// The pulse is gone since the last locked position packet.
    holdover: bool,
    lock_losses: u64,
    unwrap: Unwrap,
    one_way: OneWayClock,
}

impl LidarClock {
    /// Takes a position packet.
    pub fn fix(&mut self, fix: &PositionFix) {
        match (fix.pps_locked, fix.sentence, self.locked) {
            (true, Some(sentence), _) => self.lock(nearest_hour(fix.toh_ns, sentence)),
            // Still locked, but this sentence did not come through: go on from the last one.
            (true, None, Some(last)) => {
                self.lock(nearest_hour(fix.toh_ns, self.told.unwrap_or(last)));
            }
            // The second that was locked goes on by the sensor's own quartz.
            (false, _, Some(_)) => {
                self.lock_losses += u64::from(!self.holdover);
                self.holdover = true;
            }
            _ => self.free = true,
        }
    }

    fn lock(&mut self, time: Timestamp) {
        (self.locked, self.told) = (Some(time), Some(time));
        self.holdover = false;
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
        match self.locked {
            Some(_) => None,
            None => self.one_way.estimate(),
        }
    }

    /// Takes the arrival of a data packet, for a sensor that runs free.
    pub fn observe(&mut self, toh_ns: i64, arrival: Timestamp) {
        if self.locked.is_none() {
            let device_ns = self.unwrap.unwrap(toh_ns.rem_euclid(HOUR_NS), HOUR_NS);
            self.one_way.push(device_ns, arrival);
        }
    }

    /// Time of a counter value that arrived at `arrival`.
    pub fn time(&mut self, toh_ns: i64, arrival: Timestamp) -> Timestamp {
        match self.locked {
            Some(locked) => {
                let time = nearest_hour(toh_ns, self.told.unwrap_or(locked));
                self.told = Some(time);
                time
            }
            None => {
                let device_ns = self.unwrap.unwrap(toh_ns.rem_euclid(HOUR_NS), HOUR_NS);
                self.one_way.push(device_ns, arrival);
                self.one_way.time(device_ns)
            }
        }
    }
}

/// Continues a counter beyond its wrap.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unwrap {
    last: Option<i64>,
}

impl Unwrap {
    /// The continued value of `value`, which wraps at `period`; small steps backward stay steps backward.
    pub fn unwrap(&mut self, value: i64, period: i64) -> i64 {
        let Some(last) = self.last else {
            self.last = Some(value);
            return value;
        };
        let step = value.saturating_sub(last).rem_euclid(period.max(1));
        let step = if step > period / 2 {
            step - period
        } else {
            step
        };
        let continued = last.saturating_add(step);
        self.last = Some(continued);
        continued
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_past_the_hour_takes_the_hour_of_its_reference() {
        let noon = Timestamp::from_nanos(1_772_366_400_000_000_000);
        assert_eq!(nearest_hour(5, noon), noon.plus_nanos(5));
        assert_eq!(nearest_hour(HOUR_NS - 7, noon), noon.plus_nanos(-7));
        assert_eq!(
            nearest_hour(HOUR_NS + 60_000_000, noon),
            noon.plus_nanos(60_000_000)
        );
    }

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
        clock.fix(&fix(0, true));
        for minute in 1..200 {
            let after_ns = minute * (HOUR_NS / 60);
            clock.fix(&fix(after_ns % HOUR_NS, false));
            let time = clock.time(after_ns % HOUR_NS, Timestamp::from_nanos(3));
            assert_eq!(time, hour.plus_nanos(after_ns), "minute {minute}");
        }
        assert_eq!(clock.holdover_since(), Some(hour));
        // The pulse is back, and its sentence is not there yet.
        let after_ns = 200 * (HOUR_NS / 60);
        clock.fix(&PositionFix {
            sentence: None,
            ..fix(after_ns % HOUR_NS, true)
        });
        let time = clock.time(after_ns % HOUR_NS, Timestamp::from_nanos(3));
        assert_eq!(time, hour.plus_nanos(after_ns));
    }

    #[test]
    fn a_locked_sensor_ignores_arrival() {
        let sentence = Timestamp::from_nanos(1_772_359_199_000_000_000);
        let mut clock = LidarClock::default();
        assert!(!clock.is_decided());
        clock.fix(&PositionFix {
            toh_ns: HOUR_NS - 1_000_000,
            pps_locked: true,
            sentence: Some(sentence),
        });
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
        clock.fix(&PositionFix {
            toh_ns: 500_000,
            pps_locked: true,
            sentence: None,
        });
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
        clock.fix(&fix(1_000, true));
        assert_eq!((clock.holdover_since(), clock.lock_losses()), (None, 0));
        clock.fix(&fix(2_000, false));
        clock.fix(&fix(3_000, false));
        assert_eq!(
            (clock.holdover_since(), clock.lock_losses()),
            (Some(sentence.plus_nanos(1_000)), 1)
        );
        let time = clock.time(5_000, Timestamp::from_nanos(7));
        assert_eq!(time, sentence.plus_nanos(5_000));
        clock.fix(&fix(6_000, true));
        assert_eq!((clock.holdover_since(), clock.lock_losses()), (None, 1));
    }

    #[test]
    fn unwraps_in_both_directions() {
        let mut unwrap = Unwrap::default();
        let values = [98, 1, 99, 3, 40, 60].map(|v| unwrap.unwrap(v, 100));
        assert_eq!(values, [98, 101, 99, 103, 140, 160]);
    }
}
