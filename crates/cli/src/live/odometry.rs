//! The thread of the online odometry.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Instant;

use anyhow::Context as _;
use lsfb_geometry::{Rig, StampedPose, Trajectory};
use lsfb_pipeline::odometry::{OdometryConfig, OdometryStep, OnlineOdometry, StepOutcome};
use lsfb_types::{ImuSample, LidarScan, Stamped, Timestamp};

/// Samples that wait: five seconds of an IMU.
const QUEUE_SAMPLES: usize = 1024;
/// Scans that wait; more would show the past.
const QUEUE_SCANS: usize = 3;
/// Results that wait.
const QUEUE_STEPS: usize = 64;

enum Work {
    Imu(Stamped<ImuSample>),
    /// With when it came to the tap.
    Scan(Stamped<LidarScan>, Instant),
}

/// What a scan gave.
pub struct LiveStep {
    pub step: OdometryStep,
    /// Where the rig was at the stamp of the scan's cloud, its first firing; `None` where the scan was not registered, or nothing is known of
    /// the time before it.
    pub at_cloud: Option<StampedPose>,
    /// When the scan came to the tap.
    pub offered: Option<Instant>,
}

/// Finds poses at the stamps of clouds: a step gives those from the end of a scan to the end of the next.
#[derive(Default)]
struct CloudPoses {
    /// Stamps of the scans of which no step is known yet, and when they came to the tap.
    waiting: VecDeque<(Timestamp, Instant)>,
    /// At the end of the scan before, where that was registered.
    last: Option<StampedPose>,
}

impl CloudPoses {
    fn live(&mut self, step: OdometryStep) -> LiveStep {
        let mut of_scan = None;
        // Scans that gave no step are passed over.
        let begins_before = |next: &mut (Timestamp, Instant)| next.0 < step.time;
        while let Some(next) = self.waiting.pop_front_if(begins_before) {
            of_scan = Some(next);
        }
        LiveStep {
            at_cloud: self.at_cloud(of_scan.map(|(stamp, _)| stamp), &step),
            offered: of_scan.map(|(_, offered)| offered),
            step,
        }
    }

    fn at_cloud(&mut self, stamp: Option<Timestamp>, step: &OdometryStep) -> Option<StampedPose> {
        let is_registered = step.outcome != StepOutcome::Lost;
        let end_of = |step: &OdometryStep| StampedPose {
            time: step.time,
            world_from_rig: step.world_from_rig,
        };
        let end = end_of(step);
        if let Some(before) = step.anew.last() {
            self.last = (before.outcome != StepOutcome::Lost).then(|| end_of(before));
        }
        let before = std::mem::replace(&mut self.last, is_registered.then_some(end));
        let poses = before.into_iter().chain(step.poses.iter().copied());
        let time = stamp.filter(|_| is_registered)?;
        let world_from_rig = Trajectory::new(poses.collect()).at(time)?;
        Some(StampedPose {
            time,
            world_from_rig,
        })
    }
}

/// What the odometry was not given because it was behind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Skipped {
    pub scans: u64,
    pub imu_samples: u64,
}

