//! Device ticks to [`Timestamp`]: nothing else in the workspace does this.
//!
//! Disciplined devices (PPS and NMEA, external time, UTC) name the second themselves, so that their time does not depend on
//! when bytes arrived. For the others [`OneWayClock`] fits the device's counter to host time from below: delays are never
//! negative, so only the lower envelope of arrivals tells the clock (Zhang, Liu, Xia, "Clock synchronization algorithms
//! for network measurements", INFOCOM 2002).

use lsfb_types::Timestamp;

const HOUR_NS: i64 = 3_600_000_000_000;

/// The absolute time nearest to `reference` whose time past the hour is `toh_ns`. Real sensors send values slightly above
/// an hour (ros-drivers/velodyne issue 218); they wrap.
pub fn nearest_hour(toh_ns: i64, reference: Timestamp) -> Timestamp {
    let phase = (toh_ns - reference.nanos()).rem_euclid(HOUR_NS);
    let ahead = if phase > HOUR_NS / 2 { phase - HOUR_NS } else { phase };
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
    /// Position packets said that the sensor runs free.
    free: bool,
    unwrap: Unwrap,
    one_way: OneWayClock,
}

impl LidarClock {
    /// Takes a position packet.
    pub fn fix(&mut self, fix: &PositionFix) {
        match (fix.pps_locked, fix.sentence, self.locked) {
            (true, Some(sentence), _) => self.locked = Some(nearest_hour(fix.toh_ns, sentence)),
            // Still locked, but this sentence did not come through: go on from the last one.
            (true, None, Some(last)) => self.locked = Some(nearest_hour(fix.toh_ns, last)),
            _ => self.free = true,
        }
    }

    /// Whether it is known how to read the counter: locked, or known to run free.
    pub fn is_decided(&self) -> bool {
        self.locked.is_some() || self.free
    }

    /// Whether the sensor's second follows a pulse.
    pub fn is_locked(&self) -> bool {
        self.locked.is_some()
    }

    /// Time of a counter value that arrived at `arrival`.
    pub fn time(&mut self, toh_ns: i64, arrival: Timestamp) -> Timestamp {
        match self.locked {
            Some(reference) => nearest_hour(toh_ns, reference),
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
        let step = (value - last).rem_euclid(period);
        let step = if step > period / 2 { step - period } else { step };
        self.last = Some(last + step);
        last + step
    }
}

/// Largest skew of a working oscillator; a steeper fit is noise.
const MAX_SKEW: f64 = 200e-6;
/// Below this span a slope cannot be told from delays.
const MIN_SPAN_NS: i64 = 2_000_000_000;
/// A counter this far back has begun anew.
const RESET_NS: i64 = 1_000_000_000;

/// Fits host time to a free-running counter, online. The constant part of the delay cannot be seen and stays in.
#[derive(Clone, Debug, Default)]
pub struct OneWayClock {
    /// Lower convex hull of (device, host), nanoseconds.
    hull: Vec<(i64, i64)>,
    first_device_ns: i64,
    last_device_ns: i64,
    epochs: u32,
}

impl OneWayClock {
    /// Takes one pair of stamps.
    pub fn push(&mut self, device_ns: i64, arrival: Timestamp) {
        if self.hull.is_empty() || device_ns < self.last_device_ns - RESET_NS {
            self.hull.clear();
            self.first_device_ns = device_ns;
            self.epochs += 1;
        } else if device_ns <= self.last_device_ns {
            return;
        }
        self.last_device_ns = device_ns;
        let point = (device_ns, arrival.nanos());
        while let [.., a, b] = self.hull[..] {
            if cross(a, b, point) > 0 {
                break;
            }
            self.hull.pop();
        }
        self.hull.push(point);
    }

    /// Host time of a counter value. Zero before the first pair.
    pub fn time(&self, device_ns: i64) -> Timestamp {
        let line = self.line();
        let run = device_ns - line.device_ns;
        Timestamp::from_nanos(line.host_ns + run).plus_nanos((run as f64 * line.skew).round() as i64)
    }

    /// Host seconds per device second, less one. 0 until two seconds have passed.
    pub fn skew(&self) -> f64 {
        self.line().skew
    }

    /// How often the counter began anew, the first time included.
    pub fn epochs(&self) -> u32 {
        self.epochs
    }

