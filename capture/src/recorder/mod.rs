//! The bounded queue between the devices and the one thread that writes.

mod disk_sync;
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

use lsfb_drivers::phone::Receipt;
use lsfb_geometry::Rig;
use lsfb_recording::message::{self, Schema};
use lsfb_recording::{Attachment, LAST_STAMP, Summary};
use lsfb_types::{Image, ImuSample, LidarScan, Packet, Stamped, Timestamp};

use crate::config::{Overflow, RecorderConfig};
use crate::sync::{Group, GroupReport, Groups};
use crate::tap::Spout;
use crate::{Error, StreamReport};

pub(crate) use space::{check as check_space, free_bytes_of};

/// Entries in the queue, whatever their size: some seconds of IMU and LiDAR.
const QUEUE_ENTRIES: usize = 8_192;
/// How often a device that may wait looks whether there is room.
const ROOM_POLL: Duration = Duration::from_millis(1);
/// What a queued entry takes beside its payload.
const ENTRY_BYTES: u64 = 256;
/// Bytes of a point in memory.
const POINT_BYTES: u64 = 24;

/// One thing to be recorded.
pub(crate) enum Entry {
    /// An image and the trailer it came with.
    Image {
        camera: String,
        image: Stamped<Image>,
        trailer: Vec<u8>,
    },
    /// An inertial sample.
    Imu {
        imu: String,
        sample: Stamped<ImuSample>,
    },
    /// A revolution: its packets as received, and the points.
    Scan {
        scan: Stamped<LidarScan>,
        packets: Vec<Packet>,
    },
    /// Packets that completed no scan.
    Packets {
        time: Timestamp,
        packets: Vec<Packet>,
    },
    /// Bytes as received.
    Raw {
        source: String,
        /// The driver's numbering of its traffic.
        kind: u16,
        sequence: u64,
        packet: Packet,
        time: Timestamp,
    },
    /// A ready-made message of a sidecar.
    Cdr {
        topic: String,
        schema_name: String,
        schema_text: String,
        time: Timestamp,
        arrival: Timestamp,
        bytes: Vec<u8>,
        /// Given back when the message is in the file.
        receipt: Option<Receipt>,
    },
    /// A message of a sidecar that is not recorded; its sender may forget it when those before it are in the file.
    Skipped(Receipt),
    /// A file for this part and all that follow.
    Attachment(Attachment),
    /// The rig of a device that brings its own.
    Rig { owner: String, rig: Box<Rig> },
    /// What the recorder says itself.
    Own(OwnMessage),
    /// How a device's clock is read; repeated at the start of each part.
    ClockModel { device: String, message: OwnMessage },
    /// What became of the devices: the last entry.
    Ended(Vec<StreamReport>),
}

impl Entry {
    /// Memory it holds, about.
    fn bytes(&self) -> u64 {
        let payload = match self {
            Self::Image { image, trailer, .. } => image.sample.pixels.len() + trailer.len(),
            Self::Scan { scan, packets } => {
                return ENTRY_BYTES
                    + packets.iter().map(packet_bytes).sum::<u64>()
                    + scan.sample.points.len() as u64 * POINT_BYTES;
            }
            Self::Packets { packets, .. } => {
                return ENTRY_BYTES + packets.iter().map(packet_bytes).sum::<u64>();
            }
            Self::Raw { packet, .. } => packet.bytes.len(),
            Self::Cdr { bytes, .. } => bytes.len(),
            Self::Attachment(attachment) => attachment.bytes.len(),
            Self::Own(message) | Self::ClockModel { message, .. } => message.bytes.len(),
            Self::Imu { .. } | Self::Skipped(_) | Self::Rig { .. } | Self::Ended(_) => 0,
        };
        payload as u64 + ENTRY_BYTES
    }
}

/// Stamps of an entry that may be those of a device.
struct Stamps<'a> {
    time: &'a mut Timestamp,
    arrival: Timestamp,
}

