//! One-way clock translation: a free-running counter to the host's clock.
//!
//! `host = a + b·device + delay` with a delay that is never negative: only the lower envelope of the points carries the
//! clock. Its lower convex hull is kept, and the clock is the hull segment over the middle of the window, which minimises
//! the summed distance of all points above it (Zhang, Liu, Xia, INFOCOM 2002). The smallest delay stays inside as a bias;
//! no one-way method sees it.

use lsfb_types::Timestamp;

/// Skew of a quartz beyond this is a wrong fit.
const LARGEST_SKEW: f64 = 200e-6;
/// A slope from a shorter stretch says more about the delays than about the clock.
const SLOPE_AFTER_NS: i64 = 2_000_000_000;
/// Temperature bends the line: a window lives this long, and the next warms up during its second half.
const WINDOW_NS: i64 = 120_000_000_000;
/// A point this far from the line is beyond any queue …
const RESIDUAL_NS: i64 = 50_000_000;
/// … and this many in a row are a clock that was set.
const RESIDUALS: u32 = 10;
/// A counter that steps back by more has begun anew.
const RESET_NS: i64 = 1_000_000_000;
/// A change of windows is smoothed at this rate.
const SLEW: f64 = 100e-6;

/// Fits host time to a free-running counter, online. The constant part of the delay cannot be seen and stays in.
#[derive(Clone, Debug, Default)]
pub struct OneWayClock {
    last_device_ns: Option<i64>,
    current: Window,
    next: Option<Window>,
    /// What is left of the step between two windows, at `since_ns`.
    step_ns: f64,
    since_ns: i64,
    late: u32,
    restarts: u32,
}

#[derive(Clone, Copy, Debug)]
struct Point {
    device_ns: i64,
    host_ns: i64,
}

#[derive(Clone, Debug, Default)]
struct Window {
    hull: Vec<Point>,
    smallest_offset_ns: i64,
}

impl OneWayClock {
    /// Takes one pair of stamps. A counter that does not advance says nothing.
    pub fn push(&mut self, device_ns: i64, arrival: Timestamp) {
        if let Some(last_ns) = self.last_device_ns {
            let back = device_ns < last_ns.saturating_sub(RESET_NS);
            let residual = arrival.nanos().saturating_sub(self.line(device_ns));
            self.late = if residual > RESIDUAL_NS {
                self.late + 1
            } else {
                0
            };
            if back || residual < -RESIDUAL_NS || self.late > RESIDUALS {
                *self = Self {
                    restarts: self.restarts + 1,
                    ..Self::default()
                };
            } else if device_ns <= last_ns {
                return;
            }
        }
        let point = Point {
            device_ns,
            host_ns: arrival.nanos(),
        };
        self.last_device_ns = Some(device_ns);
        self.current.push(point);
        if self.current.span_ns() > WINDOW_NS / 2 {
            self.next.get_or_insert_default().push(point);
        }
        if self.current.span_ns() > WINDOW_NS
            && let Some(next) = self.next.take()
        {
            let before = self.line(device_ns);
            self.current = next;
            self.step_ns = before.saturating_sub(self.current.line(device_ns)) as f64;
            self.since_ns = device_ns;
        }
    }

    /// Host time of a counter value near the last pair. Zero before the first.
    pub fn time(&self, device_ns: i64) -> Timestamp {
        match self.last_device_ns {
            Some(_) => Timestamp::from_nanos(self.line(device_ns)),
            None => Timestamp::default(),
        }
    }

    /// Host seconds per device second, less one. 0 until two seconds have passed.
    pub fn skew(&self) -> f64 {
        self.current.segment().map_or(0.0, |segment| segment.skew)
    }

    /// How often the counter, or the host's clock, began anew; the first time included.
    pub fn epochs(&self) -> u32 {
        self.restarts + u32::from(self.last_device_ns.is_some())
    }

    fn line(&self, device_ns: i64) -> i64 {
        let decayed = SLEW * device_ns.saturating_sub(self.since_ns).max(0) as f64;
        let step = self.step_ns.signum() * (self.step_ns.abs() - decayed).max(0.0);
        self.current.line(device_ns).saturating_add(step as i64)
    }
}

struct Segment {
    from: Point,
    skew: f64,
}

impl Window {
    fn push(&mut self, point: Point) {
        let offset = point.host_ns.saturating_sub(point.device_ns);
        self.smallest_offset_ns = if self.hull.is_empty() {
            offset
        } else {
            self.smallest_offset_ns.min(offset)
        };
        while let [.., a, b] = self.hull[..] {
            if turns_left(a, b, point) {
                break;
            }
            self.hull.pop();
        }
        self.hull.push(point);
    }

    fn span_ns(&self) -> i64 {
        match self.hull[..] {
            [first, .., last] => last.device_ns.saturating_sub(first.device_ns),
            _ => 0,
        }
    }

    /// The hull segment over the middle of the window, where that is long enough and believable.
    fn segment(&self) -> Option<Segment> {
        let first = self.hull.first()?;
        let span = self.span_ns();
        if span < SLOPE_AFTER_NS {
            return None;
        }
        let middle = first.device_ns.saturating_add(span / 2);
        let end = self
            .hull
            .partition_point(|point| point.device_ns <= middle)
            .min(self.hull.len() - 1);
        let (from, to) = (self.hull.get(end.checked_sub(1)?)?, self.hull.get(end)?);
        let run = to.device_ns.saturating_sub(from.device_ns);
        let drift = to.host_ns.saturating_sub(from.host_ns).saturating_sub(run);
        let skew = drift as f64 / run as f64;
        (skew.abs() <= LARGEST_SKEW).then_some(Segment { from: *from, skew })
    }

