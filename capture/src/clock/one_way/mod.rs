//! One-way clock translation: a free-running counter to the host's clock.
//!
//! `host = a + b·device + delay` with a delay that is never negative: only the lower envelope of the points carries the
//! clock; [`super::envelope`] says where the line below them is. The smallest delay stays inside as a bias; no one-way
//! method sees it.

use std::collections::{BTreeMap, VecDeque};

use lsfb_types::Timestamp;

use super::envelope::{self, Arrival, Line};

/// Temperature bends the line: a window lives this long, and gives way to one that is younger by a third.
const WINDOW_NS: i64 = 120_000_000_000;
/// Spacing of the windows that warm up.
const WARM_UP_NS: i64 = WINDOW_NS / 3;
/// A point this far from the line is beyond any queue …
const RESIDUAL_NS: i64 = 50_000_000;
/// … and this many in a row …
const LATE_POINTS: usize = 10;
/// … over this long on the host's clock are a clock that was set: what waited in a queue comes all at once.
const LATE_SPAN_NS: i64 = 500_000_000;
/// A counter that steps back by more has begun anew: one that was set back by a second is seen at once, whatever its rate.
const RESET_NS: i64 = 750_000_000;
/// The line is drawn anew this often, in device time.
const REFIT_NS: i64 = 250_000_000;
/// The first lines are drawn anew with every pair.
const EAGER_PAIRS: u64 = 50;
/// A new line is reached within a second, or at this rate.
const SLEW: f64 = 100e-6;
/// Advances of a counter that are told apart.
const MOST_ADVANCES: usize = 16;
/// Standard deviation of the skew of a counter that slipped twice or less, in ticks over the span: found by simulation, as
/// the hull follows a staircase.
const FEW_SLIPS: f64 = 0.65;
/// The same of a counter that slips all the time: the hull still follows stairs, if small ones.
const MANY_SLIPS: f64 = 0.015;
/// Of the points in each such stretch the lowest is kept to judge how dense they lie.
const THINNED_NS: i64 = 20_000_000;

/// How a counter is read: `time = reference_time + (1 + skew) · (device − reference_device)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClockEstimate {
    /// Counts the times the counter, or the host's clock, began anew; from 1.
    pub epoch: u32,
    /// The counter at the reference, nanoseconds.
    pub reference_device_ns: i64,
    /// Host time at the reference. The constant part of the transport delay cannot be seen and stays in.
    pub reference_time: Timestamp,
    /// Host seconds per device second, less one.
    pub skew: f64,
    /// Standard deviation of the time at the reference, nanoseconds.
    pub sigma_ns: f64,
    /// Standard deviation of the skew; independent of that of the time.
    pub sigma_skew: f64,
    /// Pairs of stamps behind it.
    pub pairs: u64,
}

impl ClockEstimate {
    /// Host time of a counter value.
    pub fn time(&self, device_ns: i64) -> Timestamp {
        let run = device_ns.saturating_sub(self.reference_device_ns);
        let drift = (self.skew * run as f64).round() as i64;
        self.reference_time.plus_nanos(run).plus_nanos(drift)
    }

    /// Standard deviation of [`ClockEstimate::time`], nanoseconds.
    pub fn sigma_ns_at(&self, device_ns: i64) -> f64 {
        let run = device_ns.saturating_sub(self.reference_device_ns) as f64;
        self.sigma_ns.hypot(self.sigma_skew * run)
    }
}

/// A counter value and its arrival.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StampPair {
    /// The counter, nanoseconds; unwrapped.
    pub device_ns: i64,
    /// When the host received it.
    pub arrival: Timestamp,
}

/// A clock that began anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockStep {
    /// The first counter value after it, nanoseconds.
    pub device_ns: i64,
    /// Its arrival.
    pub arrival: Timestamp,
    /// Arrival less what the clock before it says: the size of the step and one delay.
    pub step_ns: i64,
}

