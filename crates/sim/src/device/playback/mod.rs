//! Devices that play what others have sent: a recording, or the packets of a capture file.
//!
//! The bytes go out as they were received: LiDAR datagrams, the IMU's byte stream, the CDR of sidecars. Frames of the
//! cameras are put together again from their images and their trailer, and what a unit's own IMU measured waits in it until
//! its host polls. Everything is sent when the devices' own clocks
//! say that it was measured, so that what was recorded faster or slower than it happened plays at the right rate; packets of
//! a capture file when they arrived there.

mod camera;
mod imu;
mod lidar;
mod sidecar;
mod start;
mod unit_imu;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use lsfb_drivers::ImuFamily;
use lsfb_drivers::mynt_s::wire::UnitFile;
use lsfb_drivers::sidecar::ClientConfig;
use lsfb_geometry::Rig;
use lsfb_recording::Recording;
use lsfb_types::Timestamp;

use super::clock::Pace;
use super::mynt::MyntDevice;
use super::session::{SessionReport, SimSession};
use crate::Error;

use self::imu::PlayedUnit;
use self::lidar::LidarPlayer;
use self::sidecar::SidecarPlayer;

/// Between the end of a turn and the beginning of the next.
const PAUSE_NS: i64 = 100_000_000;
/// Files with these endings hold packets of a LiDAR and nothing else.
const CAPTURES: [&str; 4] = ["pcap", "pcapng", "cap", "db3"];

/// How often the source is played.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turns {
    /// This many times, at least once. The devices' own time starts anew with each.
    Times(u32),
    /// Until stopped.
    Endless,
}

impl Turns {
    fn has(self, turn: u32) -> bool {
        match self {
            Self::Times(times) => turn < times.max(1),
            Self::Endless => true,
        }
    }
}

/// Where the devices appear and send to.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaybackEndpoints {
    /// The LiDAR's data packets go here.
    pub lidar_data: SocketAddr,
    /// The LiDAR's position packets go here.
    pub lidar_position: SocketAddr,
    /// Sockets that the camera units make, one for each of [`Playback::cameras`].
    pub camera_sockets: Vec<PathBuf>,
    /// Interface that an SBG unit sends on; its host listens there.
    pub can: String,
    /// Socket that the unit of a Mynt D makes.
    pub usb: PathBuf,
    /// How each of [`Playback::sidecars`] connects, by its name; one that is not here does not.
    pub sidecars: BTreeMap<String, ClientConfig>,
    /// How long sidecars try to connect.
    pub patience: Duration,
}

impl PlaybackEndpoints {
    /// No device has a place: for a recording of which only some are played.
    pub fn nowhere() -> Self {
        let nowhere = SocketAddr::from(([127, 0, 0, 1], 9));
        Self {
            lidar_data: nowhere,
            lidar_position: nowhere,
            camera_sockets: Vec::new(),
            can: String::new(),
            usb: PathBuf::new(),
            sidecars: BTreeMap::new(),
            patience: Duration::ZERO,
        }
    }
}

/// A camera unit as it was recorded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraPlan {
    /// Its cameras, left to right.
    pub names: Vec<String>,
    /// Size of a frame with all images, pixels.
    pub frame_px: [u32; 2],
    /// Frames per second.
    pub rate_hz: u32,
    /// Name of its own IMU, where that was recorded.
    pub imu: Option<String>,
    /// What it keeps: its answers.
    files: BTreeMap<UnitFile, Vec<u8>>,
}

impl CameraPlan {
    fn first_name(&self) -> &str {
        self.names.first().map_or("", String::as_str)
    }
}

/// An inertial unit as it was recorded.
#[derive(Clone, Copy, Debug)]
struct RecordedUnit {
    family: ImuFamily,
    rate_hz: u16,
}

