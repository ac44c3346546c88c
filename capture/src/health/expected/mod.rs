//! What a device is expected to send all the time, part by part: the data of a LiDAR beside its position packets, the images of
//! a camera unit beside its inertial samples. A device whose one part goes on is not alive as a whole.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::{Level, PartHealth};

/// A silence is a problem after this, and after [`SILENT_PERIODS`] of what is expected.
const SILENT: Duration = Duration::from_millis(500);
const SILENT_PERIODS: f64 = 5.0;
/// As long as nobody knows how often a part comes.
const SILENT_UNKNOWN: Duration = Duration::from_millis(900);
/// A silence longer than this, and than what is a problem, has lost data.
const LOST: Duration = Duration::from_secs(1);
/// Devices that end by themselves do not end at the same moment.
const LOST_AT_END: Duration = Duration::from_secs(3);
/// Rates are taken over this time …
const RATE_WINDOW: Duration = Duration::from_secs(1);
/// … in steps of this.
const RATE_STEP: Duration = Duration::from_millis(50);
/// A rate below this share of the one in the list of devices, or of what came in the first seconds, is a problem: half of that is too
/// little …
const SLOW_SHARE: f64 = 0.6;
/// … of parts that come at least this often …
const SLOW_FROM_HZ: f64 = 5.0;
/// … and has lost data after this long.
const SLOW_LOST: Duration = Duration::from_secs(3);
/// A part whose nominal rate nobody knows tells it in this time after it was first heard.
const LEARNING: Duration = Duration::from_secs(3);

/// Something that a device is expected to send all the time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Expected {
    /// Its name: `data`, `images`, the name of an IMU.
    pub(crate) name: String,
    /// How often, hertz, where the list of devices says it.
    pub(crate) nominal_hz: Option<f64>,
    pub(crate) need: Need,
}

/// Whether a part must come at all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Need {
    /// Without it there is nothing to record.
    Required,
    /// Not every model sends it; once it was heard, it is missed.
    OnceHeard,
}

impl Expected {
    pub(crate) fn required(name: &str, nominal_hz: Option<f64>) -> Self {
        Self {
            name: name.to_owned(),
            nominal_hz,
            need: Need::Required,
        }
    }

    pub(crate) fn once_heard(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            nominal_hz: None,
            need: Need::OnceHeard,
        }
    }
}

/// One part of a device, as it comes.
#[derive(Debug)]
pub(in crate::health) struct Part {
    expected: Expected,
    /// Since when it is waited for.
    began: Instant,
    first_heard: Option<Instant>,
    last_heard: Option<Instant>,
    /// Until when its thread has looked for what came: a thread that a busy machine did not run has heard nothing, and missed nothing
    /// that waited in the kernel meanwhile.
    looked: Option<Instant>,
    count: u64,
    /// Counts of the last second.
    steps: VecDeque<Step>,
    learned_hz: Option<f64>,
    slow_since: Option<Instant>,
    /// Whether this slow stretch is counted already.
    slow_counted: bool,
    silences: u64,
    slowdowns: u64,
}

/// What came within [`RATE_STEP`].
#[derive(Clone, Copy, Debug)]
struct Step {
    began: Instant,
    /// When the last of it came, and how many had come until then.
    last: Instant,
    count: u64,
}

/// How a part is doing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Pace {
    Fine,
    /// It has not come yet, and need not.
    Awaited,
    Silent(Duration),
    /// Nobody has looked for so long.
    Unattended(Duration),
    Slow {
        rate_hz: f64,
        nominal_hz: f64,
    },
}

impl Part {
    pub(in crate::health) fn new(expected: Expected, now: Instant) -> Self {
        Self {
            expected,
            began: now,
            first_heard: None,
            last_heard: None,
            looked: None,
            count: 0,
            steps: VecDeque::new(),
            learned_hz: None,
            slow_since: None,
            slow_counted: false,
            silences: 0,
            slowdowns: 0,
        }
    }

    pub(in crate::health) fn name(&self) -> &str {
        &self.expected.name
    }

    /// Its thread has looked for what had come until then.
    pub(in crate::health) fn look(&mut self, at: Instant) {
        self.looked = self.looked.max(Some(at));
    }

    /// So many have come.
    pub(in crate::health) fn hear(&mut self, count: u64, now: Instant) {
        if let Some(silence) = self.silence()
            && silence > self.lost_after()
        {
            self.silences += 1;
        }
        let first = *self.first_heard.get_or_insert(now);
        self.last_heard = Some(now);
        self.count += count;
        match self.steps.back_mut() {
            Some(step) if now.duration_since(step.began) < RATE_STEP => {
                (step.last, step.count) = (now, self.count);
            }
            _ => self.steps.push_back(Step {
                began: now,
                last: now,
                count: self.count,
            }),
        }
        while self
            .steps
            .get(1)
            .is_some_and(|step| now.duration_since(step.began) >= RATE_WINDOW)
        {
            self.steps.pop_front();
        }
        let heard_for = now.duration_since(first);
        if self.learned_hz.is_none() && heard_for >= LEARNING {
            self.learned_hz = Some(self.count as f64 / heard_for.as_secs_f64());
        }
    }

    /// The device was gone and is back, which is counted as such; what lies between is no silence.
    pub(in crate::health) fn restart(&mut self, now: Instant) {
        self.look(now);
        self.last_heard = self.last_heard.map(|_| now);
        self.steps.clear();
        self.slow_since = None;
    }

