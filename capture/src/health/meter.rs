//! What a device's thread says about itself while it runs.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::expected::{Expected, Part};
use lsfb_types::Timestamp;

use super::arrival::arrival_now;
use super::{DeviceHealth, Ending, Level, StreamReport, SyncState};

/// A device of which nothing in particular is expected has a problem when it was heard and is silent for this long.
const SILENT: Duration = Duration::from_millis(1_500);
/// More of a frame than this at full white blinds the features.
const SATURATED_SHARE: f64 = 0.2;
/// Fitted time less certain than this is of little use to anyone.
const SIGMA_US: f64 = 500.0;

/// Shared by a device's thread, which writes, and the monitor, which reads.
#[derive(Clone, Debug)]
pub(crate) struct Meter(Arc<Mutex<MeterState>>);

#[derive(Debug)]
struct MeterState {
    report: StreamReport,
    connected: bool,
    /// Nothing is expected of it any more, or for the time being.
    left: bool,
    ended: bool,
    last_heard: Option<Instant>,
    longest_gap: Duration,
    parts: Vec<Part>,
    last_reading: LastReading,
    sync: SyncState,
    clock_steps: u32,
    exposure_ms: Option<f64>,
    saturated_share: Option<f64>,
    /// Who of several behind it is gone, and since when.
    gone: Option<String>,
    /// What it says again and again, and what to check.
    stale: Option<Cow<'static, str>>,
    /// What it sees too little of, though it goes on.
    partial: Option<String>,
    /// Why its time is not UTC from satellites, though it has a receiver.
    utc: Option<&'static str>,
    temperature_celsius: Option<f64>,
}

/// The state at the last reading.
#[derive(Debug)]
struct LastReading {
    at: Instant,
    received: u64,
    lost: u64,
}

impl Meter {
    /// For a device of which nothing in particular is expected.
    pub(crate) fn new(name: &str) -> Self {
        Self::expecting(name, Vec::new())
    }

    /// For a device that sends these all the time.
    pub(crate) fn expecting(name: &str, expected: Vec<Expected>) -> Self {
        let now = Instant::now();
        let parts = expected.into_iter().map(|part| Part::new(part, now));
        Self(Arc::new(Mutex::new(MeterState {
            report: StreamReport::new(name),
            connected: true,
            left: false,
            ended: false,
            last_heard: None,
            longest_gap: Duration::ZERO,
            parts: parts.collect(),
            last_reading: LastReading {
                at: Instant::now(),
                received: 0,
                lost: 0,
            },
            sync: SyncState::Unknown,
            clock_steps: 0,
            exposure_ms: None,
            saturated_share: None,
            gone: None,
            stale: None,
            partial: None,
            utc: None,
            temperature_celsius: None,
        })))
    }

    fn lock(&self) -> MutexGuard<'_, MeterState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Something arrived, and these are the counts now.
    pub(crate) fn heard(&self, report: &StreamReport, arrival: Timestamp) {
        let mut state = self.lock();
        let now = Instant::now();
        // What waited in a queue of the kernel says what there was to hear when it arrived, and nothing about later.
        let waited = Duration::try_from_secs_f64(arrival_now().secs_since(arrival));
        state.look(now.checked_sub(waited.unwrap_or_default()).unwrap_or(now));
        if let Some(last) = state.last_heard.replace(now) {
            state.longest_gap = state.longest_gap.max(now - last);
        }
        state.take_counts(report);
        state.connected = true;
    }

    /// Its thread looked, and nothing had arrived.
    pub(crate) fn looked(&self) {
        self.lock().look(Instant::now());
    }

    /// So many of a part of it came; a part that nobody expects is passed over.
    pub(crate) fn heard_part(&self, name: &str, count: u64) {
        let mut state = self.lock();
        let now = Instant::now();
        if let Some(part) = state.parts.iter_mut().find(|part| part.name() == name) {
            part.hear(count, now);
        }
    }

