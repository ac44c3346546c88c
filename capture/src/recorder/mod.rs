//! The bounded queue between the devices and the one thread that writes.

mod disk_sync;
mod displacement;
mod latency;
mod parts;
mod space;
mod writing;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use lsfb_geometry::Rig;
use lsfb_recording::Summary;

use crate::Error;
use crate::config::{Overflow, RecorderConfig};
use crate::report::{CaptureReport, StreamReport};
use crate::sync::{GroupReport, Groups};
use crate::tap::TapSender;

pub(crate) use crate::entry::{Entry, OwnMessage};
pub use latency::Latencies;

pub(crate) use parts::parts_of;
pub(crate) use space::{check as check_space, free_bytes_of};

/// Entries in the queue, whatever their size: some seconds of IMU and LiDAR.
const QUEUE_ENTRIES: usize = 8_192;
/// How often a device that may wait looks whether there is room.
const ROOM_POLL: Duration = Duration::from_millis(1);
/// An entry on its way.
pub(crate) struct Queued {
    entry: Entry,
    at: Instant,
    bytes: u64,
}

/// Where the writing thread is.
#[derive(Clone, Debug, Default)]
pub(crate) struct WritingProgress {
    pub(crate) written_bytes: u64,
    pub(crate) part_number: u32,
    pub(crate) part: PathBuf,
    pub(crate) groups: GroupReport,
    pub(crate) lost: u64,
    /// What became of files that were taken away while they were written.
    pub(crate) displaced: Vec<String>,
    pub(crate) write_p99_ms: f64,
}

/// What the devices, the writing thread and the monitor share.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shared {
    queued_bytes: Arc<AtomicU64>,
    queued_entries: Arc<AtomicU64>,
    progress: Arc<Mutex<WritingProgress>>,
}

impl Shared {
    fn entered(&self, bytes: u64) {
        self.queued_bytes.fetch_add(bytes, Ordering::Relaxed);
        self.queued_entries.fetch_add(1, Ordering::Relaxed);
    }

    fn left(&self, bytes: u64) {
        self.queued_bytes.fetch_sub(bytes, Ordering::Relaxed);
        self.queued_entries.fetch_sub(1, Ordering::Relaxed);
    }

    fn show(&self, progress: WritingProgress) {
        *self.progress.lock().unwrap_or_else(PoisonError::into_inner) = progress;
    }

    pub(crate) fn queued_bytes(&self) -> u64 {
        self.queued_bytes.load(Ordering::Relaxed)
    }

    pub(crate) fn queued_entries(&self) -> u64 {
        self.queued_entries.load(Ordering::Relaxed)
    }