/// The odometry of one recording.
pub struct OdometryThread {
    work: SyncSender<Work>,
    steps: Receiver<LiveStep>,
    waiting_scans: Arc<AtomicUsize>,
    skipped: Skipped,
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
        let mut clouds = CloudPoses::default();
        let run = move || {
            for work in waiting {
                match work {
                    Work::Imu(sample) => odometry.push_imu(&sample),
                    Work::Scan(scan, offered) => {
                        clouds.waiting.push_back((scan.time, offered));
                        odometry.push_scan(scan);
                        taken.fetch_sub(1, Ordering::Relaxed);
                    }
                }
                while let Some(step) = odometry.next_step() {
                    // A scan without points, or from before the IMU: the next one will do.
                    let Ok(step) = step else {
                        continue;
                    };
                    if done.send(clouds.live(step)).is_err() {
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
            skipped: Skipped::default(),
            thread: Some(thread),
        })
    }

    /// Takes a sample.
    pub fn push_imu(&mut self, sample: &Stamped<ImuSample>) {
        // Full: the odometry is seconds behind, and goes on without this one.
        let sent = self.work.try_send(Work::Imu(sample.clone()));
        self.skipped.imu_samples += u64::from(sent.is_err());
    }

    /// Takes a scan that came to the tap then, or skips it where the odometry is behind.
    pub fn push_scan(&mut self, scan: Stamped<LidarScan>, offered: Instant) {
        if self.waiting_scans.fetch_add(1, Ordering::Relaxed) >= QUEUE_SCANS
            || self.work.try_send(Work::Scan(scan, offered)).is_err()
        {
            self.waiting_scans.fetch_sub(1, Ordering::Relaxed);
            self.skipped.scans += 1;
        }
    }

    /// What it was not given so far.
    pub fn skipped(&self) -> Skipped {
        self.skipped
    }

    /// The next result, if there is one.
    pub fn next_step(&self) -> Option<LiveStep> {
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

#[cfg(test)]
pub mod tests {
    use lsfb_geometry::{Se3, Vector3};

    use super::*;

    fn at(ms: i64) -> StampedPose {
        StampedPose {
            time: Timestamp::from_nanos(ms * 1_000_000),
            world_from_rig: Se3 {
                translation: Vector3::new(ms as f64, 0.0, 0.0),
                ..Se3::identity()
            },
        }
    }

    /// The step of a scan that ends then.
    pub fn step(end_ms: i64, outcome: StepOutcome) -> OdometryStep {
        let end = at(end_ms);
        OdometryStep {
            time: end.time,
            world_from_rig: end.world_from_rig,
            by_scan_alone: end.world_from_rig,
            covariance: lsfb_geometry::Matrix6::identity(),
            unseen: None,
            poses: vec![end],
            keypoints_in_rig: Vec::new(),
            inlier_ratio: 1.0,
            plane_rms_m: 0.0,
            iterations: 1,
            outcome,
            anew: Vec::new(),
        }
    }

    /// The same of a scan that came to the tap then.
    pub fn live(end_ms: i64, outcome: StepOutcome, offered: Instant) -> LiveStep {
        LiveStep {
            step: step(end_ms, outcome),
            at_cloud: None,
            offered: Some(offered),
        }
    }

    /// Scans that an odometry was too slow for were gone without a trace.
    #[test]
    fn scans_that_are_skipped_are_counted() {
        let (work, waiting) = sync_channel(QUEUE_SAMPLES);
        let mut odometry = OdometryThread {
            work,
            steps: sync_channel(0).1,
            waiting_scans: Arc::default(),
            skipped: Skipped::default(),
            thread: None,
        };
        let sample = |time| Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: LidarScan { points: Vec::new() },
        };
        for ms in 0..5 {
            odometry.push_scan(sample(at(ms).time), Instant::now());
        }
        assert_eq!(waiting.try_iter().count(), QUEUE_SCANS);
        let expected = Skipped {
            scans: 2,
            imu_samples: 0,
        };
        assert_eq!(odometry.skipped(), expected);
    }

    /// The rig moves a metre per millisecond: a pose of the scan's end at the stamp of its beginning is 100 m off.
    #[test]
    fn poses_are_at_the_stamps_of_the_clouds_and_none_is_made_up() {
        let mut clouds = CloudPoses::default();
        let began = Instant::now();
        let offered = |ms: u64| began + std::time::Duration::from_millis(ms);
        for ms in [0, 100, 200, 300, 400] {
            clouds.waiting.push_back((at(ms).time, offered(ms as u64)));
        }
        let mut at_cloud = |end_ms, outcome| {
            let live = clouds.live(step(end_ms, outcome));
            // The stamp of each is 99 ms before its end.
            assert_eq!(live.offered, Some(offered(end_ms as u64 - 99)));
            live.at_cloud
        };
        // Nothing is known of the time before the first.
        assert_eq!(at_cloud(99, StepOutcome::First), None);
        let found = at_cloud(199, StepOutcome::Registered).unwrap();
        assert_eq!(found.time, at(100).time);
        let error_m = found.world_from_rig.translation.x - 100.0;
        assert!(error_m.abs() < 1e-6, "{error_m}");
        // The scan at 200 ms gave no step, that at 300 ms found no place.
        assert_eq!(at_cloud(399, StepOutcome::Lost), None);
        assert_eq!(at_cloud(499, StepOutcome::Registered), None);
        assert!(clouds.waiting.is_empty());
    }
}