    /// Looks at what is expected; asked several times a second. What is wrong with the first part that something is wrong
    /// with.
    pub(crate) fn watch(&self) -> Option<String> {
        let mut state = self.lock();
        if state.ended || !state.connected {
            return None;
        }
        let now = Instant::now();
        state.parts.iter_mut().for_each(|part| part.watch(now));
        state.parts.iter().find_map(|part| part.problem(now))
    }

    /// The counts changed though nothing arrived.
    pub(crate) fn count(&self, report: &StreamReport) {
        self.lock().take_counts(report);
    }

    /// The device's thread has ended, and this is its report; what stayed away is added to it.
    pub(crate) fn end(&self, report: &mut StreamReport) {
        let mut state = self.lock();
        let by_itself = report.ending == Ending::EndOfStream;
        // A device that was never heard, or is gone, is lost as a whole.
        if report.received > 0 && !matches!(report.ending, Ending::Lost(_)) {
            for part in &mut state.parts {
                part.finish(by_itself);
            }
        }
        report.silences = state.parts.iter().map(Part::silences).sum();
        report.slowdowns = state.parts.iter().map(Part::slowdowns).sum();
        for part in &state.parts {
            let (silences, slowdowns) = (part.silences(), part.slowdowns());
            if silences > 0 {
                report.notes.push(format!(
                    "{silences} gaps of more than a second without {}",
                    part.name()
                ));
            }
            if slowdowns > 0 {
                report.notes.push(format!(
                    "{slowdowns} stretches with far too few {}",
                    part.name()
                ));
            }
        }
        state.take_counts(report);
        state.ended = true;
        state.connected = !matches!(report.ending, Ending::Lost(_));
    }

    /// The device is gone, or back.
    pub(crate) fn set_connected(&self, is: Connection) {
        let mut state = self.lock();
        state.connected = is != Connection::Gone;
        state.left = is == Connection::Left;
        let now = Instant::now();
        state.parts.iter_mut().for_each(|part| part.restart(now));
    }

    /// Who of several behind it is gone, and since when; `None`: nobody.
    pub(crate) fn set_gone(&self, problem: Option<String>) {
        self.lock().gone = problem;
    }

    /// Whose clock its stamps follow, and how often that was set since the beginning.
    pub(crate) fn set_sync(&self, sync: SyncState, clock_steps: u32) {
        let mut state = self.lock();
        state.sync = sync;
        state.clock_steps = clock_steps;
    }

    pub(crate) fn set_frame(&self, exposure_ms: f64, saturated_share: f64) {
        let mut state = self.lock();
        state.exposure_ms = Some(exposure_ms);
        state.saturated_share = Some(saturated_share);
    }

    /// What it says again and again, and what to check; `None` while it says something new.
    pub(crate) fn set_stale(&self, problem: Option<Cow<'static, str>>) {
        self.lock().stale = problem;
    }

    /// What it sees too little of; `None` where that is nothing.
    pub(crate) fn set_partial(&self, problem: Option<String>) {
        self.lock().partial = problem;
    }

    /// Why its time is not UTC from satellites; `None` where it is, or nobody knows.
    pub(crate) fn set_utc(&self, problem: Option<&'static str>) {
        self.lock().utc = problem;
    }

    pub(crate) fn set_temperature(&self, celsius: f64) {
        self.lock().temperature_celsius = Some(celsius);
    }

    /// The counts so far.
    pub(crate) fn report(&self) -> StreamReport {
        self.lock().report.clone()
    }

    /// The device since the last reading.
    pub(crate) fn read(&self) -> DeviceHealth {
        let mut state = self.lock();
        let now = Instant::now();
        let silence = state.last_heard.map_or(Duration::ZERO, |last| now - last);
        let gap = state.longest_gap.max(silence);
        let secs = (now - state.last_reading.at).as_secs_f64().max(1e-3);
        let report = &state.report;
        let lost = state.lost();
        let parts = state.parts.iter().map(|part| part.health(now)).collect();
        let (level, problem) = state.judge(silence, lost, now);
        let health = DeviceHealth {
            name: report.name.clone(),
            level,
            problem,
            connected: state.connected,
            received: report.received,
            decoded: report.decoded,
            bad: report.bad,
            missing: report.missing,
            duplicated: report.duplicated,
            dropped: report.dropped,
            lost,
            rate_hz: report.received.saturating_sub(state.last_reading.received) as f64 / secs,
            gap_secs: gap.as_secs_f64(),
            parts,
            sync: state.sync,
            exposure_ms: state.exposure_ms,
            saturated_share: state.saturated_share,
            temperature_celsius: state.temperature_celsius,
        };
        state.last_reading = LastReading {
            at: now,
            received: health.received,
            lost,
        };
        state.longest_gap = Duration::ZERO;
        health
    }
}