    fn line(&self) -> Line {
        let middle = self.first_device_ns + (self.last_device_ns - self.first_device_ns) / 2;
        let long = self.last_device_ns - self.first_device_ns >= MIN_SPAN_NS;
        // The segment above the middle of the window minimises the summed distance of all points above it.
        let segment = self.hull.windows(2).find(|w| w[1].0 >= middle);
        if let (true, Some(&[a, b])) = (long, segment) {
            let skew = ((b.1 - a.1) - (b.0 - a.0)) as f64 / (b.0 - a.0) as f64;
            if skew.abs() <= MAX_SKEW {
                return Line { device_ns: a.0, host_ns: a.1, skew };
            }
        }
        let lowest = self.hull.iter().min_by_key(|(device, host)| host - device);
        lowest.map_or(Line::default(), |&(device_ns, host_ns)| Line { device_ns, host_ns, skew: 0.0 })
    }
}

#[derive(Default)]
struct Line {
    device_ns: i64,
    host_ns: i64,
    skew: f64,
}

/// Positive where `a → b → c` turns left.
fn cross(a: (i64, i64), b: (i64, i64), c: (i64, i64)) -> i128 {
    let d = |x: i64, y: i64| i128::from(x) - i128::from(y);
    d(b.0, a.0) * d(c.1, a.1) - d(b.1, a.1) * d(c.0, a.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_past_the_hour_takes_the_hour_of_its_reference() {
        let noon = Timestamp::from_nanos(1_772_366_400_000_000_000);
        assert_eq!(nearest_hour(5, noon), noon.plus_nanos(5));
        assert_eq!(nearest_hour(HOUR_NS - 7, noon), noon.plus_nanos(-7));
        assert_eq!(nearest_hour(HOUR_NS + 60_000_000, noon), noon.plus_nanos(60_000_000));
    }

    #[test]
    fn a_locked_sensor_ignores_arrival() {
        let sentence = Timestamp::from_nanos(1_772_359_199_000_000_000);
        let mut clock = LidarClock::default();
        assert!(!clock.is_decided());
        clock.fix(&PositionFix { toh_ns: HOUR_NS - 1_000_000, pps_locked: true, sentence: Some(sentence) });
        let hour = Timestamp::from_nanos(1_772_359_200_000_000_000);
        assert_eq!(clock.time(20_000, Timestamp::from_nanos(3)), hour.plus_nanos(20_000));
        assert_eq!(clock.time(HOUR_NS - 20_000, Timestamp::from_nanos(9)), hour.plus_nanos(-20_000));
        // The next sentence is lost; the lock is not.
        clock.fix(&PositionFix { toh_ns: 500_000, pps_locked: true, sentence: None });
        assert_eq!(clock.time(600_000, Timestamp::from_nanos(9)), hour.plus_nanos(600_000));
    }

    /// Counter with skew, delays of 0.3 ms plus an exponential tail and bursts; 30 s at 200 Hz.
    #[test]
    fn finds_offset_and_skew_under_one_sided_jitter() {
        for (seed, skew) in [(1_u64, 50e-6), (2, -50e-6), (3, 0.0), (4, 80e-6)] {
            let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let mut uniform = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                ((state >> 11) as f64 / (1_u64 << 53) as f64).max(1e-12)
            };
            let mut clock = OneWayClock::default();
            let host = |device_ns: i64| 7_000_000_000_i64 + device_ns + (device_ns as f64 * skew) as i64;
            for i in 0..6000_i64 {
                let device_ns = i * 5_000_000;
                let burst = if uniform() < 0.02 { 30e6 } else { 0.0 };
                let delay = 300_000.0 - 1e6 * uniform().ln() + burst;
                clock.push(device_ns, Timestamp::from_nanos(host(device_ns) + delay as i64));
            }
            let now = 29_995_000_000;
            let error_ns = clock.time(now).nanos() - host(now) - 300_000;
            assert!(error_ns.abs() < 100_000, "seed {seed}: {error_ns} ns");
            assert!((clock.skew() - skew).abs() < 5e-6, "seed {seed}: {}", clock.skew());
        }
    }

    #[test]
    fn a_counter_that_begins_anew_begins_a_new_fit() {
        let mut clock = OneWayClock::default();
        clock.push(5_000_000_000, Timestamp::from_nanos(50));
        clock.push(6_000_000_000, Timestamp::from_nanos(1_000_000_050));
        clock.push(0, Timestamp::from_nanos(9_000_000_000));
        assert_eq!(clock.time(1_000), Timestamp::from_nanos(9_000_001_000));
        assert_eq!(clock.epochs(), 2);
    }

    #[test]
    fn unwraps_in_both_directions() {
        let mut unwrap = Unwrap::default();
        let values = [98, 1, 99, 3, 40, 60].map(|v| unwrap.unwrap(v, 100));
        assert_eq!(values, [98, 101, 99, 103, 140, 160]);
    }
}