/// Fits host time to a free-running counter, online. The constant part of the delay cannot be seen and stays in.
#[derive(Clone, Debug, Default)]
pub struct OneWayClock {
    /// One tick of the counter, where that is known.
    tick_ns: i64,
    last_device_ns: Option<i64>,
    current: Window,
    /// Those that will take its place, the oldest first.
    next: VecDeque<Window>,
    fitted: Option<ClockEstimate>,
    refit_at_ns: i64,
    /// What is left of the step between two lines, at `since_ns`.
    step_ns: f64,
    since_ns: i64,
    late: Vec<Point>,
    steps: Vec<ClockStep>,
    pairs: u64,
}

#[derive(Clone, Copy, Debug)]
struct Point {
    device_ns: i64,
    host_ns: i64,
}

#[derive(Clone, Debug, Default)]
struct Window {
    hull: Vec<Point>,
    /// The lowest point of each short stretch.
    thinned: Vec<Point>,
    smallest_offset_ns: i64,
    rhythm: Rhythm,
}

/// By how much the counter advances from one point to the next.
#[derive(Clone, Debug, Default)]
struct Rhythm {
    advances: BTreeMap<i64, u32>,
    /// More kinds of advances than are worth counting.
    uneven: bool,
}

impl Rhythm {
    fn push(&mut self, advance_ns: i64) {
        if let Some(times) = self.advances.get_mut(&advance_ns) {
            *times += 1;
        } else if self.advances.len() < MOST_ADVANCES {
            self.advances.insert(advance_ns, 1);
        } else {
            self.uneven = true;
        }
    }

    /// How often the counter missed its usual advance, or a multiple of that: then a tick was reached sooner or later than
    /// usual. `None`: it has no usual one.
    fn slips(&self) -> Option<u32> {
        let most = self.advances.iter().max_by_key(|(_, times)| **times);
        let (&usual_ns, _) = most.filter(|(usual_ns, _)| **usual_ns > 0 && !self.uneven)?;
        let others = self.advances.iter().filter(|(ns, _)| *ns % usual_ns != 0);
        Some(others.map(|(_, times)| *times).sum())
    }
}

impl OneWayClock {
    /// A clock whose counter advances in ticks of so many nanoseconds.
    pub fn ticking(tick_ns: u64) -> Self {
        Self {
            tick_ns: i64::try_from(tick_ns).unwrap_or(i64::MAX),
            ..Self::default()
        }
    }

    /// Takes one pair of stamps. A counter that does not advance says nothing.
    pub fn push(&mut self, device_ns: i64, arrival: Timestamp) {
        let point = Point {
            device_ns,
            host_ns: arrival.nanos(),
        };
        if let Some(last_ns) = self.last_device_ns {
            let residual = arrival.nanos().saturating_sub(self.line(device_ns));
            if device_ns < last_ns.saturating_sub(RESET_NS) || residual < -RESIDUAL_NS {
                return self.begin_anew(&[point]);
            }
            if residual > RESIDUAL_NS {
                // Steps back that are too small to tell from disorder at once are told by what follows them.
                self.last_device_ns = Some(device_ns.max(last_ns));
                if self
                    .late
                    .last()
                    .is_some_and(|late| late.device_ns >= device_ns)
                {
                    self.late.clear();
                }
                self.late.push(point);
                let first = self.late.first().map_or(point, |p| *p);
                let span = point.host_ns.saturating_sub(first.host_ns);
                if self.late.len() > LATE_POINTS && span >= LATE_SPAN_NS {
                    let late = std::mem::take(&mut self.late);
                    self.begin_anew(&late);
                }
                return;
            }
            self.late.clear();
            if device_ns <= last_ns {
                return;
            }
        }
        self.take(point);
    }

    /// Host time of a counter value near the last pair. Zero before the first.
    pub fn time(&self, device_ns: i64) -> Timestamp {
        match self.last_device_ns {
            Some(_) => Timestamp::from_nanos(self.line(device_ns)),
            None => Timestamp::default(),
        }
    }