/// Whether a device is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Connection {
    There,
    Gone,
    /// It said goodbye and may come back.
    Left,
}

impl MeterState {
    fn look(&mut self, at: Instant) {
        self.parts.iter_mut().for_each(|part| part.look(at));
    }

    fn take_counts(&mut self, report: &StreamReport) {
        let own = &mut self.report;
        own.received = report.received;
        own.decoded = report.decoded;
        own.bad = report.bad;
        own.missing = report.missing;
        own.reordered = report.reordered;
        own.kept_out = report.kept_out;
        own.duplicated = report.duplicated;
        own.dropped = report.dropped;
        own.interruptions = report.interruptions;
        own.silences = report.silences;
        own.slowdowns = report.slowdowns;
        own.stale = report.stale;
    }

    /// Everything that should have been recorded and was not, so far.
    fn lost(&self) -> u64 {
        let stayed_away = match self.ended {
            // The report has them.
            true => 0,
            false => self
                .parts
                .iter()
                .map(|p| p.silences() + p.slowdowns())
                .sum(),
        };
        self.report.counted_lost() + stayed_away
    }

    /// The worst that can be said.
    fn judge(&self, silence: Duration, lost: u64, now: Instant) -> (Level, String) {
        if !self.connected {
            return (
                Level::Error,
                "disconnected: check its cable and power".to_owned(),
            );
        }
        if let Some(gone) = &self.gone {
            return (Level::Error, gone.clone());
        }
        if !self.ended
            && let Some(problem) = self.parts.iter().find_map(|part| part.problem(now))
        {
            return (Level::Error, problem);
        }
        if let Some(stale) = self.stale.as_ref().filter(|_| !self.ended) {
            return (Level::Error, stale.clone().into_owned());
        }
        if self.last_heard.is_none() {
            return (Level::Warn, "no data yet".to_owned());
        }
        if self.parts.is_empty() && silence > SILENT && !self.ended && !self.left {
            let secs = silence.as_secs_f64();
            return (Level::Error, format!("silent for {secs:.1} s"));
        }
        if lost > self.last_reading.lost {
            let now = lost - self.last_reading.lost;
            return (Level::Error, format!("{now} just lost, {lost} in total"));
        }
        if let Some(partial) = self.partial.as_ref().filter(|_| !self.ended) {
            return (Level::Warn, partial.clone());
        }
        if let Some(share) = self.saturated_share.filter(|s| *s > SATURATED_SHARE) {
            let percent = 100.0 * share;
            return (
                Level::Warn,
                format!("{percent:.0} % of the image is overexposed: reduce the exposure"),
            );
        }
        if let SyncState::Holdover { secs } = self.sync {
            return (
                Level::Warn,
                format!("no PPS for {secs:.0} s: check the PPS and NMEA cable"),
            );
        }
        if let SyncState::Fitted { sigma_us, .. } = self.sync
            && sigma_us > SIGMA_US
        {
            return (
                Level::Warn,
                format!("its time is uncertain by {sigma_us:.0} µs"),
            );
        }
        if let Some(utc) = self.utc {
            return (Level::Warn, utc.to_owned());
        }
        if self.clock_steps > 0 {
            let times = match self.clock_steps {
                1 => "once".to_owned(),
                times => format!("{times} times"),
            };
            return (
                Level::Warn,
                format!("its clock, or this machine's, jumped {times}: its time may be off"),
            );
        }
        match lost {
            0 => (Level::Ok, String::new()),
            _ => (Level::Warn, format!("{lost} lost in total")),
        }
    }
}
