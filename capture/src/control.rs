//! What the threads of a session share: whether it stops, who is left, and what was handled.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::health::{Connection, Meter};
use crate::report::StreamReport;

/// Between two attempts to open a device that is gone.
const REOPEN: Duration = Duration::from_millis(500);
/// How often it is looked whether the session stops.
pub(crate) const POLL: Duration = Duration::from_millis(20);

/// What device threads share.
#[derive(Debug)]
pub(crate) struct Control {
    stop: AtomicBool,
    /// Devices that end by themselves and have not ended yet.
    running: AtomicUsize,
    /// How many of them there were.
    finite: usize,
    /// LiDARs that were heard lately.
    live_lidars: AtomicUsize,
    pub(crate) progress: Counts,
}

impl Control {
    /// For a session with so many devices that end by themselves. A LiDAR alone runs until it is stopped.
    pub(crate) fn of(finite: usize, progress: Counts) -> Self {
        Self {
            stop: AtomicBool::new(false),
            running: AtomicUsize::new(if finite == 0 { usize::MAX } else { finite }),
            finite,
            live_lidars: AtomicUsize::new(0),
            progress,
        }
    }

    /// For streams that no session runs.
    pub(crate) fn alone() -> Self {
        let control = Self::of(1, Counts::default());
        control.leave();
        control
    }

    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// A device that ends by itself has ended, or waits for somebody who may not come.
    pub(crate) fn leave(&self) {
        self.running.fetch_sub(1, Ordering::Relaxed);
    }

    /// It is back.
    pub(crate) fn come_back(&self) {
        self.running.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether there is nothing left to record: all others have ended, and the LiDAR is silent.
    pub(crate) fn nothing_is_left(&self) -> bool {
        self.others_ended() && self.live_lidars.load(Ordering::Relaxed) == 0
    }

    pub(crate) fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Whether no device is left that says when it ends. A LiDAR alone never ends by itself.
    pub(crate) fn others_ended(&self) -> bool {
        self.running.load(Ordering::Relaxed) == 0
    }

    /// Whether of several devices one is left, and the LiDAR is silent too. A unit on a bus cannot say that it has ended.
    pub(crate) fn only_one_is_left(&self) -> bool {
        let left = self.running.load(Ordering::Relaxed);
        self.finite > 1 && left <= 1 && self.live_lidars.load(Ordering::Relaxed) == 0
    }

    /// A LiDAR is heard again, or has fallen silent: while one is heard the session goes on, and devices that are gone may come
    /// back.
    pub(crate) fn count_live_lidar(&self, is_alive: bool) {
        if is_alive {
            self.live_lidars.fetch_add(1, Ordering::Relaxed);
        } else {
            self.live_lidars.fetch_sub(1, Ordering::Relaxed);
        }
    }

    /// Opens a device that is gone again and again, until it is back or the session has nothing left to record.
    pub(crate) fn reopen<D>(
        &self,
        report: &mut StreamReport,
        meter: &Meter,
        open: impl Fn() -> Result<D, lsfb_drivers::Error>,
    ) -> Option<D> {
        meter.set_connected(Connection::Gone);
        self.leave();
        let gone = Instant::now();
        let mut tried = gone;
        let back = loop {
            if self.is_stopping() || self.nothing_is_left() {
                break None;
            }
            std::thread::sleep(POLL);
            if tried.elapsed() >= REOPEN {
                tried = Instant::now();
                if let Ok(device) = open() {
                    break Some(device);
                }
            }
        };
        self.come_back();
        if back.is_some() {
            report.interruptions += 1;
            let secs = gone.elapsed().as_secs_f64();
            report.notes.push(format!("disconnected for {secs:.1} s"));
            meter.count(report);
            meter.set_connected(Connection::There);
        }
        back
    }
}

/// What has been handled so far, for progress and for senders that must not run ahead of the recording.
#[derive(Clone, Debug, Default)]
pub struct Counts {
    /// LiDAR packets of both kinds.
    pub lidar_packets: Arc<AtomicU64>,
    /// Images.
    pub images: Arc<AtomicU64>,
    /// IMU samples.
    pub imu_samples: Arc<AtomicU64>,
    /// Messages of sidecars.
    pub sidecar_messages: Arc<AtomicU64>,
}

impl Counts {
    pub(crate) fn sum(&self) -> u64 {
        let counts = [
            &self.lidar_packets,
            &self.images,
            &self.imu_samples,
            &self.sidecar_messages,
        ];
        counts.iter().map(|c| c.load(Ordering::Relaxed)).sum()
    }
}
