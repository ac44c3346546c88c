//! Twice a second, and at once when something falls silent: what the devices and the disk are doing, to whoever asked and into
//! the recording.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use lsfb_recording::message::{self, HealthValue};
use lsfb_types::Timestamp;

use super::arrival::arrival_now;
use super::{
    DeviceHealth, HealthFeed, Level, Meter, Snapshot, StorageHealth, StreamReport, SyncState,
};
use crate::config::DevicesConfig;
use crate::recorder::{
    Entry, OwnMessage, Recorder, RecorderSender, Shared, WritingProgress, free_bytes_of,
};

/// Twice a second, so that nothing is shown later than one second after it happened.
const PERIOD: Duration = Duration::from_millis(500);
/// Weight of the last period in the rate that tells when the disk is full.
const RATE_WEIGHT: f64 = 0.1;
/// Share of the highest rate so far that is forgotten each period, as long as every device sends.
const RATE_FORGOTTEN: f64 = 0.01;
/// The measured rate is believed from here on.
const RATE_KNOWN_AFTER: Duration = Duration::from_secs(5);
/// An operator should know that the disk fills up in ten minutes.
const WARN_SECS: f64 = 600.0;
/// In a minute it is too late for anything but stopping.
const ERROR_SECS: f64 = 60.0;
/// Messages that wait longer than any chunk is kept open say that the disk is too slow.
const WARN_WRITE_MS: f64 = 600.0;

/// Reads the meters.
pub(crate) struct Monitor {
    began: Instant,
    last: Option<Instant>,
    meters: Vec<Meter>,
    /// Which of them had a problem when they were looked at last.
    alarmed: Vec<bool>,
    shared: Shared,
    to_recorder: RecorderSender,
    feed: HealthFeed,
    folders: Vec<PathBuf>,
    reserve_bytes: u64,
    expected_bytes_per_sec: f64,
    last_written_bytes: u64,
    rate_bytes_per_sec: Option<f64>,
    /// What is written when every device sends: a device that fell silent makes no room on the disk, since it may come back.
    full_rate_bytes_per_sec: f64,
    own: StreamReport,
}

impl Monitor {
    pub(crate) fn new(
        recorder: &Recorder,
        meters: Vec<Meter>,
        feed: HealthFeed,
        out: &Path,
        config: &DevicesConfig,
    ) -> Self {
        let expected_bytes_per_sec = config.expected_bytes_per_sec();
        let config = &config.recorder;
        let folder = out.parent().unwrap_or(Path::new("")).to_owned();
        Self {
            began: Instant::now(),
            last: None,
            alarmed: vec![false; meters.len()],
            meters,
            shared: recorder.shared(),
            to_recorder: recorder.sender().dropping(),
            feed,
            folders: [folder]
                .into_iter()
                .chain(config.second_folder.clone())
                .collect(),
            reserve_bytes: config.reserve_bytes,
            expected_bytes_per_sec,
            last_written_bytes: 0,
            rate_bytes_per_sec: None,
            full_rate_bytes_per_sec: 0.0,
            own: StreamReport::new("health"),
        }
    }

    /// Call this often; it works when it is time, or when something new is wrong.
    pub(crate) fn tick(&mut self) {
        let now = Instant::now();
        let since = self.last.unwrap_or(self.began);
        let alarmed: Vec<bool> = self.meters.iter().map(|m| m.watch().is_some()).collect();
        let is_new = alarmed
            .iter()
            .zip(&self.alarmed)
            .any(|(is, was)| *is && !*was);
        self.alarmed = alarmed;
        if is_new || now - since >= PERIOD {
            self.tell(now, now - since);
        }
    }

    /// The last word.
    pub(crate) fn finish(mut self) {
        let now = Instant::now();
        let since = self.last.unwrap_or(self.began);
        self.tell(now, now - since);
    }

    fn tell(&mut self, now: Instant, since_last: Duration) {
        self.last = Some(now);
        let snapshot = self.snapshot(since_last);
        self.record(&snapshot);
        self.feed.publish(&snapshot);
    }

    fn snapshot(&mut self, since_last: Duration) -> Snapshot {
        let devices: Vec<_> = self.meters.iter().map(Meter::read).collect();
        let progress = self.shared.progress();
        let storage = self.storage(&progress, since_last);
        let lost = progress.lost
            + progress.groups.incomplete
            + devices.iter().map(|d| d.lost).sum::<u64>()
            + progress.displaced.len() as u64;
        let level = devices
            .iter()
            .map(|d| d.level)
            .chain([storage.level])
            .max()
            .unwrap_or_default();
        Snapshot {
            time_nanos: arrival_now().nanos(),
            elapsed_secs: self.began.elapsed().as_secs_f64(),
            devices,
            groups: progress.groups,
            storage,
            lost,
            level,
        }
    }

