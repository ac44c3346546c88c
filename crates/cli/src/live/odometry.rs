//! The thread of the online odometry.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::Context as _;
use lsfb_geometry::Rig;
use lsfb_pipeline::odometry::{OdometryConfig, OdometryStep, OnlineOdometry};
use lsfb_types::{ImuSample, LidarScan, Stamped};

/// Samples that wait: five seconds of an IMU.
const QUEUE_SAMPLES: usize = 1024;
/// Scans that wait; more would show the past.
const QUEUE_SCANS: usize = 3;
/// Results that wait.
const QUEUE_STEPS: usize = 64;

enum Work {
    Imu(Stamped<ImuSample>),
    Scan(Stamped<LidarScan>),
}

/// The odometry of one recording.
pub struct OdometryThread {
    work: SyncSender<Work>,
    steps: Receiver<OdometryStep>,
    waiting_scans: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
}

impl OdometryThread {
    /// Starts it for a rig with a LiDAR.
    pub fn start(rig: &Rig) -> anyhow::Result<Self> {
        let mut odometry = OnlineOdometry::new(&OdometryConfig::default(), rig)?;
        let (work, waiting) = sync_channel::<Work>(QUEUE_SAMPLES);
        let (done, steps) = sync_channel(QUEUE_STEPS);
        let waiting_scans = Arc::new(AtomicUsize::new(0));
        let taken = Arc::clone(&waiting_scans);
        let run = move || {
            for work in waiting {
                match work {
                    Work::Imu(sample) => odometry.push_imu(&sample),
                    Work::Scan(scan) => {
                        odometry.push_scan(scan);
                        taken.fetch_sub(1, Ordering::Relaxed);
                    }
                }
                while let Some(step) = odometry.next_step() {
                    // A scan without points, or from before the IMU: the next one will do.
                    let Ok(step) = step else {
                        continue;
                    };
                    if done.send(step).is_err() {
                        return;
                    }
                }
            }
        };
        let thread = std::thread::Builder::new()
            .name("live-odometry".to_owned())
            .spawn(run)
            .context("cannot start the odometry's thread")?;
        Ok(Self {
            work,
            steps,
            waiting_scans,
            thread: Some(thread),
        })
    }

    /// Takes a sample.
    pub fn push_imu(&self, sample: &Stamped<ImuSample>) {
        // Full: the odometry is seconds behind, and goes on without this one.
        let _ = self.work.try_send(Work::Imu(sample.clone()));
    }

    /// Takes a scan, or passes over it where the odometry is behind.
    pub fn push_scan(&self, scan: Stamped<LidarScan>) {
        if self.waiting_scans.fetch_add(1, Ordering::Relaxed) >= QUEUE_SCANS
            || self.work.try_send(Work::Scan(scan)).is_err()
        {
            self.waiting_scans.fetch_sub(1, Ordering::Relaxed);
        }
    }

    /// The next result, if there is one.
    pub fn next_step(&self) -> Option<OdometryStep> {
        self.steps.try_recv().ok()
    }
}

impl Drop for OdometryThread {
    fn drop(&mut self) {
        // Both channels closed: the thread ends after its scan.
        let (work, _) = sync_channel(0);
        self.work = work;
        let (_, steps) = sync_channel(0);
        self.steps = steps;
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported by the panic hook already.
            let _ = thread.join();
        }
    }
}