    /// Host seconds per device second, less one. 0 until something is known.
    pub fn skew(&self) -> f64 {
        self.fitted.map_or(0.0, |fitted| fitted.skew)
    }

    /// How the counter is read now; `None` before two pairs.
    pub fn estimate(&self) -> Option<ClockEstimate> {
        self.fitted.map(|fitted| ClockEstimate {
            epoch: self.epochs(),
            pairs: self.pairs,
            ..fitted
        })
    }

    /// How often the counter, or the host's clock, began anew; the first time included.
    pub fn epochs(&self) -> u32 {
        self.steps.len() as u32 + u32::from(self.last_device_ns.is_some())
    }

    /// Where the counter, or the host's clock, began anew; without the first time.
    pub fn steps(&self) -> &[ClockStep] {
        &self.steps
    }

    /// The clock before `points` is no more.
    fn begin_anew(&mut self, points: &[Point]) {
        let Some(first) = points.first() else {
            return;
        };
        let mut steps = std::mem::take(&mut self.steps);
        steps.push(ClockStep {
            device_ns: first.device_ns,
            arrival: Timestamp::from_nanos(first.host_ns),
            step_ns: first.host_ns.saturating_sub(self.line(first.device_ns)),
        });
        *self = Self {
            steps,
            tick_ns: self.tick_ns,
            ..Self::default()
        };
        points.iter().for_each(|point| self.take(*point));
    }

    fn take(&mut self, point: Point) {
        self.last_device_ns = Some(point.device_ns);
        self.pairs += 1;
        self.current.push(point);
        let youngest = self.next.back().unwrap_or(&self.current);
        if youngest.span_ns() > WARM_UP_NS {
            self.next.push_back(Window::default());
        }
        self.next.iter_mut().for_each(|next| next.push(point));
        if self.current.span_ns() > WINDOW_NS
            && let Some(next) = self.next.pop_front()
        {
            self.current = next;
            self.refit(point.device_ns);
        } else if point.device_ns >= self.refit_at_ns || self.pairs < EAGER_PAIRS {
            self.refit(point.device_ns);
        }
    }

    /// Draws the line anew, and goes over to it gently.
    fn refit(&mut self, device_ns: i64) {
        let before = self.fitted.map(|_| self.line(device_ns));
        self.refit_at_ns = device_ns.saturating_add(REFIT_NS);
        self.fitted = self.current.fit(self.tick_ns);
        self.since_ns = device_ns;
        self.step_ns = match (before, self.fitted) {
            (Some(before), Some(fitted)) => {
                before.saturating_sub(fitted.time(device_ns).nanos()) as f64
            }
            _ => 0.0,
        };
    }

    fn line(&self, device_ns: i64) -> i64 {
        let Some(fitted) = self.fitted else {
            return device_ns.saturating_add(self.current.smallest_offset_ns);
        };
        let run = device_ns.saturating_sub(self.since_ns).max(0) as f64;
        let rate = SLEW.max(self.step_ns.abs() / 1e9);
        let step = self.step_ns.signum() * (self.step_ns.abs() - rate * run).max(0.0);
        fitted.time(device_ns).nanos().saturating_add(step as i64)
    }
}

/// The line below `pairs` of one epoch, device times rising: [`OneWayClock`] without its window. `tick_ns` is one tick of the
/// counter; 0 where it is fine.
pub fn fit_pairs(pairs: &[StampPair], tick_ns: u64) -> Option<ClockEstimate> {
    let mut window = Window::default();
    for pair in pairs {
        window.push(Point {
            device_ns: pair.device_ns,
            host_ns: pair.arrival.nanos(),
        });
    }
    let tick_ns = i64::try_from(tick_ns).unwrap_or(i64::MAX);
    window.fit(tick_ns).map(|fitted| ClockEstimate {
        epoch: 1,
        pairs: pairs.len() as u64,
        ..fitted
    })
}