/// What a source holds.
#[derive(Clone, Debug)]
pub struct Playback {
    path: PathBuf,
    capture: bool,
    start: Timestamp,
    lidar: bool,
    cameras: Vec<CameraPlan>,
    imu: Option<RecordedUnit>,
    sidecars: Vec<String>,
    rig: Option<Rig>,
    unplayed: Vec<String>,
}

impl Playback {
    /// Looks at a recording, a pcap or a rosbag2 database.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let ending = path.extension().unwrap_or_default().to_string_lossy();
        if CAPTURES.iter().any(|c| ending.eq_ignore_ascii_case(c)) {
            // Opened here, so that an unreadable file is known before anything starts.
            lidar::capture(path)?;
            return Ok(Self {
                path: path.to_owned(),
                capture: true,
                start: Timestamp::default(),
                lidar: true,
                cameras: Vec::new(),
                imu: None,
                sidecars: Vec::new(),
                rig: None,
                unplayed: Vec::new(),
            });
        }
        let recording = Recording::open(path)?;
        let has = |topic: &str| recording.topics().iter().any(|t| t.topic == topic);
        let lidar = has("/lidar/packets") || has("/lidar/position") || has(lidar::STRANGE_TOPIC);
        let cameras = camera::plans(&recording)?;
        let imu = imu::family(&recording).map(|family| RecordedUnit {
            family,
            rate_hz: imu::rate_hz(&recording),
        });
        let sidecars = sidecar::names(&recording);
        if !lidar && cameras.is_empty() && imu.is_none() && sidecars.is_empty() {
            return Err(Error::Source {
                path: path.to_owned(),
                problem:
                    "no packets, frames or sidecar messages to play; was it recorded from devices?"
                        .to_owned(),
            });
        }
        let mut unplayed = Vec::new();
        if has("/lidar/points") && !has(lidar::DATA_TOPIC) {
            unplayed.push("/lidar/points".to_owned());
        }
        let inside = |imu: &str| cameras.iter().any(|c| c.imu.as_deref() == Some(imu));
        for topic in recording.topics() {
            let name = topic.topic.strip_prefix('/');
            let unit = name.and_then(|name| name.strip_suffix("/data_raw"));
            let played = |unit: &str| match unit {
                imu::SOURCE => imu.is_some(),
                other => inside(other),
            };
            if unit.is_some_and(|unit| !played(unit)) {
                unplayed.push(topic.topic.clone());
            }
        }
        Ok(Self {
            path: path.to_owned(),
            capture: false,
            start: start::of(&recording),
            lidar,
            cameras,
            imu,
            sidecars,
            rig: recording.rig().ok(),
            unplayed,
        })
    }

    /// Whether there are datagrams of a LiDAR.
    pub fn has_lidar(&self) -> bool {
        self.lidar
    }

    /// The camera units.
    pub fn cameras(&self) -> &[CameraPlan] {
        &self.cameras
    }

    /// Samples per second of the IMU; `None` without one.
    pub fn imu_rate_hz(&self) -> Option<u16> {
        self.imu.map(|unit| unit.rate_hz)
    }

    /// What the IMU speaks; `None` without one.
    pub fn imu_family(&self) -> Option<ImuFamily> {
        self.imu.map(|unit| unit.family)
    }

    /// Its sidecars alone.
    pub fn of_sidecars(self) -> Self {
        Self {
            lidar: false,
            cameras: Vec::new(),
            imu: None,
            ..self
        }
    }

    /// Names of the sidecars.
    pub fn sidecars(&self) -> &[String] {
        &self.sidecars
    }

    /// The rig that was recorded.
    pub fn rig(&self) -> Option<&Rig> {
        self.rig.as_ref()
    }

    /// Topics of samples whose raw bytes were not recorded: no device can send them.
    pub fn unplayed(&self) -> &[String] {
        &self.unplayed
    }

    /// Starts the devices. Nothing is sent before each has its host: for a LiDAR aimed at this machine that is somebody who
    /// listens at its port.
    pub fn start(
        &self,
        endpoints: &PlaybackEndpoints,
        pace: Pace,
        turns: Turns,
    ) -> Result<SimSession, Error> {
        let sockets = endpoints.camera_sockets.iter();
        let units = sockets
            .zip(&self.cameras)
            .enumerate()
            .map(|(unit, (path, plan))| MyntDevice::bind_recorded(unit, path, &plan.files))
            .collect::<Result<Vec<_>, _>>()?;
        let devices = usize::from(self.lidar)
            + usize::from(self.imu.is_some())
            + self.cameras.len()
            + endpoints.sidecars.len();
        let once = turns == Turns::Times(0) || turns == Turns::Times(1);
        let span_ns = match (self.capture, once) {
            // A capture has one device, which knows where it ends.
            (true, _) => 0,
            (false, true) => start::span_of_arrivals(&self.path)?,
            (false, false) => start::span(&self.path, self.start)? + PAUSE_NS,
        };
        let mut session = SimSession::empty(devices, pace, span_ns as f64 * 1e-9);
        let mut numbers = 0..devices;
        let mut next = || numbers.next().unwrap_or_default();
        let play = Play {
            path: self.path.clone(),
            capture: self.capture,
            start: self.start,
            span_ns,
            turns,
        };
        if self.lidar {
            let player = LidarPlayer::new(endpoints)?;
            let play = play.clone();
            session.spawn_device("mock-lidar", next(), move |clock, device| {
                player.run(&play, clock, device)
            })?;
        }
        if let Some(RecordedUnit { family, rate_hz }) = self.imu {
            let unit = PlayedUnit::new(family, rate_hz, endpoints)?;
            if let Some(line) = unit.line() {
                session.set_imu_path(line);
            }
            let play = play.clone();
            session.spawn_device("mock-imu", next(), move |clock, device| {
                imu::run(family, unit, rate_hz, &play, clock, device)
            })?;
        }
        for (unit, plan) in units.into_iter().zip(&self.cameras) {
            let (play, plan) = (play.clone(), plan.clone());
            let name = format!("mock-{}", plan.first_name());
            session.spawn_device(&name, next(), move |clock, device| {
                camera::run(unit, &plan, &play, clock, device)
            })?;
        }
        for id in &self.sidecars {
            let Some(rig) = endpoints.sidecars.get(id) else {
                continue;
            };
            let player = SidecarPlayer::new(id, rig.clone(), endpoints.patience);
            let play = play.clone();
            session.spawn_device(&format!("mock-{id}"), next(), move |clock, device| {
                player.run(&play, clock, device)
            })?;
        }
        Ok(session)
    }
}

