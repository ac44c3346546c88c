//! The thread of the online odometry.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

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
    Scan(Stamped<LidarScan>),
}

/// What a scan gave.
pub struct LiveStep {
    pub step: OdometryStep,
    /// Where the rig was at the stamp of the scan's cloud, its first firing; `None` where the scan was not registered, or nothing is known of
    /// the time before it.
    pub at_cloud: Option<StampedPose>,
}

/// Finds poses at the stamps of clouds: a step gives those from the end of a scan to the end of the next.
#[derive(Default)]
struct CloudPoses {
    /// Stamps of the scans of which no step is known yet.
    stamps: VecDeque<Timestamp>,
    /// At the end of the scan before, where that was registered.
    last: Option<StampedPose>,
}

impl CloudPoses {
    fn at_cloud(&mut self, step: &OdometryStep) -> Option<StampedPose> {
        let mut stamp = None;
        // Scans that gave no step are passed over.
        while self.stamps.front().is_some_and(|next| *next < step.time) {
            stamp = self.stamps.pop_front();
        }
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

/// The odometry of one recording.
pub struct OdometryThread {
    work: SyncSender<Work>,
    steps: Receiver<LiveStep>,
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
        let mut clouds = CloudPoses::default();
        let run = move || {
            for work in waiting {
                match work {
                    Work::Imu(sample) => odometry.push_imu(&sample),
                    Work::Scan(scan) => {
                        clouds.stamps.push_back(scan.time);
                        odometry.push_scan(scan);
                        taken.fetch_sub(1, Ordering::Relaxed);
                    }
                }
                while let Some(step) = odometry.next_step() {
                    // A scan without points, or from before the IMU: the next one will do.
                    let Ok(step) = step else {
                        continue;
                    };
                    let at_cloud = clouds.at_cloud(&step);
                    if done.send(LiveStep { step, at_cloud }).is_err() {
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

    /// The rig moves a metre per millisecond: a pose of the scan's end at the stamp of its beginning is 100 m off.
    #[test]
    fn poses_are_at_the_stamps_of_the_clouds_and_none_is_made_up() {
        let mut clouds = CloudPoses::default();
        for ms in [0, 100, 200, 300, 400] {
            clouds.stamps.push_back(at(ms).time);
        }
        // Nothing is known of the time before the first.
        assert_eq!(clouds.at_cloud(&step(99, StepOutcome::First)), None);
        let found = clouds
            .at_cloud(&step(199, StepOutcome::Registered))
            .unwrap();
        assert_eq!(found.time, at(100).time);
        let error_m = found.world_from_rig.translation.x - 100.0;
        assert!(error_m.abs() < 1e-6, "{error_m}");
        // The scan at 200 ms gave no step, that at 300 ms found no place.
        assert_eq!(clouds.at_cloud(&step(399, StepOutcome::Lost)), None);
        assert_eq!(clouds.at_cloud(&step(499, StepOutcome::Registered)), None);
        assert!(clouds.stamps.is_empty());
    }
}
