//! A lossy look at what is being recorded, for live views.
//!
//! A [`Tap`] reader gets copies of what the devices hand to the writer. Its queue is bounded and nobody waits for it: what a
//! slow or blocked reader does not take in time is passed over (and counted by [`Tap::missed`]), never copied, and recorded
//! all the same.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use lsfb_types::{Image, ImuSample, LidarScan, Stamped, Timestamp};

use crate::entry::Entry;

/// Most entries that wait for the reader: a second of the whole rig.
const QUEUE_ENTRIES: usize = 512;

/// Something on its way into the recording.
#[derive(Clone, Debug)]
pub enum Tapped {
    /// An image.
    Image {
        /// The camera's name in the rig.
        camera: String,
        /// The image.
        image: Stamped<Image>,
    },
    /// An inertial sample.
    Imu {
        /// The IMU's name in the rig.
        imu: String,
        /// The sample.
        sample: Stamped<ImuSample>,
    },
    /// One revolution of a LiDAR.
    Scan {
        /// The LiDAR's name in the rig.
        lidar: String,
        /// The returns.
        scan: Stamped<LidarScan>,
        /// When they came to the tap, to tell how long they waited since.
        offered: Instant,
    },
    /// A ready-made message, of a sidecar or of the operator.
    Message {
        /// Its topic.
        topic: String,
        /// `package/msg/Type`.
        schema_name: String,
        /// The `ros2msg` definition.
        schema_text: String,
        /// Synchronized time.
        time: Timestamp,
        /// Host receive time.
        arrival: Timestamp,
        /// CDR.
        bytes: Vec<u8>,
    },
}

/// The reading end; see the module's page.
#[derive(Debug)]
pub struct Tap {
    entries: Receiver<Tapped>,
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    waiting: AtomicUsize,
    missed: AtomicU64,
}

impl Tap {
    /// The next entry, waiting up to `timeout`. `None`: nothing yet.
    pub fn next(&self, timeout: Duration) -> Result<Option<Tapped>, TapClosed> {
        match self.entries.recv_timeout(timeout) {
            Ok(entry) => {
                self.shared.waiting.fetch_sub(1, Ordering::AcqRel);
                Ok(Some(entry))
            }
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(TapClosed),
        }
    }

    /// Entries that the reader was too slow for. They are in the recording.
    pub fn missed(&self) -> u64 {
        self.shared.missed.load(Ordering::Relaxed)
    }
}

/// The recording has ended, and every entry was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the recording has ended")]
pub struct TapClosed;

/// Makes both ends.
pub(crate) fn tap() -> (TapSender, Tap) {
    let (queue, entries) = sync_channel(QUEUE_ENTRIES);
    let shared = Arc::new(Shared::default());
    let sender = TapSender {
        entries: queue,
        shared: Arc::clone(&shared),
    };
    (sender, Tap { entries, shared })
}

/// The end that the devices hold, one clone each.
#[derive(Clone, Debug)]
pub(crate) struct TapSender {
    entries: SyncSender<Tapped>,
    shared: Arc<Shared>,
}

impl TapSender {
    /// Copies an entry for the reader if there is room. Never waits.
    pub(crate) fn offer(&self, entry: &Entry) {
        match entry {
            Entry::Image { camera, image, .. } => self.put(|| Tapped::Image {
                camera: camera.clone(),
                image: image.clone(),
            }),
            Entry::Imu { imu, sample } => self.put(|| Tapped::Imu {
                imu: imu.clone(),
                sample: sample.clone(),
            }),
            Entry::Scan { lidar, scan, .. } => self.put(|| Tapped::Scan {
                lidar: lidar.clone(),
                scan: scan.clone(),
                offered: Instant::now(),
            }),
            Entry::Cdr {
                topic,
                schema_name,
                schema_text,
                time,
                arrival,
                bytes,
                ..
            } => self.put(|| Tapped::Message {
                topic: topic.clone(),
                schema_name: schema_name.clone(),
                schema_text: schema_text.clone(),
                time: *time,
                arrival: *arrival,
                bytes: bytes.clone(),
            }),
            _ => {}
        }
    }

    fn put(&self, entry: impl FnOnce() -> Tapped) {
        // A place is taken before the copy is made, so that a full queue costs one addition.
        if self.shared.waiting.fetch_add(1, Ordering::AcqRel) >= QUEUE_ENTRIES
            || self.entries.try_send(entry()).is_err()
        {
            self.shared.waiting.fetch_sub(1, Ordering::AcqRel);
            self.shared.missed.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn imu_entry(n: i64) -> Entry {
        let time = Timestamp::from_nanos(n);
        Entry::Imu {
            imu: "imu0".to_owned(),
            sample: Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: ImuSample::default(),
            },
        }
    }

    #[test]
    fn a_full_tap_passes_over_and_a_read_one_goes_on() {
        let (sender, tap) = tap();
        for n in 0..2_000 {
            sender.offer(&imu_entry(n));
        }
        assert!(tap.missed() >= 2_000 - QUEUE_ENTRIES as u64);
        let mut read = 0;
        while tap.next(Duration::ZERO).unwrap().is_some() {
            read += 1;
        }
        assert_eq!(read, QUEUE_ENTRIES);
        let missed = tap.missed();
        sender.offer(&imu_entry(7));
        let entry = tap.next(Duration::ZERO).unwrap();
        assert!(
            matches!(&entry, Some(Tapped::Imu { sample, .. }) if sample.time.nanos() == 7),
            "{entry:?}"
        );
        assert_eq!(tap.missed(), missed);
        drop(sender);
        assert_eq!(tap.next(Duration::ZERO).unwrap_err(), TapClosed);
    }

    #[test]
    fn a_tap_whose_reader_is_gone_costs_nothing() {
        let (sender, tap) = tap();
        drop(tap);
        for n in 0..2_000 {
            sender.offer(&imu_entry(n));
        }
        assert_eq!(sender.shared.waiting.load(Ordering::Relaxed), 0);
    }
}