    /// The device has ended, by itself or not, and what was still expected of this part is missing.
    pub(in crate::health) fn finish(&mut self, ended_by_itself: bool) {
        let most = match ended_by_itself {
            true => LOST_AT_END,
            false => self.lost_after(),
        };
        match self.silence() {
            Some(silence) if silence > most => self.silences += 1,
            // Never, though the device was there.
            None if self.expected.need == Need::Required => self.silences += 1,
            _ => {}
        }
    }

    pub(in crate::health) fn silences(&self) -> u64 {
        self.silences
    }

    pub(in crate::health) fn slowdowns(&self) -> u64 {
        self.slowdowns
    }

    /// Notes how it is doing; asked several times a second.
    pub(in crate::health) fn watch(&mut self, now: Instant) {
        if !matches!(self.pace(now), Pace::Slow { .. }) {
            self.slow_since = None;
            self.slow_counted = false;
            return;
        }
        let since = *self.slow_since.get_or_insert(now);
        if !self.slow_counted && now.duration_since(since) > SLOW_LOST {
            self.slow_counted = true;
            self.slowdowns += 1;
        }
    }

    /// What is wrong with it; `None` where nothing is.
    pub(in crate::health) fn problem(&self, now: Instant) -> Option<String> {
        let name = self.name();
        match self.pace(now) {
            Pace::Fine | Pace::Awaited => None,
            Pace::Silent(silence) => Some(format!(
                "no {name} for {:.1} s: check its cable, power and address",
                silence.as_secs_f64()
            )),
            Pace::Unattended(since) => Some(format!(
                "not read for {:.1} s: this machine is overloaded",
                since.as_secs_f64()
            )),
            Pace::Slow {
                rate_hz,
                nominal_hz,
            } => Some(format!(
                "{name} at {rate_hz:.1} Hz instead of {nominal_hz:.0} Hz"
            )),
        }
    }

    pub(in crate::health) fn health(&self, now: Instant) -> PartHealth {
        let problem = self.problem(now).unwrap_or_default();
        PartHealth {
            name: self.name().to_owned(),
            level: if problem.is_empty() {
                Level::Ok
            } else {
                Level::Error
            },
            problem,
            rate_hz: self.rate_hz(now),
            nominal_hz: self.nominal_hz(),
            silent_secs: self.waited(now).as_secs_f64(),
        }
    }

    fn pace(&self, now: Instant) -> Pace {
        let waited = self.waited(now);
        if self.last_heard.is_none() && self.expected.need == Need::OnceHeard {
            return Pace::Awaited;
        }
        if waited > self.silent_after() {
            let unattended = now.saturating_duration_since(self.looked.unwrap_or(self.began));
            return match unattended > SILENT {
                true => Pace::Unattended(unattended),
                false => Pace::Silent(waited),
            };
        }
        let rate_hz = self.rate_hz(now);
        match self.missed_hz(rate_hz) {
            Some(nominal_hz) if self.is_watched_long_enough(now) => Pace::Slow {
                rate_hz,
                nominal_hz,
            },
            _ => Pace::Fine,
        }
    }

    /// The rate that it should have, where it is far from it.
    fn missed_hz(&self, rate_hz: f64) -> Option<f64> {
        let is_far = |hz: &f64| *hz >= SLOW_FROM_HZ && rate_hz < SLOW_SHARE * hz;
        let said = self.expected.nominal_hz.filter(is_far);
        said.or(self.learned_hz.filter(is_far))
    }

    /// Whether the window of rates is full.
    fn is_watched_long_enough(&self, now: Instant) -> bool {
        let since = self.steps.front().map(|step| step.began);
        since.is_some_and(|since| now.duration_since(since) >= RATE_WINDOW - RATE_STEP)
    }

    fn nominal_hz(&self) -> Option<f64> {
        self.expected.nominal_hz.or(self.learned_hz)
    }

    /// Since it was heard, or since it is waited for.
    fn waited(&self, now: Instant) -> Duration {
        now.saturating_duration_since(self.last_heard.unwrap_or(self.began))
    }

    /// For how long it was looked for in vain since it was heard.
    fn silence(&self) -> Option<Duration> {
        let looked = self.looked?;
        self.last_heard
            .map(|last| looked.saturating_duration_since(last))
    }

    fn silent_after(&self) -> Duration {
        match self.nominal_hz() {
            Some(hz) => {
                // A rate so low that its periods are no time at all is none.
                let periods = Duration::try_from_secs_f64(SILENT_PERIODS / hz);
                SILENT.max(periods.unwrap_or(SILENT_UNKNOWN))
            }
            None => SILENT_UNKNOWN,
        }
    }

    fn lost_after(&self) -> Duration {
        LOST.max(self.silent_after())
    }

    /// Over the last second.
    fn rate_hz(&self, now: Instant) -> f64 {
        // Steps go when others come: of a part that fell silent they are older than the window.
        let is_recent =
            |step: &&Step| now.saturating_duration_since(step.last) <= RATE_WINDOW + RATE_STEP;
        let (Some(first), Some(last)) = (self.steps.iter().find(is_recent), self.steps.back())
        else {
            return 0.0;
        };
        let count = last.count - first.count;
        if count == 0 {
            return 0.0;
        }
        // From one to the next: the next one is not late before a period is over, and until then says nothing about the rate.
        let heard_s = last.last.duration_since(first.last).as_secs_f64();
        let waited_s = now.saturating_duration_since(last.last).as_secs_f64();
        let late_s = (waited_s - heard_s / count as f64).max(0.0);
        count as f64 / (heard_s + late_s).max(RATE_STEP.as_secs_f64())
    }
}

#[cfg(test)]
mod tests;