    pub(crate) fn progress(&self) -> WritingProgress {
        self.progress
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

/// Where device threads put entries.
#[derive(Clone)]
pub(crate) struct RecorderSender {
    queue: SyncSender<Queued>,
    shared: Shared,
    limit_bytes: u64,
    overflow: Overflow,
    tap: Option<TapSender>,
}

impl RecorderSender {
    /// For a device whose protocol makes the other side wait, so that nothing ever needs to be dropped.
    pub(crate) fn waiting(&self) -> Self {
        Self {
            overflow: Overflow::Wait,
            ..self.clone()
        }
    }

    /// For what may be missing rather than make anybody wait.
    pub(crate) fn dropping(self) -> Self {
        Self {
            overflow: Overflow::Drop,
            ..self
        }
    }

    /// Lets a live view look at what passes.
    pub(crate) fn tapped(self, tap: Option<TapSender>) -> Self {
        Self { tap, ..self }
    }

    /// Hands an entry to the writer, or drops and counts it. `Err`: the writer is gone, so the device may stop.
    pub(crate) fn put(
        &self,
        mut entry: Entry,
        report: &mut StreamReport,
    ) -> Result<(), WriterGone> {
        if let Some(time) = entry.give_up_impossible_time() {
            report.bad += 1;
            report.first_bad.get_or_insert_with(|| {
                format!("it sent the time {time} s, which a recording cannot hold: its arrival time is written instead; check its clock")
            });
        }
        if let Some(tap) = &self.tap {
            tap.offer(&entry);
        }
        let bytes = entry.bytes();
        let mut queued = Queued {
            entry,
            at: Instant::now(),
            bytes,
        };
        loop {
            let waiting = self.shared.queued_bytes();
            // An entry larger than the whole queue still goes through an empty one.
            let fits = waiting == 0 || waiting + bytes <= self.limit_bytes;
            if fits {
                self.shared.entered(bytes);
                match self.queue.try_send(queued) {
                    Ok(()) => return Ok(()),
                    Err(TrySendError::Full(back)) => {
                        self.shared.left(bytes);
                        queued = back;
                    }
                    Err(TrySendError::Disconnected(_)) => {
                        self.shared.left(bytes);
                        return Err(WriterGone);
                    }
                }
            }
            match self.overflow {
                Overflow::Drop => {
                    report.dropped += 1;
                    return Ok(());
                }
                Overflow::Wait => std::thread::sleep(ROOM_POLL),
            }
        }
    }
}

/// The writer failed; its error comes from [`Recorder::finish`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct WriterGone;

/// What the writer made.
pub(crate) struct Written {
    pub(crate) parts: Vec<Summary>,
    pub(crate) groups: GroupReport,
    pub(crate) lost: u64,
    pub(crate) failure: Option<String>,
    pub(crate) warnings: Vec<String>,
    pub(crate) write_p99_ms: f64,
    pub(crate) write_longest_ms: f64,
}

impl Written {
    /// Removes what was written: half an import is of no use, and looks whole.
    pub(crate) fn discard(&self) {
        for part in &self.parts {
            // Somebody else may have been faster.
            let _ = std::fs::remove_file(&part.path);
        }
    }

    pub(crate) fn report(self, out: &Path, streams: Vec<StreamReport>) -> CaptureReport {
        CaptureReport {
            path: out.to_owned(),
            parts: self.parts.iter().map(|p| p.path.clone()).collect(),
            bytes: self.parts.iter().map(|p| p.bytes).sum(),
            messages: self.parts.iter().map(|p| p.messages).sum(),
            streams,
            groups: self.groups,
            // A recording that ended by itself has lost what came after, however much that is.
            lost: self.lost + u64::from(self.failure.is_some()),
            failure: self.failure,
            warnings: self.warnings,
            write_p99_ms: self.write_p99_ms,
            write_longest_ms: self.write_longest_ms,
        }
    }
}

/// The writing thread.
pub(crate) struct Recorder {
    thread: JoinHandle<Result<Written, Error>>,
    to_recorder: RecorderSender,
}

impl Recorder {
    /// `cameras`: the names of each unit's cameras, unit by unit.
    pub(crate) fn start(
        out: &Path,
        rig: Option<Rig>,
        cameras: &[Vec<String>],
        config: &RecorderConfig,
        overflow: Overflow,
    ) -> Result<Self, Error> {
        config.check_bounds("recorder")?;
        let parts = parts::Parts::create(out, config, rig)?;
        let (queue, entries) = sync_channel(QUEUE_ENTRIES);
        let shared = Shared::default();
        let writing = writing::Writing::new(parts, Groups::new(cameras), shared.clone());
        let thread = spawn("recorder", move || writing.run(&entries))?;
        let to_recorder = RecorderSender {
            queue,
            shared,
            limit_bytes: config.queue_bytes,
            overflow,
            tap: None,
        };
        Ok(Self {
            thread,
            to_recorder,
        })
    }

    /// The rig's poses follow: to be called before any other entry is put.
    pub(crate) fn expect_odometry(&self) {
        // A writer that is gone reports itself.
        let _ = self
            .to_recorder
            .waiting()
            .put(Entry::OdometryFollows, &mut StreamReport::default());
    }

    pub(crate) fn sender(&self) -> RecorderSender {
        self.to_recorder.clone()
    }

    pub(crate) fn shared(&self) -> Shared {
        self.to_recorder.shared.clone()
    }

    /// Whether the writer has given up.
    pub(crate) fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Writes what waits and what became of the devices, and closes the file. Every other [`RecorderSender`] must be gone.
    pub(crate) fn finish(self, streams: &[StreamReport]) -> Result<Written, Error> {
        // A writer that failed says so when it is joined.
        let ended = Entry::Ended(streams.to_vec());
        let _ = self
            .to_recorder
            .waiting()
            .put(ended, &mut StreamReport::default());
        drop(self.to_recorder);
        join("recorder", self.thread)?
    }
}

/// A named thread.
pub(crate) fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, Error> {
    let failed = |e: std::io::Error| Error::Thread {
        name: name.to_owned(),
        message: e.to_string(),
    };
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(work)
        .map_err(failed)
}

/// What a thread returned.
pub(crate) fn join<T>(name: &str, thread: JoinHandle<T>) -> Result<T, Error> {
    thread.join().map_err(|_| Error::Thread {
        name: name.to_owned(),
        message: "ended in a panic; please report this".to_owned(),
    })
}

/// Folder of a recording that does not exist yet is made with it.
pub(crate) fn make_folder(out: &Path) -> Result<(), Error> {
    match out.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => {
            std::fs::create_dir_all(folder).map_err(|cause| Error::Io {
                path: PathBuf::from(folder),
                cause,
            })
        }
        _ => Ok(()),
    }
}
