//! The clocks of one rig.

use lsfb_types::Timestamp;

use super::{ClocksConfig, DeviceClock, Link};
use crate::noise::hash;

/// Devices with a clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clocked {
    /// The LiDAR of the backpack.
    Lidar,
    /// A stereo unit of the backpack, 0 or 1.
    Unit(usize),
    /// The IMU of the backpack.
    Imu,
    /// The phone or the glasses.
    Walker,
}

impl Clocked {
    /// All devices of the backpack.
    pub const SCAN: [Self; 4] = [Self::Lidar, Self::Unit(0), Self::Unit(1), Self::Imu];
}

/// The clocks of all devices of one recording.
#[derive(Clone, Debug)]
pub struct RigClocks {
    lidar: DeviceClock,
    units: [DeviceClock; 2],
    imu: DeviceClock,
    walker: DeviceClock,
    seed: u64,
}

impl RigClocks {
    pub(crate) fn new(config: &ClocksConfig, begin: Timestamp, seed: u64) -> Self {
        let clock = |config, number: u64| DeviceClock::new(config, begin, hash(seed ^ number));
        Self {
            lidar: clock(&config.lidar, 1),
            units: [
                clock(&config.front_cameras, 2),
                clock(&config.rear_cameras, 3),
            ],
            imu: clock(&config.scan_imu, 4),
            walker: clock(&config.walker, 5),
            seed,
        }
    }

    /// How a device's clock runs.
    pub fn of(&self, device: Clocked) -> &DeviceClock {
        match device {
            Clocked::Lidar => &self.lidar,
            Clocked::Unit(unit) => &self.units[unit % 2],
            Clocked::Imu => &self.imu,
            Clocked::Walker => &self.walker,
        }
    }

    /// The way from a device to its host.
    pub(crate) fn link(&self, device: Clocked) -> Link {
        let number = match device {
            Clocked::Lidar => 11,
            Clocked::Unit(unit) => 12 + unit as u64,
            Clocked::Imu => 14,
            Clocked::Walker => 15,
        };
        self.of(device).link(hash(self.seed ^ number))
    }

    /// How the clocks of a backpack really ran, as CSV.
    pub(crate) fn scan_csv(&self, duration_s: f64) -> String {
        [
            ("lidar", &self.lidar),
            ("cam0+cam1", &self.units[0]),
            ("cam2+cam3", &self.units[1]),
            ("imu0", &self.imu),
        ]
        .iter()
        .fold(HEAD.to_owned(), |text, (name, clock)| {
            text + &clock.truth_rows(name, duration_s)
        })
    }

    /// How the clock of a phone or of glasses really ran, as CSV.
    pub(crate) fn walk_csv(&self, device: &str, duration_s: f64) -> String {
        HEAD.to_owned() + &self.walker.truth_rows(device, duration_s)
    }
}

const HEAD: &str = "device,time_ns,device_ns,rate_ppm\n";
