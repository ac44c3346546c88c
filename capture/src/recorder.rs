//! The one thread that writes, and the bounded queue before it.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use lsfb_geometry::Rig;
use lsfb_recording::{Channel, Summary, Writer, WriterConfig};
use lsfb_types::{Image, ImuSample, LidarScan, Packet, Stamped, Timestamp};

use crate::config::Overflow;
use crate::health::Health;
use crate::sync::{GroupReport, Groups};
use crate::tap::Spout;
use crate::{Error, StreamReport};

/// Messages between the devices and the disk: two seconds of the whole rig.
const QUEUE_MESSAGES: usize = 512;
/// After this much silence the writer closes its chunk.
const FLUSH_AFTER: Duration = Duration::from_millis(500);

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
        imu: &'static str,
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
        source: &'static str,
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
    },
    /// What became of the devices: the last entry.
    Health(Vec<StreamReport>),
    /// The rig of a device that brings its own.
    Rig { owner: String, rig: Box<Rig> },
}

/// Where device threads put entries.
#[derive(Clone)]
pub(crate) struct Inlet {
    queue: SyncSender<Entry>,
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

    /// Lets a live view look at what passes.
    pub(crate) fn tapped(self, tap: Option<Spout>) -> Self {
        Self { tap, ..self }
    }

    /// Hands an entry to the writer, or drops and counts it. `Err`: the writer is gone, so the device may stop.
    pub(crate) fn put(&self, entry: Entry, report: &mut StreamReport) -> Result<(), WriterGone> {
        if let Some(tap) = &self.tap {
            tap.offer(&entry, report);
        }
        match self.overflow {
            Overflow::Wait => self.queue.send(entry).map_err(|_| WriterGone),
            Overflow::Drop => match self.queue.try_send(entry) {
                Ok(()) => Ok(()),
                Err(TrySendError::Full(_)) => {
                    report.dropped += 1;
                    Ok(())
                }
                Err(TrySendError::Disconnected(_)) => Err(WriterGone),
            },
        }
    }
}

/// The writer failed; its error comes from [`Recorder::finish`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct WriterGone;

/// What the writer made.
pub(crate) struct Written {
    pub(crate) summary: Summary,
    pub(crate) groups: GroupReport,
    pub(crate) lost: u64,
}

/// The writing thread.
pub(crate) struct Recorder {
    thread: JoinHandle<Result<Written, Error>>,
    inlet: Inlet,
}

impl Recorder {
    pub(crate) fn start(
        out: &Path,
        rig: Option<Rig>,
        cameras: Vec<String>,
        overflow: Overflow,
    ) -> Result<Self, Error> {
        let mut writer = Writer::create(out, &WriterConfig::default())?;
        let has_rig = rig.is_some();
        if let Some(rig) = rig {
            writer.attach_rig(&rig)?;
        }
        let (queue, entries) = sync_channel(QUEUE_MESSAGES);
        let sink = WriterThread {
            writer,
            groups: Groups::new(cameras),
            has_rig,
            streams: Vec::new(),
        };
        let thread = spawn("recorder", move || sink.run(&entries))?;
        Ok(Self {
            thread,
            inlet: Inlet {
                queue,
                overflow,
                tap: None,
            },
        })
    }

    pub(crate) fn inlet(&self) -> Inlet {
        self.inlet.clone()
    }

    /// Whether the writer has given up.
    pub(crate) fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Writes what waits and what became of the devices, and closes the file. Every other [`Inlet`] must be gone.
    pub(crate) fn finish(self, streams: &[StreamReport]) -> Result<Written, Error> {
        // A writer that failed says so when it is joined.
        let _ = self.inlet.queue.send(Entry::Health(streams.to_vec()));
        drop(self.inlet);
        join("recorder", self.thread)?
    }
}

struct WriterThread {
    writer: Writer,
    groups: Groups,
    has_rig: bool,
    streams: Vec<StreamReport>,
}

impl WriterThread {
    fn run(mut self, entries: &Receiver<Entry>) -> Result<Written, Error> {
        let mut quiet = false;
        loop {
            match entries.recv_timeout(FLUSH_AFTER) {
                Ok(entry) => {
                    quiet = false;
                    self.write(entry)?;
                }
                // Nothing comes: what is there shall survive a crash. Once is enough.
                Err(RecvTimeoutError::Timeout) if !quiet => {
                    quiet = true;
                    self.writer.flush()?;
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        let groups = self.groups.finish();
        let lost = self.streams.iter().map(StreamReport::lost).sum::<u64>() + groups.incomplete;
        let health = Health {
            streams: &self.streams,
            groups: &groups,
            lost,
        };
        // Numbers and strings always serialise.
        let json = serde_json::to_vec_pretty(&health).unwrap_or_default();
        self.writer
            .attach("health.json", "application/json", &json)?;
        Ok(Written {
            summary: self.writer.finish()?,
            groups,
            lost,
        })
    }

    fn write(&mut self, entry: Entry) -> Result<(), Error> {
        let writer = &mut self.writer;
        match entry {
            Entry::Image {
                camera,
                image,
                trailer,
            } => {
                self.groups.note(&camera, image.time);
                writer.write_image_with_trailer(&camera, &image, &trailer)?;
            }
            Entry::Imu { imu, sample } => writer.write_imu(imu, &sample)?,
            Entry::Scan { scan, packets } => {
                writer.write_velodyne_packets(scan.time, &packets)?;
                writer.write_scan(&scan)?;
            }
            Entry::Packets { time, packets } => writer.write_velodyne_packets(time, &packets)?,
            Entry::Raw {
                source,
                sequence,
                packet,
                time,
            } => writer.write_raw(source, 0, sequence, &packet, time)?,
            Entry::Cdr {
                topic,
                schema_name,
                schema_text,
                time,
                arrival,
                bytes,
            } => {
                let channel = Channel {
                    topic: &topic,
                    schema_name: &schema_name,
                    schema_text: &schema_text,
                };
                writer.write_cdr(&channel, time, arrival, &bytes)?;
            }
            Entry::Rig { owner, rig } if self.has_rig => {
                writer.attach(
                    &format!("sidecar/{owner}/rig.toml"),
                    "application/toml",
                    rig.to_toml().as_bytes(),
                )?;
            }
            Entry::Health(streams) => self.streams = streams,
            Entry::Rig { rig, .. } => {
                self.has_rig = true;
                writer.attach_rig(&rig)?;
            }
        }
        Ok(())
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
