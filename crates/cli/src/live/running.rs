//! The recording that runs, as the controller knows it.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, SyncSender};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use lsfb_capture::health::Snapshot;
use lsfb_capture::{Poses, Remarks, Tap, Tapped};
use lsfb_geometry::{MAIN_IMU, MAIN_LIDAR, Rig};
use lsfb_operator::ScreenState;
use lsfb_recording::message::Remark;
use lsfb_types::Timestamp;

use super::Run;
use super::following::{Following, LiveOdometryReport};
use super::loops::LoopsThread;
use super::odometry::OdometryThread;
use super::streams::Streams;

/// Between two previews of a camera.
const PREVIEW_EVERY: Duration = Duration::from_secs(1);

/// The recording that runs.
pub struct Running {
    pub tap: Tap,
    remarks: Remarks,
    pub health: Receiver<Snapshot>,
    pub stop: Arc<AtomicBool>,
    pub began: Instant,
    pub streams: Streams,
    pub odometry: Option<OdometryThread>,
    /// Beside the odometry.
    pub loops: Option<LoopsThread>,
    /// Whose scans and whose samples it takes.
    main_lidar: String,
    main_imu: String,
    /// Where its poses go.
    pub poses: Option<Poses>,
    /// Synchronized and host time of one sample: how to stamp what people say.
    clock: Option<(Timestamp, Timestamp)>,
    pub cameras_sent: BTreeMap<String, Timestamp>,
    previews_sent: BTreeMap<String, Instant>,
    /// What became of the scans in the live odometry.
    pub following: Following,
    /// Who is told of it in the end.
    told: SyncSender<LiveOdometryReport>,
}

impl Running {
    /// A recording that begins.
    pub fn new(run: Run, odometry: Option<OdometryThread>, loops: Option<LoopsThread>) -> Self {
        let rig = run.rig.as_ref();
        let main_lidar = rig.and_then(Rig::main_lidar_name).unwrap_or(MAIN_LIDAR);
        // As the rig chooses its own.
        let imus = rig.into_iter().flat_map(|rig| rig.imus.keys());
        let main_imu = imus.min_by_key(|name| (*name != MAIN_IMU, *name));
        let main_imu = main_imu.map_or(MAIN_IMU, String::as_str);
        Self {
            main_lidar: main_lidar.to_owned(),
            main_imu: main_imu.to_owned(),
            streams: Streams::new(&run.devices),
            tap: run.tap,
            remarks: run.remarks,
            health: run.health,
            stop: run.stop,
            began: Instant::now(),
            odometry,
            loops,
            poses: run.poses,
            clock: None,
            cameras_sent: BTreeMap::new(),
            previews_sent: BTreeMap::new(),
            following: Following::default(),
            told: run.told,
        }
    }

    /// Takes note of what was recorded.
    pub fn note(&mut self, entry: &Tapped) {
        self.streams.note(entry, Instant::now());
        self.clock = match entry {
            Tapped::Imu { sample, .. } => Some((sample.time, sample.arrival)),
            Tapped::Scan { scan, .. } => Some((scan.time, scan.arrival)),
            Tapped::Image { image, .. } => Some((image.time, image.arrival)),
            Tapped::Message { .. } => self.clock,
        };
    }

    /// Whether a camera's preview is due; it counts as sent then.
    pub fn preview_is_due(&mut self, camera: &str) -> bool {
        let sent = self.previews_sent.get(camera);
        let is_due = sent.is_none_or(|sent| sent.elapsed() >= PREVIEW_EVERY);
        if is_due {
            self.previews_sent.insert(camera.to_owned(), Instant::now());
        }
        is_due
    }

    /// Hands the odometry its scans and samples.
    pub fn feed_odometry(&mut self, entry: Tapped) {
        let Some(odometry) = &mut self.odometry else {
            return;
        };
        match entry {
            Tapped::Imu { imu, sample } if imu == self.main_imu => odometry.push_imu(&sample),
            Tapped::Scan {
                lidar,
                scan,
                offered,
            } if lidar == self.main_lidar => odometry.push_scan(scan, offered),
            _ => {}
        }
    }

    /// Why the map does not grow any more, or has not begun to; `None` while it does, and where there is none.
    pub fn frozen(&self, now: Instant) -> Option<String> {
        self.odometry.as_ref()?;
        self.following.frozen(self.began, now)
    }

    /// What the live odometry made of the scans; `None` where there is none.
    pub fn odometry_report(&self) -> Option<LiveOdometryReport> {
        let skipped = self.odometry.as_ref()?.skipped();
        Some(LiveOdometryReport {
            loops: self.loops.as_ref().map(|_| self.following.loops),
            unsearched_scans: self
                .loops
                .as_ref()
                .map(|loops| loops.unsearched() + loops.waiting()),
            skipped_scans: skipped.scans,
            skipped_imu_samples: skipped.imu_samples,
            missed_by_tap: self.tap.missed(),
            ..self.following.report()
        })
    }

    /// Tells what became of the scans, now that the recording has ended.
    pub fn tell(&self) {
        if let Some(report) = self.odometry_report() {
            // Who asked may be gone.
            let _ = self.told.try_send(report);
        }
    }

    /// Writes what somebody said into the recording, stamped by the devices' clock.
    pub fn remark(&self, state: &ScreenState, kind: &str, text: &str) -> Result<(), String> {
        let arrival = host_now();
        let time = match self.clock {
            Some((time, heard)) => time.plus_nanos(arrival - heard),
            None => arrival,
        };
        let remark = Remark {
            kind: kind.to_owned(),
            text: text.to_owned(),
            position_in_world_m: position(state),
        };
        self.remarks
            .put(time, arrival, remark)
            .map_err(|error| error.to_string())
    }
}

/// Where the rig is on the live map, metres.
pub fn position(state: &ScreenState) -> Option<[f64; 3]> {
    state.pose.map(|pose| [pose.x_m, pose.y_m, pose.z_m])
}

/// The host's clock, as packets are stamped by.
pub fn host_now() -> Timestamp {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    Timestamp::from_nanos(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}
