//! The clocks inside the devices, and the ways from the devices to their host.
//!
//! A device either keeps UTC or counts by a quartz of its own, which runs fast or slow, wanders with the temperature and may
//! be set. What it sends reaches the host later: never sooner than the shortest delay, not always in step, sometimes in
//! batches, sometimes not at all for a while. [`crate::Simulation::write_truth`] writes how each clock really ran.

mod link;
mod rig;

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use lsfb_types::{Bounds, Timestamp};

use crate::noise::{hash, unit};
pub use link::{Link, LinkConfig};
pub use rig::{Clocked, RigClocks};

/// What a device's clock follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Discipline {
    /// UTC: a pulse per second, or a clock that somebody sets all the time. The device names the time itself.
    #[default]
    Utc,
    /// Nothing: a counter that began when the device was switched on.
    Free,
}

/// A clock that is set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClockJump {
    /// When, seconds after the beginning of the recording.
    pub at_s: f64,
    /// By how much, seconds; forward is positive.
    pub by_s: f64,
}

/// The clock of one device and the way to its host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClockConfig {
    /// What the clock follows; the next four are of one that follows nothing.
    pub discipline: Discipline,
    /// What the counter says when the recording begins, seconds.
    pub start_s: f64,
    /// How much too fast it runs, parts per million.
    pub drift_ppm: f64,
    /// How far the temperature changes that, parts per million.
    pub wander_ppm: f64,
    /// How long a change of temperature and back takes, seconds.
    pub wander_period_s: f64,
    /// When it is set.
    pub jumps: Vec<ClockJump>,
    /// The way to the host.
    pub link: LinkConfig,
}

impl Default for ClockConfig {
    fn default() -> Self {
        Self {
            discipline: Discipline::Utc,
            start_s: 0.0,
            drift_ppm: 0.0,
            wander_ppm: 0.0,
            wander_period_s: 900.0,
            jumps: Vec::new(),
            link: LinkConfig::default(),
        }
    }
}

/// The clocks of all devices.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClocksConfig {
    /// The LiDAR, where no pulse disciplines it.
    pub lidar: ClockConfig,
    /// The stereo unit with `cam0` and `cam1`.
    pub front_cameras: ClockConfig,
    /// The stereo unit with `cam2` and `cam3`.
    pub rear_cameras: ClockConfig,
    /// The IMU of the backpack.
    pub scan_imu: ClockConfig,
    /// The phone or the glasses: one clock for all they measure, one connection for all they send.
    pub walker: ClockConfig,
}

impl ClocksConfig {
    /// Quartz clocks that nobody disciplines, and the delays of Ethernet, USB, a serial line and Wi-Fi: as without
    /// synchronization hardware.
    pub fn quartz() -> Self {
        let clock = |start_s: f64, drift_ppm: f64, wander_ppm: f64, link: [f64; 4], batch: u32| {
            let [delay_s, jitter_s, stall_s, stall_every_s] = link;
            ClockConfig {
                discipline: Discipline::Free,
                start_s,
                drift_ppm,
                wander_ppm,
                link: LinkConfig {
                    delay_s,
                    jitter_s,
                    batch,
                    stall_s,
                    stall_every_s,
                },
                ..ClockConfig::default()
            }
        };
        Self {
            lidar: clock(625.7, 17.0, 0.3, [150e-6, 60e-6, 4e-3, 7.0], 1),
            front_cameras: clock(93.2, -31.0, 0.8, [9e-3, 1.5e-3, 20e-3, 11.0], 1),
            rear_cameras: clock(93.9, 24.0, 0.8, [9e-3, 1.5e-3, 20e-3, 13.0], 1),
            scan_imu: clock(41.0, -8.0, 0.3, [1.2e-3, 0.4e-3, 16e-3, 9.0], 1),
            walker: clock(86_542.3, 11.0, 0.5, [6e-3, 5e-3, 90e-3, 8.0], 4),
        }
    }

    /// Whether every device keeps UTC and reaches its host at once.
    pub fn is_ideal(&self) -> bool {
        *self == Self::default()
    }
}

lsfb_types::bounds! {
    ClocksConfig {
        lidar: section,
        front_cameras: section,
        rear_cameras: section,
        scan_imu: section,
        walker: section,
    }
}

