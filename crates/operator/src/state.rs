//! What the screen shows, as plain data. The page gets it as JSON with these names.

use serde::Serialize;

use crate::coverage::GoBack;

/// Whether something needs the operator right now: a colour on the screen. No `Verdict` of `lsfb-types`: it has no finding behind it, is
/// gone a second later, and its names are what the page's style sheet knows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Level {
    /// Nothing is known yet.
    #[default]
    Unknown,
    /// All is well.
    Good,
    /// Go on, and have a look.
    Warning,
    /// Data is being lost.
    Bad,
}

/// What the recorder is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// It waits for the start.
    #[default]
    Ready,
    /// Devices are being opened.
    Starting,
    /// It records.
    Recording,
    /// The file is being closed.
    Stopping,
}

/// Everything but the map.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ScreenState {
    /// What the recorder is doing.
    pub phase: Phase,
    /// One sentence: what happened last, or what to do.
    pub message: String,
    /// Whether that sentence is bad news.
    pub message_level: Level,
    /// Name of the file.
    pub file: String,
    /// Length of the recording so far, seconds.
    pub recording_s: f64,
    /// Everything that should have been recorded and was not.
    pub lost: u64,
    /// One entry per device.
    pub streams: Vec<StreamState>,
    /// How the devices' clocks agree.
    pub sync: SyncState,
    /// The disk; `None` where it is not known.
    pub storage: Option<StorageState>,
    /// The host's battery; `None` without one.
    pub battery: Option<BatteryState>,
    /// Where the rig is in the live map; `None` before the first scan was registered.
    pub pose: Option<PoseState>,
    /// Whether the live odometry follows.
    pub tracking: Tracking,
    /// Why the live map is not to be believed, and what to do; empty where it is.
    pub tracking_problem: String,
    /// The motion that the scans of the moment do not see; `None` while they see all.
    pub unseen: Option<UnseenMotion>,
    /// Length of the path so far, metres.
    pub path_m: f64,
    /// Scans that are recorded and missing from the live map, since the live odometry was behind.
    pub skipped_scans: u64,
    /// How many places were recognised that the walk came back to.
    pub loop_count: u64,
    /// The last of them, the newest at the end.
    pub loops: Vec<LoopState>,
    /// How well the place was seen.
    pub coverage: CoverageState,
    /// Control points so far.
    pub control_points: Vec<ControlPoint>,
    /// Notes so far.
    pub notes: u64,
}

/// Loops that are shown.
const SHOWN_LOOPS: usize = 20;

impl ScreenState {
    /// Adds a place that was recognised.
    pub fn take_loop(&mut self, found: LoopState) {
        self.loop_count += 1;
        if self.loops.len() == SHOWN_LOOPS {
            self.loops.remove(0);
        }
        self.loops.push(found);
    }

    /// Another walk has other loops.
    pub fn forget_loops(&mut self) {
        self.loop_count = 0;
        self.loops.clear();
    }
}

/// A place that the walk came back to, and that was recognised there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LoopState {
    /// Where the live map has the earlier visit, metres.
    pub earlier_m: [f64; 2],
    /// Where it has the later one, metres.
    pub later_m: [f64; 2],
    /// How far the live map is off between the two, metres.
    pub off_m: f64,
}

/// One device.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StreamState {
    /// Its name.
    pub name: String,
    /// How it is doing.
    pub level: Level,
    /// Samples per second lately.
    pub rate_hz: f64,
    /// Samples in all.
    pub samples: u64,
    /// What should have been recorded and was not.
    pub lost: u64,
    /// What is wrong, in words; empty where nothing is.
    pub problem: String,
}

/// How the devices' clocks agree.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SyncState {
    /// How they are doing.
    pub level: Level,
    /// Farthest two devices lie apart, milliseconds; `None` while fewer than two send.
    pub spread_ms: Option<f64>,
    /// What is wrong, in words; empty where nothing is.
    pub problem: String,
}

/// Transport delays differ by less, milliseconds.
const SYNC_GOOD_MS: f64 = 150.0;
/// More than any transport, milliseconds: a clock is wrong.
const SYNC_BAD_MS: f64 = 500.0;

impl SyncState {
    /// By how long samples of each device were under way by its own clock, milliseconds: that is its transport, which is short, and the error of
    /// its clock.
    pub fn of_delays(mut delays_ms: Vec<(f64, &str)>) -> Self {
        delays_ms.sort_by(|a, b| a.0.total_cmp(&b.0));
        let [first, .., last] = delays_ms[..] else {
            return Self::default();
        };
        let spread_ms = last.0 - first.0;
        let level = match spread_ms {
            s if s < SYNC_GOOD_MS => Level::Good,
            s if s < SYNC_BAD_MS => Level::Warning,
            _ => Level::Bad,
        };
        let problem = match level {
            Level::Good => String::new(),
            _ => format!(
                "clocks of {} and {} differ by {spread_ms:.0} ms",
                first.1, last.1
            ),
        };
        Self {
            level,
            spread_ms: Some(spread_ms),
            problem,
        }
    }
}

