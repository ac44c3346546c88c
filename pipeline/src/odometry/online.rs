//! The odometry on live streams: samples and scans come as they arrive, each stream in its own order.
//!
//! A scan is taken as soon as the IMU has reached its end; from there on it is [`Odometry`], so that a live run and a batch
//! run over the same samples give the same poses, bit for bit.

use std::collections::VecDeque;

use lsfb_geometry::Rig;
use lsfb_types::{ImuSample, LidarScan, Stamped, Timestamp};

use super::{InertialState, Odometry, OdometryConfig, OdometryStep};
use crate::Error;

/// Scans that wait for the IMU at most; with more, it counts as gone and the first is taken without it.
const WAITING_SCANS: usize = 5;

/// The odometry of one live walk.
#[derive(Clone, Debug)]
pub struct OnlineOdometry {
    odometry: Odometry,
    has_imu: bool,
    newest_imu: Option<Timestamp>,
    waiting: VecDeque<Stamped<LidarScan>>,
}

impl OnlineOdometry {
    /// For a rig with a LiDAR and, if there is one, an IMU.
    pub fn new(config: &OdometryConfig, rig: &Rig) -> Result<Self, Error> {
        let lidar = rig.lidar().ok_or_else(|| Error::SensorMissing {
            sensor: "LiDAR",
            rig: rig.name.clone(),
        })?;
        Ok(Self {
            odometry: Odometry::new(config, lidar, rig.imu_noise())?,
            has_imu: rig.imu().is_some(),
            newest_imu: None,
            waiting: VecDeque::new(),
        })
    }

    /// Takes an inertial sample.
    pub fn push_imu(&mut self, sample: &Stamped<ImuSample>) {
        self.odometry.push_imu(sample);
        self.newest_imu = self.newest_imu.max(Some(sample.time));
    }

    /// Takes a scan.
    pub fn push_scan(&mut self, scan: Stamped<LidarScan>) {
        self.waiting.push_back(scan);
    }

    /// Registers the next scan, if the IMU has reached its end. Call it until there is none.
    pub fn next_step(&mut self) -> Option<Result<OdometryStep, Error>> {
        let scan = self.waiting.front()?;
        let last_offset_ns = scan.sample.points.iter().map(|p| p.time_offset_ns).max();
        let end = scan.time.plus_nanos(last_offset_ns.map_or(0, i64::from));
        let covered = !self.has_imu || self.newest_imu.is_some_and(|newest| newest >= end);
        if !covered && self.waiting.len() <= WAITING_SCANS {
            return None;
        }
        let scan = self.waiting.pop_front()?;
        Some(self.odometry.push_scan(&scan))
    }

    /// The inertial estimate at the end of the last scan; `None` without IMU or before the first scan.
    pub fn inertial_state(&self) -> Option<&InertialState> {
        self.odometry.inertial_state()
    }
}