impl Entry {
    fn stamps(&mut self) -> Option<Stamps<'_>> {
        let (time, arrival) = match self {
            Self::Image { image, .. } => (&mut image.time, image.arrival),
            Self::Imu { sample, .. } => (&mut sample.time, sample.arrival),
            Self::Scan { scan, .. } => (&mut scan.time, scan.arrival),
            Self::Raw { time, packet, .. } => (time, packet.arrival),
            Self::Cdr { time, arrival, .. } => (time, *arrival),
            Self::Own(message) | Self::ClockModel { message, .. } => {
                (&mut message.time, message.arrival)
            }
            Self::Packets { .. }
            | Self::Skipped(_)
            | Self::Attachment(_)
            | Self::Rig { .. }
            | Self::Ended(_) => return None,
        };
        Some(Stamps { time, arrival })
    }

    /// Gives a time that no recording can hold up for that of arrival: one device that names an impossible year must not
    /// end the recording of all. The time that was given up.
    fn give_up_impossible_time(&mut self) -> Option<Timestamp> {
        let can_be_written = |time: Timestamp| (Timestamp::default()..=LAST_STAMP).contains(&time);
        let Stamps { time, arrival } = self.stamps()?;
        if can_be_written(*time) || !can_be_written(arrival) {
            return None;
        }
        Some(std::mem::replace(time, arrival))
    }
}

fn packet_bytes(packet: &Packet) -> u64 {
    packet.bytes.len() as u64 + 32
}

/// A message of the recorder's own.
#[derive(Clone, Debug)]
pub(crate) struct OwnMessage {
    pub(crate) topic: String,
    pub(crate) schema: Schema,
    pub(crate) time: Timestamp,
    pub(crate) arrival: Timestamp,
    pub(crate) bytes: Vec<u8>,
}

impl OwnMessage {
    fn camera_group(group: &Group) -> Self {
        let content = message::CameraGroup {
            trigger: group.trigger,
            expected: group.expected,
            present: group.present,
            missing: group.missing.join(" "),
        };
        Self {
            topic: lsfb_recording::CAMERA_GROUPS.to_owned(),
            schema: message::CAMERA_GROUP,
            time: group.time,
            arrival: group.arrival,
            bytes: message::encode_camera_group(group.time, "rig", &content),
        }
    }
}

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
pub(crate) struct Inlet {
    queue: SyncSender<Queued>,
    shared: Shared,
    limit_bytes: u64,
    overflow: Overflow,
    tap: Option<Spout>,
}

impl Inlet {
    /// For a device whose protocol makes the other side wait, so that nothing ever needs to be dropped.
    pub(crate) fn patient(&self) -> Self {
        Self {
            overflow: Overflow::Wait,
            ..self.clone()
        }
    }

    /// For what may be missing rather than make anybody wait.
    pub(crate) fn impatient(self) -> Self {
        Self {
            overflow: Overflow::Drop,
            ..self
        }
    }

    /// Lets a live view look at what passes.
    pub(crate) fn tapped(self, tap: Option<Spout>) -> Self {
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
                format!("it said {time} s, which no recording can hold: its time of arrival is written; check its clock")
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
}

/// The writing thread.
pub(crate) struct Recorder {
    thread: JoinHandle<Result<Written, Error>>,
    inlet: Inlet,
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
        let inlet = Inlet {
            queue,
            shared,
            limit_bytes: config.queue_bytes,
            overflow,
            tap: None,
        };
        Ok(Self { thread, inlet })
    }

    pub(crate) fn inlet(&self) -> Inlet {
        self.inlet.clone()
    }

    pub(crate) fn shared(&self) -> Shared {
        self.inlet.shared.clone()
    }

    /// Whether the writer has given up.
    pub(crate) fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Writes what waits and what became of the devices, and closes the file. Every other [`Inlet`] must be gone.
    pub(crate) fn finish(self, streams: &[StreamReport]) -> Result<Written, Error> {
        // A writer that failed says so when it is joined.
        let ended = Entry::Ended(streams.to_vec());
        let _ = self
            .inlet
            .patient()
            .put(ended, &mut StreamReport::default());
        drop(self.inlet);
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