    fn line(&self, device_ns: i64) -> i64 {
        match self.segment() {
            // Relative to a near point: nanoseconds since 1970 do not fit the mantissa of an f64.
            Some(Segment { from, skew }) => {
                let run = device_ns.saturating_sub(from.device_ns);
                let drift = (skew * run as f64).round() as i64;
                from.host_ns.saturating_add(run).saturating_add(drift)
            }
            None => device_ns.saturating_add(self.smallest_offset_ns),
        }
    }
}

fn turns_left(a: Point, b: Point, c: Point) -> bool {
    let across = |from: i64, to: i64| i128::from(to) - i128::from(from);
    let cross = across(a.device_ns, b.device_ns).saturating_mul(across(a.host_ns, c.host_ns))
        - across(a.host_ns, b.host_ns).saturating_mul(across(a.device_ns, c.device_ns));
    cross > 0
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: i64 = 1_772_359_200_000_000_000;

    /// Delays of a USB or network queue: 300 µs at least, a millisecond on average above, bursts of 30 ms.
    struct Delays(u64);

    impl Delays {
        fn uniform(&mut self) -> f64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }

        fn next_ns(&mut self) -> i64 {
            let tail = -1e6 * self.uniform().max(1e-12).ln();
            let burst = if self.uniform() < 0.01 {
                30e6 * self.uniform()
            } else {
                0.0
            };
            300_000 + (tail + burst) as i64
        }
    }

    struct Case {
        seed: u64,
        rate_hz: i64,
        skew: f64,
        secs: i64,
        silent_secs: std::ops::Range<i64>,
    }

    /// Largest error after the first half minute, the smallest delay taken off.
    fn worst_ns(case: &Case) -> i64 {
        let mut clock = OneWayClock::default();
        let mut delays = Delays(case.seed);
        let mut worst = 0;
        for n in 0..case.secs * case.rate_hz {
            let true_ns = n * 1_000_000_000 / case.rate_hz;
            if case.silent_secs.contains(&(true_ns / 1_000_000_000)) {
                continue;
            }
            let device_ns = true_ns + (true_ns as f64 * case.skew) as i64;
            clock.push(
                device_ns,
                Timestamp::from_nanos(START + true_ns + delays.next_ns()),
            );
            if true_ns > 30_000_000_000 {
                worst =
                    worst.max((clock.time(device_ns).nanos() - START - true_ns - 300_000).abs());
            }
        }
        assert_eq!(clock.epochs(), 1);
        assert!((clock.skew() + case.skew).abs() < 10e-6, "{}", clock.skew());
        worst
    }

    #[test]
    fn the_lower_envelope_finds_the_clock_under_the_delays() {
        for (seed, skew) in [(1, -80e-6), (0x5EED_5EED, 0.0), (77, 80e-6)] {
            for (rate_hz, tolerance_ns) in [(200, 100_000), (20, 300_000)] {
                // Long enough for two changes of window.
                let case = Case {
                    seed,
                    rate_hz,
                    skew,
                    secs: 300,
                    silent_secs: 0..0,
                };
                let worst = worst_ns(&case);
                assert!(
                    worst < tolerance_ns,
                    "skew {skew}, {rate_hz} Hz: {worst} ns"
                );
            }
        }
        let outage = Case {
            seed: 9,
            rate_hz: 200,
            skew: 40e-6,
            secs: 100,
            silent_secs: 50..55,
        };
        assert!(worst_ns(&outage) < 100_000);
    }

    #[test]
    fn a_clock_that_is_set_begins_a_new_fit() {
        let mut clock = OneWayClock::default();
        let at = |millis: i64| Timestamp::from_nanos(START + millis * 1_000_000);
        for n in 0..1000 {
            clock.push(50_000_000_000 + n * 5_000_000, at(n * 5));
        }
        // The device is restarted.
        for n in 0..1000 {
            clock.push(n * 5_000_000, at(8_000 + n * 5));
        }
        assert_eq!(
            (clock.epochs(), clock.time(999 * 5_000_000)),
            (2, at(8_000 + 999 * 5))
        );
        // The host's clock is set forward by ten seconds: late without end, so a new fit after a few samples.
        for n in 1000..2000 {
            clock.push(n * 5_000_000, at(18_000 + n * 5));
        }
        assert_eq!(
            (clock.epochs(), clock.time(1999 * 5_000_000)),
            (3, at(18_000 + 1999 * 5))
        );
        // And back: at once.
        for n in 2000..2100 {
            clock.push(n * 5_000_000, at(9_000 + n * 5));
        }
        assert_eq!(
            (clock.epochs(), clock.time(2099 * 5_000_000)),
            (4, at(9_000 + 2099 * 5))
        );
    }

    #[test]
    fn extreme_values_do_not_panic() {
        let mut clock = OneWayClock::default();
        assert_eq!(clock.time(5), Timestamp::default());
        for device_ns in [0, i64::MAX, 1, i64::MIN, 17, i64::MAX - 3] {
            for nanos in [0, i64::MAX, i64::MIN, 5] {
                clock.push(device_ns, Timestamp::from_nanos(nanos));
                let _ = (clock.time(device_ns), clock.time(-1), clock.skew());
            }
        }
    }
}