/// Free space that is little before a recording begins, bytes: a minute of four cameras.
const LITTLE_BYTES: u64 = 10_000_000_000;

/// The disk.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StorageState {
    /// How it is doing.
    pub level: Level,
    /// Free space, bytes.
    pub free_bytes: u64,
    /// Bytes written per second lately.
    pub rate_bytes_s: f64,
    /// Time until it is full at that rate, seconds; `None` while nothing is written.
    pub full_in_s: Option<f64>,
    /// What is wrong, in words; empty where nothing is.
    pub problem: String,
}

impl StorageState {
    /// While nothing is written.
    pub fn idle(free_bytes: u64) -> Self {
        let level = match free_bytes < LITTLE_BYTES {
            true => Level::Warning,
            false => Level::Good,
        };
        Self {
            level,
            free_bytes,
            ..Self::default()
        }
    }
}

/// Charge that is little to begin a walk with, percent.
const LOW_PERCENT: f64 = 25.0;
/// Charge with which the walk should end, percent.
const VERY_LOW_PERCENT: f64 = 10.0;

/// The host's battery.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BatteryState {
    /// How it is doing.
    pub level: Level,
    /// Charge, percent.
    pub percent: f64,
    /// Whether it is being charged.
    pub charging: bool,
}

impl BatteryState {
    /// With so much charge.
    pub fn new(percent: f64, charging: bool) -> Self {
        let level = match percent {
            _ if charging => Level::Good,
            p if p < VERY_LOW_PERCENT => Level::Bad,
            p if p < LOW_PERCENT => Level::Warning,
            _ => Level::Good,
        };
        Self {
            level,
            percent,
            charging,
        }
    }
}

/// Where the rig is, seen from above.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PoseState {
    /// East in the live map, metres.
    pub x_m: f64,
    /// North in the live map, metres.
    pub y_m: f64,
    /// Height in the live map, metres.
    pub z_m: f64,
    /// Direction of the rig's x axis, radians counter-clockwise from the map's x axis.
    pub yaw_rad: f64,
}

/// Whether the live odometry follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tracking {
    /// There is none: no LiDAR, or not yet a scan.
    #[default]
    None,
    /// It follows.
    Good,
    /// The last scans found no place in the map.
    Lost,
    /// No scan has been registered for a while: the map shows the past.
    Frozen,
}

/// A motion that scans do not see, because everything around looks the same from wherever it leads.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UnseenMotion {
    /// Along the direction, or about it.
    pub kind: UnseenKind,
    /// Unit vector in the live map; its opposite is the same motion.
    pub direction_in_map: [f64; 3],
}

/// A motion along a direction, or about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum UnseenKind {
    /// Along it: a corridor without doors, an open field.
    Shift,
    /// About it: a round room.
    Turn,
}

/// How well the place was seen.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CoverageState {
    /// Area seen, square metres.
    pub seen_m2: f64,
    /// Part of it that is well covered.
    pub good_m2: f64,
    /// Places to go back to, the largest first; none while it is not known where the rig is.
    pub go_back: Vec<GoBack>,
}

/// A control point that was marked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControlPoint {
    /// Its name.
    pub name: String,
    /// Where the rig was then, metres; `None` where that was not known.
    pub position_m: Option<[f64; 3]>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_battery_that_is_charged_is_never_low() {
        for (percent, charging, level) in [
            (5.0, false, Level::Bad),
            (17.0, false, Level::Warning),
            (80.0, false, Level::Good),
            (5.0, true, Level::Good),
        ] {
            assert_eq!(BatteryState::new(percent, charging).level, level);
        }
    }

    #[test]
    fn clocks_that_differ_by_more_than_transports_are_named() {
        assert_eq!(
            SyncState::of_delays(vec![(900.0, "imu0")]),
            SyncState::default()
        );
        let near = SyncState::of_delays(vec![(12.0, "lidar"), (2.0, "imu0")]);
        assert_eq!((near.level, near.spread_ms), (Level::Good, Some(10.0)));
        let far = SyncState::of_delays(vec![(1_003.0, "imu0"), (12.0, "lidar")]);
        assert_eq!(far.level, Level::Bad);
        assert_eq!(far.problem, "clocks of lidar and imu0 differ by 991 ms");
    }
}
