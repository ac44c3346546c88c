//! What is shown while scanning: the operator's screen, the terminal, Foxglove and Rerun, all fed by the recorder's tap.
//!
//! One thread, the controller, reads the tap and answers the operator; one more runs the online odometry, and one looks for loops. None is waited
//! for by the recorder: what they are too slow for is recorded without being shown.

mod controller;
mod following;
mod host;
mod loops;
mod messages;
mod odometry;
mod running;
mod streams;
mod unseen;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context as _;
use lsfb_capture::health::Snapshot;
use lsfb_capture::{CaptureReport, DevicesConfig, PhonesListener, Poses, Remarks, Session, Tap};
use lsfb_geometry::Rig;
use lsfb_operator::{Foxglove, Request, Screen, ScreenConfig};
use lsfb_types::Stopped;
use serde::Serialize;

use crate::context::{Context, sentence};
use crate::qr_code;
use controller::{Channels, Controller};
pub use following::LiveOdometryReport;

/// How long a recording that has ended is waited for to be told of by the controller, which may be drawing the map.
const LAST_WORD: Duration = Duration::from_secs(5);

/// Who looks.
#[derive(Clone, Debug, Default)]
pub struct LiveConfig {
    /// The page, and its PINs.
    pub screen: Option<ScreenConfig>,
    /// Where phones connect, open for all recordings; without it each recording opens its own.
    pub phones: Option<PhonesListener>,
    /// Where Foxglove connects.
    pub foxglove: Option<SocketAddr>,
    /// Whether the odometry runs where nobody looks, for the recording alone.
    pub odometry: Odometry,
    /// Where batteries are told of; empty for the kernel's folder.
    pub power_supplies: PathBuf,
    /// URL of a Rerun viewer.
    #[cfg(feature = "view")]
    pub rerun: Option<String>,
}

/// When the odometry runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Odometry {
    /// Where somebody wants to see the map.
    #[default]
    WhereShown,
    /// In any case.
    Always,
}

/// The outputs that are open.
struct Outputs {
    screen: Option<Screen>,
    foxglove: Option<Foxglove>,
    #[cfg(feature = "view")]
    rerun: Option<lsfb_view::LiveView>,
}

impl Outputs {
    fn open(config: &LiveConfig) -> anyhow::Result<(Self, Option<Receiver<Request>>)> {
        let (screen, requests) = match &config.screen {
            Some(config) => {
                let (screen, requests) = Screen::open(config)?;
                (Some(screen), Some(requests))
            }
            None => (None, None),
        };
        let session = format!("lsfb-{}", std::process::id());
        let foxglove = config
            .foxglove
            .map(|address| Foxglove::open(address, &session))
            .transpose()?;
        let outputs = Self {
            screen,
            foxglove,
            #[cfg(feature = "view")]
            rerun: config
                .rerun
                .as_deref()
                .map(lsfb_view::LiveView::connect)
                .transpose()?,
        };
        Ok((outputs, requests))
    }

    /// Whether anybody wants to see the map.
    fn show_map(&self) -> bool {
        #[cfg(feature = "view")]
        let rerun = self.rerun.is_some();
        #[cfg(not(feature = "view"))]
        let rerun = false;
        self.screen.is_some() || self.foxglove.is_some() || rerun
    }
}

/// Tells the controller what the recorder does.
enum Event {
    /// A recording begins.
    Begin(Box<Run>),
    /// It has ended, or never began.
    End(Result<Box<CaptureReport>, String>),
}

/// One recording.
struct Run {
    out: PathBuf,
    devices: DevicesConfig,
    rig: Option<Rig>,
    tap: Tap,
    remarks: Remarks,
    health: Receiver<Snapshot>,
    stop: Arc<AtomicBool>,
    /// Where the rig's poses go, where the odometry runs.
    poses: Option<Poses>,
    /// Who is told in the end what the odometry made of the scans.
    told: SyncSender<LiveOdometryReport>,
}

/// A recording that was made.
#[derive(Clone, Debug, Serialize)]
pub struct Recorded {
    #[serde(flatten)]
    pub capture: CaptureReport,
    /// Absent where the live odometry did not run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub live_odometry: Option<LiveOdometryReport>,
}

/// Everything live, running.
pub struct Live {
    events: SyncSender<Event>,
    starts: Receiver<()>,
    end: Arc<AtomicBool>,
    board: Arc<Mutex<String>>,
    has_odometry: bool,
    thread: Option<JoinHandle<()>>,
    /// Addresses of the screen, with their PINs.
    screens: Vec<(String, Option<String>)>,
    phones: Option<PhonesListener>,
    foxglove: Option<SocketAddr>,
}