    fn storage(&mut self, progress: &WritingProgress, since_last: Duration) -> StorageHealth {
        let grown = progress
            .written_bytes
            .saturating_sub(self.last_written_bytes);
        self.last_written_bytes = progress.written_bytes;
        let rate = grown as f64 / since_last.as_secs_f64().max(1e-3);
        // A period that an alarm cut short says less.
        let weight = RATE_WEIGHT * (since_last.as_secs_f64() / PERIOD.as_secs_f64()).min(1.0);
        let smooth = self
            .rate_bytes_per_sec
            .map_or(rate, |last| last + weight * (rate - last));
        self.rate_bytes_per_sec = Some(smooth);
        let all_send = !self.alarmed.contains(&true);
        if all_send {
            self.full_rate_bytes_per_sec *= 1.0 - RATE_FORGOTTEN;
        }
        self.full_rate_bytes_per_sec = self.full_rate_bytes_per_sec.max(smooth);
        let free = free_bytes_of(&self.folders, self.reserve_bytes);
        // At first nobody knows better than the list of devices.
        let rate = if self.began.elapsed() < RATE_KNOWN_AFTER {
            self.expected_bytes_per_sec
        } else {
            self.full_rate_bytes_per_sec
        };
        let secs_to_full = (rate > 1.0).then(|| free as f64 / rate);
        let (level, problem) = match secs_to_full {
            _ if !progress.displaced.is_empty() => (Level::Error, progress.displaced.join("; ")),
            Some(secs) if secs < ERROR_SECS => (Level::Error, format!("disk full in {secs:.0} s")),
            Some(secs) if secs < WARN_SECS => {
                let minutes = secs / 60.0;
                (Level::Warn, format!("disk full in {minutes:.0} minutes"))
            }
            _ if progress.write_p99_ms > WARN_WRITE_MS => {
                let ms = progress.write_p99_ms;
                (
                    Level::Warn,
                    format!("the disk is slow: messages wait {ms:.0} ms"),
                )
            }
            _ => (Level::Ok, String::new()),
        };
        StorageHealth {
            level,
            problem,
            part: progress.part.display().to_string(),
            part_number: progress.part_number,
            written_bytes: progress.written_bytes,
            rate_bytes_per_sec: smooth,
            free_bytes: free,
            secs_to_full,
            queued_messages: self.shared.queued_entries(),
            queued_bytes: self.shared.queued_bytes(),
            write_p99_ms: progress.write_p99_ms,
        }
    }

    /// Each quantity on a topic of its own.
    fn record(&mut self, snapshot: &Snapshot) {
        let time = Timestamp::from_nanos(snapshot.time_nanos);
        for device in &snapshot.devices {
            let level = device.level;
            let counted = |count: u64| Some(count as f64);
            let (state, sigma_us) = match device.sync {
                SyncState::Unknown => ("unknown", None),
                SyncState::Locked => ("locked", Some(0.0)),
                SyncState::Holdover { .. } => ("holdover", None),
                SyncState::Fitted { sigma_us, .. } => ("fitted", Some(sigma_us)),
            };
            let values = [
                ("rate", Some(device.rate_hz), device.problem.as_str()),
                ("gap", Some(device.gap_secs), ""),
                (
                    "drops",
                    counted(device.bad + device.missing + device.dropped),
                    "",
                ),
                ("duplicates", counted(device.duplicated), ""),
                ("sync", sigma_us.or(Some(-1.0)), state),
                ("exposure", device.exposure_ms, ""),
                ("saturation", device.saturated_share, ""),
                ("temperature", device.temperature_celsius, ""),
            ];
            for (quantity, value, text) in values {
                if let Some(value) = value {
                    self.put(time, quantity, &device.name, level, value, text);
                }
            }
            self.record_parts(time, device);
        }
        let storage = &snapshot.storage;
        let secs = storage.secs_to_full.unwrap_or(-1.0);
        self.put(time, "space", "disk", storage.level, secs, &storage.problem);
        let queued = storage.queued_bytes as f64;
        self.put(time, "queue", "disk", storage.level, queued, "");
    }

    /// The rate of each part under the device's name and its own: `lidar/data`.
    fn record_parts(&mut self, time: Timestamp, device: &DeviceHealth) {
        for part in &device.parts {
            let name = format!("{}/{}", device.name, part.name);
            self.put(time, "rate", &name, part.level, part.rate_hz, &part.problem);
            self.put(time, "gap", &name, part.level, part.silent_secs, "");
        }
    }

    fn put(
        &mut self,
        time: Timestamp,
        quantity: &str,
        device: &str,
        level: Level,
        value: f64,
        text: &str,
    ) {
        let value = HealthValue {
            device: device.to_owned(),
            value,
            level: level as u8,
            text: text.to_owned(),
        };
        let message = OwnMessage {
            topic: format!("{}{quantity}", lsfb_recording::HEALTH),
            schema: message::HEALTH_VALUE,
            time,
            arrival: time,
            bytes: message::encode_health_value(time, device, &value),
        };
        // A full queue has its own quantity; a writer that has gone reports itself.
        let _ = self.to_recorder.put(Entry::Own(message), &mut self.own);
    }
}
