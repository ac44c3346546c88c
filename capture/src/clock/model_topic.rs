//! A device's clock model as a topic of the recording.

use lsfb_recording::CLOCK_MODELS;
use lsfb_recording::message::{self, ClockModel};
use lsfb_types::Timestamp;

use super::ClockEstimate;
use crate::health::SyncState;
use crate::recorder::{Entry, OwnMessage};

/// Kind of a model whose device names the second itself.
pub(crate) const LOCKED: &str = "locked";
/// Kind of a model whose device named the second until its pulse was lost.
pub(crate) const HOLDOVER: &str = "holdover";
/// Kind of a model made of exchanges of times with the device.
pub(crate) const EXCHANGED: &str = "exchanged";
const FITTED: &str = "fitted";

/// Whether a device of such a model names the second itself, or did until its pulse was lost.
pub(crate) fn names_the_second(kind: &str) -> bool {
    [LOCKED, HOLDOVER].contains(&kind)
}

/// What a quartz may have run away since.
const HOLDOVER_SKEW: f64 = 20e-6;
/// Spacing of the models.
const PERIOD_NS: i64 = 1_000_000_000;
/// A device that names the second does so to the microsecond.
const LOCKED_SIGMA_NS: f64 = 1_000.0;

/// How a device's stamps are made at the moment.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Reading {
    /// The device itself says what time it is; `epoch` counts how often it was told another, from 1.
    Locked {
        device_ns: i64,
        time: Timestamp,
        epoch: u32,
    },
    /// It did until `since`, and its quartz goes on.
    Holdover {
        device_ns: i64,
        time: Timestamp,
        since: Timestamp,
        epoch: u32,
    },
    /// Its counter is fitted to arrival.
    Fitted(ClockEstimate),
}

impl Reading {
    /// How often the counter, or what it is compared with, was set.
    pub(crate) fn steps(&self) -> u32 {
        let epoch = match self {
            Self::Locked { epoch, .. } | Self::Holdover { epoch, .. } => *epoch,
            Self::Fitted(estimate) => estimate.epoch,
        };
        epoch.saturating_sub(1)
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Locked { .. } => LOCKED,
            Self::Holdover { .. } => HOLDOVER,
            Self::Fitted(_) => FITTED,
        }
    }

    /// The same for the operator.
    pub(crate) fn sync_state(&self) -> SyncState {
        match self {
            Self::Locked { .. } => SyncState::Locked,
            Self::Holdover { time, since, .. } => SyncState::Holdover {
                secs: time.secs_since(*since),
            },
            Self::Fitted(estimate) => SyncState::Fitted {
                sigma_us: estimate.sigma_ns / 1e3,
                skew_ppm: estimate.skew * 1e6,
                epochs: estimate.epoch,
            },
        }
    }
}

/// Says once a second how a device's clock is read.
#[derive(Clone, Debug)]
pub(crate) struct ModelTopic {
    device: String,
    tick_ns: u64,
    period_ticks: u64,
    /// Arrival and kind of the last one.
    last: Option<(Timestamp, &'static str)>,
}

impl ModelTopic {
    /// `period_ticks`: 0 where the counter does not wrap.
    pub(crate) fn new(device: &str, tick_ns: u64, period_ticks: u64) -> Self {
        Self {
            device: device.to_owned(),
            tick_ns,
            period_ticks,
            last: None,
        }
    }

    /// Whether it is time for another, at `arrival`: a lock that is lost for less than a second is told too.
    pub(crate) fn is_due(&self, reading: &Reading, arrival: Timestamp) -> bool {
        self.last.is_none_or(|(last, kind)| {
            kind != reading.kind() || (arrival - last).abs() >= PERIOD_NS
        })
    }

    /// The model as an entry of the recording.
    pub(crate) fn entry(
        &mut self,
        reading: &Reading,
        time: Timestamp,
        arrival: Timestamp,
    ) -> Entry {
        self.last = Some((arrival, reading.kind()));
        let model = match reading {
            Reading::Locked {
                device_ns,
                time,
                epoch,
            } => ClockModel {
                kind: reading.kind().to_owned(),
                epoch: *epoch,
                reference_device_ns: *device_ns,
                reference_time_ns: time.nanos(),
                sigma_ns: LOCKED_SIGMA_NS,
                ..self.blank()
            },
            Reading::Holdover {
                device_ns,
                time,
                since,
                epoch,
            } => ClockModel {
                kind: reading.kind().to_owned(),
                epoch: *epoch,
                reference_device_ns: *device_ns,
                reference_time_ns: time.nanos(),
                sigma_ns: LOCKED_SIGMA_NS + HOLDOVER_SKEW * (*time - *since).max(0) as f64,
                sigma_skew: HOLDOVER_SKEW,
                ..self.blank()
            },
            Reading::Fitted(estimate) => ClockModel {
                kind: reading.kind().to_owned(),
                epoch: estimate.epoch,
                reference_device_ns: estimate.reference_device_ns,
                reference_time_ns: estimate.reference_time.nanos(),
                skew: estimate.skew,
                sigma_ns: estimate.sigma_ns,
                sigma_skew: estimate.sigma_skew,
                pairs: estimate.pairs,
                ..self.blank()
            },
        };
        let message = OwnMessage {
            topic: format!("{CLOCK_MODELS}{}", self.device),
            schema: message::CLOCK_MODEL,
            time,
            arrival,
            bytes: message::encode_clock_model(time, &self.device, &model),
        };
        Entry::ClockModel {
            device: self.device.clone(),
            message,
        }
    }

    fn blank(&self) -> ClockModel {
        ClockModel {
            device: self.device.clone(),
            tick_ns: self.tick_ns,
            period_ticks: self.period_ticks,
            ..ClockModel::default()
        }
    }
}