impl Live {
    /// Opens the outputs and starts the controller; `out`: the first recording.
    pub fn start(config: &LiveConfig, out: &Path) -> anyhow::Result<Self> {
        let (outputs, requests) = Outputs::open(config)?;
        let screens = screens(config, outputs.screen.as_ref());
        let foxglove = outputs.foxglove.as_ref().map(Foxglove::address);
        let has_odometry = outputs.show_map() || config.odometry == Odometry::Always;
        let (events, happened) = sync_channel(4);
        let (wanted, starts) = sync_channel(1);
        let end = Arc::new(AtomicBool::new(false));
        let board = Arc::new(Mutex::new(String::new()));
        let controller = Controller::new(
            outputs,
            Channels {
                requests,
                events: happened,
                starts: wanted,
                end: Arc::clone(&end),
                board: Arc::clone(&board),
                folder: Some(folder_of(out)),
                power_supplies: if config.power_supplies.as_os_str().is_empty() {
                    host::POWER_SUPPLIES.into()
                } else {
                    config.power_supplies.clone()
                },
            },
        );
        let thread = std::thread::Builder::new()
            .name("live".to_owned())
            .spawn(move || controller.run())
            .context("cannot start the live view's thread")?;
        Ok(Self {
            events,
            starts,
            end,
            board,
            has_odometry,
            thread: Some(thread),
            screens,
            phones: config.phones.clone(),
            foxglove,
        })
    }

    /// What to open, and where.
    pub fn say_where(&self, context: &Context) {
        for (url, pin) in &self.screens {
            let Some(pin) = pin else {
                context.say(&format!("screen: {url}"));
                continue;
            };
            let link = format!("{url}#pin={pin}");
            context.say(&format!("screen: {link}  (PIN {pin})"));
            if url.starts_with("https:") {
                context.note(qr_code::of(&link).trim_end());
                context.note(
                    "Your browser will warn about the rig's self-signed certificate; continue anyway",
                );
            }
        }
        if let Some(address) = self.foxglove {
            context.note(&format!("foxglove: ws://{address}"));
        }
    }

    /// Waits until the operator presses start; `false`: Ctrl-C came first.
    pub fn wait_for_start(&self, context: &Context) -> bool {
        while context.check_stop().is_ok() {
            show(&self.board, context);
            match self.starts.recv_timeout(Duration::from_millis(100)) {
                Ok(()) => return true,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return false,
            }
        }
        false
    }

    /// Records until the devices end, the operator presses stop, or Ctrl-C.
    pub fn record(
        &self,
        devices: &DevicesConfig,
        out: &Path,
        context: &Context,
    ) -> anyhow::Result<Recorded> {
        let (told, heard) = sync_channel(1);
        let outcome = self.record_shown(devices, out, told, context);
        let ended = match &outcome {
            Ok(report) => Ok(Box::new(report.clone())),
            Err(error) => Err(sentence(error)),
        };
        // A controller that died has said so; the recording is made all the same.
        let _ = self.events.send(Event::End(ended));
        let capture = outcome?;
        Ok(Recorded {
            // Without odometry the other end is dropped, and nobody waits.
            live_odometry: heard.recv_timeout(LAST_WORD).ok(),
            capture,
        })
    }

    fn record_shown(
        &self,
        devices: &DevicesConfig,
        out: &Path,
        told: SyncSender<LiveOdometryReport>,
        context: &Context,
    ) -> anyhow::Result<CaptureReport> {
        let mut session = Session::open_with(devices, self.phones.as_ref())?;
        if let Some(address) = session.sidecar_address() {
            context.note(&format!("phones connect to {address}"));
        }
        let stop = Arc::new(AtomicBool::new(false));
        let rig = devices.rig.as_deref().map(Rig::read).transpose()?;
        let can_run = rig.as_ref().is_some_and(|rig| rig.lidar().is_some());
        let has_odometry = self.has_odometry && can_run && !devices.lidars.is_empty();
        let run = Run {
            out: out.to_owned(),
            devices: devices.clone(),
            rig,
            poses: has_odometry.then(|| session.poses()),
            tap: session.tap(),
            remarks: session.remarks(),
            health: session.health().subscribe(),
            stop: Arc::clone(&stop),
            told,
        };
        let _ = self.events.send(Event::Begin(Box::new(run)));
        let board = Arc::clone(&self.board);
        Ok(session.run(out, &|_| {
            show(&board, context);
            match stop.load(Ordering::Relaxed) {
                true => Err(Stopped),
                false => context.check_stop(),
            }
        })?)
    }
}

/// Each address of the screen, and what must be typed there.
fn screens(config: &LiveConfig, screen: Option<&Screen>) -> Vec<(String, Option<String>)> {
    let (Some(config), Some(screen)) = (&config.screen, screen) else {
        return Vec::new();
    };
    let pin_of = |link: &String| match link.starts_with("https:") {
        true => config.secure.as_ref().map(|secure| secure.pin.clone()),
        false => config.pin.clone(),
    };
    let links = screen.links().iter();
    links.map(|link| (link.clone(), pin_of(link))).collect()
}

/// Where a recording goes: what exists of its folder.
fn folder_of(out: &Path) -> PathBuf {
    let absolute = std::path::absolute(out).unwrap_or_else(|_| out.to_owned());
    let mut folders = absolute.ancestors().skip(1);
    folders
        .find(|folder| folder.is_dir())
        .unwrap_or(Path::new("/"))
        .to_owned()
}

fn show(board: &Mutex<String>, context: &Context) {
    let lines = board.lock().unwrap_or_else(PoisonError::into_inner).clone();
    context.show_board(&lines);
}

impl Drop for Live {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported by the panic hook already.
            let _ = thread.join();
        }
    }
}