/// What every player needs to know.
#[derive(Clone, Debug)]
struct Play {
    path: PathBuf,
    capture: bool,
    /// Time of the first sample of any device.
    start: Timestamp,
    /// Time from there to the start of the next turn.
    span_ns: i64,
    turns: Turns,
}

impl Play {
    /// Opens the recording anew: each thread reads for itself.
    fn recording(&self) -> Result<Recording, Error> {
        Ok(Recording::open(&self.path)?)
    }

    /// The turns, each with its offset.
    fn turns(&self) -> impl Iterator<Item = i64> + use<> {
        let Self { turns, span_ns, .. } = *self;
        (0..)
            .take_while(move |turn| turns.has(*turn))
            .map(move |turn| span_ns.saturating_mul(i64::from(turn)))
    }

    /// When something measured at `time` is due, from the start of its turn.
    fn offset_ns(&self, time: Timestamp) -> i64 {
        (time - self.start).max(0)
    }
}

/// Keeps what can be read of a damaged recording.
fn readable<T>(
    items: impl Iterator<Item = Result<T, lsfb_recording::Error>>,
    report: &mut SessionReport,
) -> impl Iterator<Item = T> {
    items.filter_map(|item| match item {
        Ok(item) => Some(item),
        Err(_) => {
            report.unreadable += 1;
            None
        }
    })
}

#[cfg(test)]
mod tests;
