//! What the rig is doing right now, and who is told.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};

use serde::Serialize;

use crate::sync::GroupReport;

/// Snapshots that wait for a subscriber; a slower one misses some.
const WAITING_SNAPSHOTS: usize = 4;

/// How bad something is right now. No [`lsfb_types::Verdict`]: it changes back and forth many times in a recording, judges nothing that is
/// finished, and a device of which nothing is known yet is as it should be until it is late. The doctor gives the verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Level {
    /// As it should be.
    #[default]
    Ok,
    /// Worth a look; nothing is lost.
    Warn,
    /// Data is being lost, or will be.
    Error,
}

/// Whose clock the stamps of a device follow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "state")]
pub enum SyncState {
    /// Nothing is known yet.
    #[default]
    Unknown,
    /// The device names the second itself: PPS and NMEA, UTC, external time.
    Locked,
    /// It did until it lost its pulse; its own quartz goes on.
    Holdover {
        /// Since when, seconds.
        secs: f64,
    },
    /// Its counter is fitted to arrival.
    Fitted {
        /// Standard deviation of the fitted time, microseconds; the constant part of the transport delay is not in it.
        sigma_us: f64,
        /// Host seconds per device second, less one, parts per million.
        skew_ppm: f64,
        /// How often the counter or the host's clock began anew; 1 is the first time.
        epochs: u32,
    },
}

/// One device now. Counts are since the start of the recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DeviceHealth {
    /// Name of the device, as in the report.
    pub name: String,
    /// How bad it is, and `problem` says why.
    pub level: Level,
    /// The worst that can be said of it now; empty where nothing is wrong.
    pub problem: String,
    /// Whether it is there.
    pub connected: bool,
    /// Packets, frames or messages received.
    pub received: u64,
    /// Samples decoded.
    pub decoded: u64,
    /// Packets that could not be read.
    pub bad: u64,
    /// What its own counters say never arrived.
    pub missing: u64,
    /// Repetitions left out.
    pub duplicated: u64,
    /// Samples dropped because the writer's queue was full.
    pub dropped: u64,
    /// Everything of it that should have been recorded and was not, silences among it.
    pub lost: u64,
    /// Packets per second since the last snapshot.
    pub rate_hz: f64,
    /// Longest silence since the last snapshot, the one that goes on included, seconds.
    pub gap_secs: f64,
    /// What it is expected to send all the time, part by part.
    pub parts: Vec<PartHealth>,
    /// Whose clock its stamps follow.
    pub sync: SyncState,
    /// Exposure time of the last frame, milliseconds.
    pub exposure_ms: Option<f64>,
    /// Share of the last frame's pixels that are saturated, 0–1.
    pub saturated_share: Option<f64>,
    /// Temperature, °C.
    pub temperature_celsius: Option<f64>,
}

/// One thing that a device is expected to send all the time.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PartHealth {
    /// Its name: `data`, `position`, `images`, `samples`, the name of an IMU.
    pub name: String,
    /// How bad it is, and `problem` says why.
    pub level: Level,
    /// What is wrong; empty where nothing is.
    pub problem: String,
    /// How many came in the last second, hertz.
    pub rate_hz: f64,
    /// How many should: by the list of devices, or by its first seconds; `None` before.
    pub nominal_hz: Option<f64>,
    /// How long it has been silent, seconds.
    pub silent_secs: f64,
}

/// The disk and the way to it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StorageHealth {
    /// How bad it is, and `problem` says why.
    pub level: Level,
    /// What is wrong; empty where nothing is.
    pub problem: String,
    /// The file that is being written.
    pub part: String,
    /// Number of that file, from 1.
    pub part_number: u32,
    /// Bytes written in all parts.
    pub written_bytes: u64,
    /// Bytes written per second, over the last seconds.
    pub rate_bytes_per_sec: f64,
    /// Bytes that the disk, and the second one, still take.
    pub free_bytes: u64,
    /// Seconds until there is no room left at this rate, in the first seconds at the rate that was expected; `None` where
    /// nothing is written.
    pub secs_to_full: Option<f64>,
    /// Messages between the devices and the disk.
    pub queued_messages: u64,
    /// Bytes between the devices and the disk.
    pub queued_bytes: u64,
    /// 99 % of the messages were in the file this long after they were queued, milliseconds.
    pub write_p99_ms: f64,
}

/// The whole rig at one moment.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Snapshot {
    /// When, nanoseconds UTC.
    pub time_nanos: i64,
    /// Seconds since the recording began.
    pub elapsed_secs: f64,
    /// One entry per device, in the order of the report.
    pub devices: Vec<DeviceHealth>,
    /// How the cameras' images fit together so far.
    pub groups: GroupReport,
    /// Disk and queue.
    pub storage: StorageHealth,
    /// Everything that should have been recorded and was not, so far.
    pub lost: u64,
    /// The worst of all levels.
    pub level: Level,
}

/// Where [`Snapshot`]s come from: twice a second while a session runs, and at once when something falls silent. Bounded and lossy: no subscriber ever slows the
/// recorder. Clones share their subscribers.
#[derive(Clone, Debug, Default)]
pub struct HealthFeed {
    subscribers: Arc<Mutex<Vec<SyncSender<Snapshot>>>>,
}

impl HealthFeed {
    /// Snapshots from now on; the channel ends with the session.
    pub fn subscribe(&self) -> Receiver<Snapshot> {
        let (sender, receiver) = sync_channel(WAITING_SNAPSHOTS);
        self.subscribers
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(sender);
        receiver
    }

    /// Tells everybody who has room; who has gone is forgotten.
    pub(crate) fn publish(&self, snapshot: &Snapshot) {
        let mut subscribers = self
            .subscribers
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        subscribers.retain(|subscriber| {
            !matches!(
                subscriber.try_send(snapshot.clone()),
                Err(TrySendError::Disconnected(_))
            )
        });
    }

    /// The session is over.
    pub(crate) fn close(&self) {
        self.subscribers
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
    }
}
