//! What a device's thread says about itself while it runs.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::{DeviceHealth, Ending, Level, StreamReport, SyncState};

/// A device that was heard and is silent for this long has a problem.
const SILENT: Duration = Duration::from_millis(1_500);
/// More of a frame than this at full white blinds the features.
const SATURATED_SHARE: f64 = 0.2;
/// Fitted time less certain than this is of little use to anyone.
const SIGMA_US: f64 = 500.0;

/// Shared by a device's thread, which writes, and the monitor, which reads.
#[derive(Clone, Debug)]
pub(crate) struct Meter(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    report: StreamReport,
    connected: bool,
    ended: bool,
    last_heard: Option<Instant>,
    longest_gap: Duration,
    last_seen: Seen,
    sync: SyncState,
    clock_steps: u32,
    exposure_ms: Option<f64>,
    saturated_share: Option<f64>,
    temperature_celsius: Option<f64>,
}

/// The state at the last reading.
#[derive(Debug)]
struct Seen {
    at: Instant,
    received: u64,
    lost: u64,
}

impl Meter {
    pub(crate) fn new(name: &str) -> Self {
        Self(Arc::new(Mutex::new(State {
            report: StreamReport::new(name),
            connected: true,
            ended: false,
            last_heard: None,
            longest_gap: Duration::ZERO,
            last_seen: Seen {
                at: Instant::now(),
                received: 0,
                lost: 0,
            },
            sync: SyncState::Unknown,
            clock_steps: 0,
            exposure_ms: None,
            saturated_share: None,
            temperature_celsius: None,
        })))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Something arrived, and these are the counts now.
    pub(crate) fn heard(&self, report: &StreamReport) {
        let mut state = self.lock();
        let now = Instant::now();
        if let Some(last) = state.last_heard.replace(now) {
            state.longest_gap = state.longest_gap.max(now - last);
        }
        state.take_counts(report);
        state.connected = true;
    }

    /// The counts changed though nothing arrived.
    pub(crate) fn count(&self, report: &StreamReport) {
        self.lock().take_counts(report);
    }

    /// The device's thread has ended, and this is its report.
    pub(crate) fn end(&self, report: &StreamReport) {
        let mut state = self.lock();
        state.take_counts(report);
        state.ended = true;
        state.connected = !matches!(report.ending, Ending::Lost(_));
    }

    /// The device is gone, or back.
    pub(crate) fn set_connected(&self, is: Connection) {
        self.lock().connected = is == Connection::There;
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
        let secs = (now - state.last_seen.at).as_secs_f64().max(1e-3);
        let report = &state.report;
        let lost = report.bad + report.missing + report.dropped + report.interruptions;
        let (level, problem) = state.judge(silence, lost);
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
            rate_hz: report.received.saturating_sub(state.last_seen.received) as f64 / secs,
            gap_secs: gap.as_secs_f64(),
            sync: state.sync,
            exposure_ms: state.exposure_ms,
            saturated_share: state.saturated_share,
            temperature_celsius: state.temperature_celsius,
        };
        state.last_seen = Seen {
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
}

impl State {
    fn take_counts(&mut self, report: &StreamReport) {
        let own = &mut self.report;
        own.received = report.received;
        own.decoded = report.decoded;
        own.bad = report.bad;
        own.missing = report.missing;
        own.duplicated = report.duplicated;
        own.dropped = report.dropped;
        own.interruptions = report.interruptions;
    }

    /// The worst that can be said.
    fn judge(&self, silence: Duration, lost: u64) -> (Level, String) {
        if !self.connected {
            return (Level::Error, "gone: check its cable and power".to_owned());
        }
        if self.last_heard.is_none() {
            return (Level::Warn, "has sent nothing yet".to_owned());
        }
        if silence > SILENT && !self.ended {
            let secs = silence.as_secs_f64();
            return (Level::Error, format!("silent for {secs:.1} s"));
        }
        if lost > self.last_seen.lost {
            let now = lost - self.last_seen.lost;
            return (Level::Error, format!("{now} lost just now, {lost} in all"));
        }
        if let Some(share) = self.saturated_share.filter(|s| *s > SATURATED_SHARE) {
            let percent = 100.0 * share;
            return (
                Level::Warn,
                format!("{percent:.0} % of the image is white: lower the exposure"),
            );
        }
        if let SyncState::Holdover { secs } = self.sync {
            return (
                Level::Warn,
                format!("without pulse for {secs:.0} s: check the PPS and NMEA cable"),
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
        if self.clock_steps > 0 {
            let times = self.clock_steps;
            return (
                Level::Warn,
                format!("its clock, or this machine's, was set {times} times: its time may be off"),
            );
        }
        match lost {
            0 => (Level::Ok, String::new()),
            _ => (Level::Warn, format!("{lost} lost in all")),
        }
    }
}