lsfb_types::bounds! {
    ClockJump {
        at_s: number(Bounds::Within(-1e12, 1e12)),
        by_s: number(Bounds::Within(-1e6, 1e6)),
    }
}

lsfb_types::bounds! {
    ClockConfig {
        discipline: any,
        start_s: number(Bounds::Within(0.0, 1e9)),
        drift_ppm: number(Bounds::Within(-1000.0, 1000.0)),
        wander_ppm: number(Bounds::Within(-1000.0, 1000.0)),
        wander_period_s: number(Bounds::Within(1.0, 1e6)),
        jumps: sections,
        link: section,
    }
}

/// How a device's clock really runs.
#[derive(Clone, Debug)]
pub struct DeviceClock {
    begin: Timestamp,
    config: ClockConfig,
    phase: f64,
}

impl DeviceClock {
    /// The clock of a recording that begins at `begin`.
    pub fn new(config: &ClockConfig, begin: Timestamp, seed: u64) -> Self {
        Self {
            begin,
            config: config.clone(),
            phase: TAU * unit(hash(seed)),
        }
    }

    /// What it follows.
    pub fn discipline(&self) -> Discipline {
        self.config.discipline
    }

    /// What it says `offset_ns` after the beginning, nanoseconds: since 1970 where it keeps UTC, else since it was switched
    /// on. A counter that was set back below zero stays there.
    pub fn device_ns(&self, offset_ns: i64) -> i64 {
        if self.config.discipline == Discipline::Utc {
            return self.begin.plus_nanos(offset_ns).nanos();
        }
        let start_ns = (self.config.start_s * 1e9) as i64;
        (start_ns + offset_ns + self.gained_ns(offset_ns)).max(0)
    }

    /// The way to the host.
    pub fn link(&self, seed: u64) -> Link {
        Link::new(&self.config.link, seed)
    }

    /// How much it has gained since the beginning, nanoseconds.
    fn gained_ns(&self, offset_ns: i64) -> i64 {
        let t = offset_ns as f64 * 1e-9;
        let ClockConfig {
            drift_ppm,
            wander_ppm,
            wander_period_s,
            ref jumps,
            ..
        } = self.config;
        // The integral of the wandering rate.
        let turn = TAU * t / wander_period_s;
        let wandered =
            wander_ppm * wander_period_s / TAU * (self.phase.cos() - (turn + self.phase).cos());
        let set: f64 = jumps.iter().filter(|j| t >= j.at_s).map(|j| j.by_s).sum();
        (1e3 * (drift_ppm * t + wandered) + 1e9 * set).round() as i64
    }

    /// How much too fast it runs `offset_ns` after the beginning, parts per million.
    pub fn rate_ppm(&self, offset_ns: i64) -> f64 {
        let turn = TAU * offset_ns as f64 * 1e-9 / self.config.wander_period_s;
        match self.config.discipline {
            Discipline::Utc => 0.0,
            Discipline::Free => {
                self.config.drift_ppm + self.config.wander_ppm * (turn + self.phase).sin()
            }
        }
    }

    /// The truth about it for `eval`: what it said ten times a second, and on both sides of each jump.
    pub(crate) fn truth_rows(&self, device: &str, duration_s: f64) -> String {
        use std::fmt::Write as _;
        let end_ns = (duration_s * 1e9) as i64;
        let mut times: Vec<i64> = (0..=end_ns / 100_000_000)
            .map(|k| k * 100_000_000)
            .collect();
        times.push(end_ns);
        if self.config.discipline == Discipline::Free {
            for jump in &self.config.jumps {
                // The first nanosecond with the new count, and the one before.
                let at_ns = (jump.at_s * 1e9).ceil() as i64;
                times.extend([at_ns - 1, at_ns]);
            }
        }
        times.retain(|t| (0..=end_ns).contains(t));
        times.sort_unstable();
        times.dedup();
        let mut text = String::new();
        for offset_ns in times {
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{device},{},{},{:.6}",
                self.begin.plus_nanos(offset_ns).nanos(),
                self.device_ns(offset_ns),
                self.rate_ppm(offset_ns)
            );
        }
        text
    }
}

#[cfg(test)]
mod tests;