impl Window {
    fn push(&mut self, point: Point) {
        if let Some(last) = self.hull.last() {
            let advance_ns = point.device_ns.saturating_sub(last.device_ns);
            self.rhythm.push(advance_ns);
        }
        let offset = point.offset_ns();
        self.smallest_offset_ns = if self.hull.is_empty() {
            offset
        } else {
            self.smallest_offset_ns.min(offset)
        };
        let stretch = |p: &Point| p.device_ns.div_euclid(THINNED_NS);
        match self.thinned.last_mut() {
            Some(last) if stretch(last) == stretch(&point) => {
                if offset < last.offset_ns() {
                    *last = point;
                }
            }
            _ => self.thinned.push(point),
        }
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

    /// What the counter hides within a tick. One that advances evenly may be read where its ticks begin or anywhere in
    /// between, always the same: nothing of the time, but a skew of less than a tick over the span is not seen. Where it
    /// slips now and then, stamps are late by anything within a tick, and the skew is known from slip to slip. Where
    /// it slips all the time the line lies where ticks begin, whatever it hides.
    fn sigma_of_ticks(&self, tick_ns: i64) -> SigmaOfTicks {
        let slips = self.rhythm.slips();
        let tick_ns = tick_ns as f64;
        let spread_ns = tick_ns / 12.0_f64.sqrt();
        let share = slips.map_or(MANY_SLIPS, |n| {
            MANY_SLIPS.max(FEW_SLIPS * 2.0 / f64::from(n.max(2)))
        });
        SigmaOfTicks {
            sigma_ns: if slips == Some(0) { 0.0 } else { spread_ns },
            sigma_skew: share * tick_ns / (self.span_ns().max(1) as f64),
        }
    }

    fn fit(&self, tick_ns: i64) -> Option<ClockEstimate> {
        // Relative to a near point: nanoseconds since 1970 do not fit the mantissa of an f64.
        let origin = *self.hull.first()?;
        let arrival = |p: &Point| Arrival {
            secs: p.device_ns.saturating_sub(origin.device_ns) as f64 / 1e9,
            offset_secs: p.offset_ns().saturating_sub(origin.offset_ns()) as f64 / 1e9,
        };
        let hull: Vec<Arrival> = self.hull.iter().map(arrival).collect();
        let arrivals: Vec<Arrival> = self.thinned.iter().map(arrival).collect();
        let Line {
            secs,
            offset_secs,
            skew,
            sigma_secs,
            sigma_skew,
        } = envelope::fit(&hull, &arrivals)?;
        let ticks = self.sigma_of_ticks(tick_ns);
        let reference_device_ns = origin.device_ns.saturating_add((secs * 1e9) as i64);
        let offset_ns = origin
            .offset_ns()
            .saturating_add((offset_secs * 1e9) as i64);
        Some(ClockEstimate {
            epoch: 1,
            reference_device_ns,
            reference_time: Timestamp::from_nanos(reference_device_ns.saturating_add(offset_ns)),
            skew,
            sigma_ns: (sigma_secs * 1e9).hypot(ticks.sigma_ns),
            sigma_skew: sigma_skew.hypot(ticks.sigma_skew),
            pairs: 0,
        })
    }
}

/// Standard deviations that a counter's ticks add.
struct SigmaOfTicks {
    sigma_ns: f64,
    sigma_skew: f64,
}

impl Point {
    fn offset_ns(&self) -> i64 {
        self.host_ns.saturating_sub(self.device_ns)
    }
}

fn turns_left(a: Point, b: Point, c: Point) -> bool {
    let across = |from: i64, to: i64| i128::from(to) - i128::from(from);
    let cross = across(a.device_ns, b.device_ns).saturating_mul(across(a.host_ns, c.host_ns))
        - across(a.host_ns, b.host_ns).saturating_mul(across(a.device_ns, c.device_ns));
    cross > 0
}

#[cfg(test)]
mod tests;
