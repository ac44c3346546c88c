//! The thread that reads the tap, answers the operator and shows everything.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use lsfb_capture::{CaptureReport, Tapped};
use lsfb_geometry::{Rig, Se3, Vector3};
use lsfb_operator::{
    Command, ControlPoint, Level, LiveMap, LoopState, MapConfig, Phase, Preview, Request,
    ScreenState, Tracking, Viewer, terminal,
};
use lsfb_pipeline::loops::OnlineLoop;
use lsfb_pipeline::odometry::StepOutcome;

use super::host;
use super::loops::LoopsThread;
use super::odometry::{LiveStep, OdometryThread};
use super::running::{Running, host_now, position};
use super::unseen::sentence_of;
use super::{Event, Outputs, Run};
use crate::context::sentence;

/// How long the tap is waited for before the rest is looked at.
const TAP_WAIT: Duration = Duration::from_millis(20);
/// Entries of the tap taken at once.
const TAP_BATCH: usize = 256;
/// Between two states.
const STATE_EVERY: Duration = Duration::from_millis(200);
/// Between two maps.
const MAP_EVERY: Duration = Duration::from_millis(500);
/// Between two looks at disk and battery.
const HOST_EVERY: Duration = Duration::from_secs(1);
/// Names of remarks in the recording.
const NOTE: &str = "note";
const CONTROL_POINT: &str = "control-point";

/// What the controller holds of the rest.
pub struct Channels {
    pub requests: Option<Receiver<Request>>,
    pub events: Receiver<Event>,
    pub starts: SyncSender<()>,
    pub end: Arc<AtomicBool>,
    pub board: Arc<Mutex<String>>,
    pub folder: Option<PathBuf>,
    pub power_supplies: PathBuf,
}

/// See the module's page.
pub struct Controller {
    outputs: Outputs,
    channels: Channels,
    state: ScreenState,
    map: LiveMap,
    running: Option<Running>,
    /// Where recordings go.
    folder: Option<PathBuf>,
    shown: Shown,
}

/// When what was shown last.
struct Shown {
    state: Instant,
    map: Instant,
    host: Instant,
}

impl Controller {
    pub fn new(outputs: Outputs, channels: Channels) -> Self {
        let long_ago = Instant::now();
        Self {
            outputs,
            state: ScreenState {
                message: "Press START to begin.".to_owned(),
                message_level: Level::Good,
                ..ScreenState::default()
            },
            map: LiveMap::new(MapConfig::default(), Vec::new()),
            folder: channels.folder.clone(),
            channels,
            running: None,
            shown: Shown {
                state: long_ago,
                map: long_ago,
                host: long_ago,
            },
        }
    }

    /// Works until it is told to end.
    pub fn run(mut self) {
        self.look_at_host();
        while !self.channels.end.load(Ordering::Relaxed) {
            while let Ok(event) = self.channels.events.try_recv() {
                match event {
                    Event::Begin(run) => self.begin(*run),
                    Event::End(outcome) => self.end(outcome),
                }
            }
            self.answer_requests();
            self.read_tap();
            self.read_odometry();
            self.show();
        }
    }

    fn begin(&mut self, run: Run) {
        self.map
            .restart(run.rig.as_ref().map_or_else(Vec::new, viewers));
        let name = run.out.file_name().unwrap_or_default();
        self.state = ScreenState {
            phase: Phase::Starting,
            file: name.to_string_lossy().into_owned(),
            battery: self.state.battery.take(),
            ..ScreenState::default()
        };
        let odometry = run
            .rig
            .as_ref()
            .filter(|_| run.poses.is_some())
            .map(OdometryThread::start)
            .transpose();
        let odometry = odometry.unwrap_or_else(|error| {
            self.state.message = format!("There is no live map: {}", sentence(&error));
            self.state.message_level = Level::Warning;
            None
        });
        let loops = run
            .rig
            .as_ref()
            .filter(|_| odometry.is_some() && self.outputs.show_map())
            .map_or(Ok(None), LoopsThread::start);
        let loops = loops.unwrap_or_else(|error| {
            self.state.message = format!("Loops are not looked for: {}", sentence(&error));
            self.state.message_level = Level::Warning;
            None
        });
        if let Some(screen) = &self.outputs.screen {
            screen.clear_previews();
        }
        if let Some(rig) = &run.rig {
            self.outputs.send_rig(rig, host_now());
        }
        self.running = Some(Running::new(run, odometry, loops));
    }

    fn end(&mut self, outcome: Result<Box<CaptureReport>, String>) {
        self.read_tap();
        self.read_odometry();
        let state = &mut self.state;
        state.phase = Phase::Ready;
        state.tracking = Tracking::None;
        state.tracking_problem = String::new();
        state.unseen = None;
        match outcome {
            Ok(report) => {
                if let Some(running) = &mut self.running {
                    running.streams.end(&report.streams);
                    state.streams = running.streams.states();
                    running.tell();
                }
                state.lost = report.lost;
                state.message_level = if report.lost == 0 {
                    Level::Good
                } else {
                    Level::Bad
                };
                state.message = format!(
                    "{} saved: {:.1} MB, {}.",
                    state.file,
                    report.bytes as f64 / 1e6,
                    match report.lost {
                        0 => "nothing lost".to_owned(),
                        lost => format!("{lost} LOST; see the report on the terminal"),
                    }
                );
            }
            Err(problem) => {
                state.message_level = Level::Bad;
                state.message = problem;
            }
        }
        self.running = None;
        self.look_at_host();
        self.publish_map();
    }

    fn answer_requests(&mut self) {
        let Some(requests) = self.channels.requests.take() else {
            return;
        };
        while let Ok(request) = requests.try_recv() {
            let outcome = self.handle(&request.command);
            request.answer(outcome);
        }
        self.channels.requests = Some(requests);
    }

    fn handle(&mut self, command: &Command) -> Result<String, String> {
        match (command, &self.running) {
            (Command::Start, None) => {
                self.state.phase = Phase::Starting;
                self.state.message = "Opening the devices …".to_owned();
                self.state.message_level = Level::Good;
                // One start is enough.
                let _ = self.channels.starts.try_send(());
                Ok(String::new())
            }
            (Command::Start, Some(_)) => Err("A recording is running already.".to_owned()),
            (_, None) => Err("No recording is running.".to_owned()),
            (Command::Stop, Some(running)) => {
                running.stop.store(true, Ordering::Relaxed);
                self.state.phase = Phase::Stopping;
                Ok(String::new())
            }
            (Command::Note { text }, Some(running)) => {
                running.remark(&self.state, NOTE, text)?;
                self.state.notes += 1;
                Ok("Note saved.".to_owned())
            }
            (Command::ControlPoint { name }, Some(running)) => {
                running.remark(&self.state, CONTROL_POINT, name)?;
                let position_m = position(&self.state);
                self.state.control_points.push(ControlPoint {
                    name: name.clone(),
                    position_m,
                });
                Ok(match position_m {
                    Some(_) => format!("Point {name} saved."),
                    None => {
                        format!(
                            "Point {name} saved without a position, because the live map has none."
                        )
                    }
                })
            }
        }
    }

    fn read_tap(&mut self) {
        let Some(running) = &mut self.running else {
            std::thread::sleep(TAP_WAIT);
            return;
        };
        let mut wait = TAP_WAIT;
        for _ in 0..TAP_BATCH {
            let entry = match running.tap.next(wait) {
                Ok(Some(entry)) => entry,
                Ok(None) => return,
                // The recording ends; its report comes as an event.
                Err(lsfb_capture::TapClosed) => {
                    std::thread::sleep(wait);
                    return;
                }
            };
            wait = Duration::ZERO;
            if self.state.phase == Phase::Starting {
                self.state.phase = Phase::Recording;
                running.began = Instant::now();
            }
            running.note(&entry);
            self.outputs.send(&entry, &mut running.cameras_sent);
            if let (Some(screen), Tapped::Image { camera, image }) = (&self.outputs.screen, &entry)
                && running.preview_is_due(camera)
                && let Some(preview) = Preview::of(&image.sample)
            {
                screen.publish_preview(camera, preview);
            }
            running.feed_odometry(entry);
        }
    }

    fn read_odometry(&mut self) {
        let Some(odometry) = self.running.as_ref().and_then(|r| r.odometry.as_ref()) else {
            return;
        };
        let mut steps = Vec::new();
        while let Some(step) = odometry.next_step() {
            steps.push(step);
        }
        for live in steps {
            self.take_step(&live);
            if let Some(loops) = self.running.as_mut().and_then(|r| r.loops.as_mut()) {
                loops.push(live.step);
            }
        }
        let loops = self.running.as_ref().and_then(|r| r.loops.as_ref());
        let next = || loops.and_then(LoopsThread::next_loop);
        let found: Vec<OnlineLoop> = std::iter::from_fn(next).collect();
        for found in found {
            self.take_loop(&found);
        }
    }

    fn take_loop(&mut self, found: &OnlineLoop) {
        if let Some(running) = &mut self.running {
            running.following.loops += 1;
        }
        let place = |pose: &Se3| [pose.translation.x, pose.translation.y];
        self.state.take_loop(LoopState {
            earlier_m: place(&found.world_from_earlier),
            later_m: place(&found.world_from_later),
            off_m: found.off_m,
        });
        self.outputs.send_loop(found);
    }

    fn take_step(&mut self, live: &LiveStep) {
        let step = &live.step;
        if let Some(running) = &mut self.running {
            running.following.take(live, Instant::now());
            if let (Some(poses), Some(pose)) = (&running.poses, &live.at_cloud) {
                poses.put(pose, host_now());
            }
        }
        self.state.tracking = match step.outcome {
            StepOutcome::Lost => Tracking::Lost,
            StepOutcome::First | StepOutcome::Registered => Tracking::Good,
        };
        if step.begins_again() {
            self.map.begin_again();
            self.state.forget_loops();
        }
        for placed in step.placed() {
            let points = &placed.keypoints_in_rig;
            self.map.push(placed.time, &placed.world_from_rig, points);
        }
        self.outputs.send_step(live, host_now());
    }

    fn show(&mut self) {
        let now = Instant::now();
        if now.duration_since(self.shown.host) >= HOST_EVERY {
            self.look_at_host();
        }
        if now.duration_since(self.shown.map) >= MAP_EVERY && self.running.is_some() {
            self.publish_map();
        }
        if now.duration_since(self.shown.state) >= STATE_EVERY {
            self.shown.state = now;
            if let Some(running) = &mut self.running {
                let state = &mut self.state;
                if state.phase != Phase::Starting {
                    state.recording_s = now.duration_since(running.began).as_secs_f64();
                }
                while let Ok(snapshot) = running.health.try_recv() {
                    running.streams.take(&snapshot, now);
                    state.storage = Some(host::recording_storage(&snapshot.storage));
                }
                state.streams = running.streams.states();
                state.sync = running.streams.sync(now);
                state.lost = running.streams.lost();
                // Where the rig is lost, that is what matters.
                state.unseen = running
                    .following
                    .unseen
                    .shown(now)
                    .filter(|_| state.tracking == Tracking::Good);
                if let Some(problem) = running.frozen(now) {
                    state.tracking = Tracking::Frozen;
                    state.tracking_problem = problem;
                } else {
                    state.tracking_problem = match state.tracking {
                        Tracking::Lost => running.following.lost_sentence(now),
                        _ => state.unseen.as_ref().map_or_else(String::new, sentence_of),
                    };
                }
                if !matches!(state.tracking, Tracking::None | Tracking::Good) {
                    // Directions are as wrong as the pose that they start from.
                    state.coverage.go_back.clear();
                }
                state.pose = self.map.pose();
                state.path_m = self.map.path_m();
                let skipped = running.odometry.as_ref().map(OdometryThread::skipped);
                state.skipped_scans = skipped.map_or(0, |skipped| skipped.scans);
            }
            if let Some(screen) = &self.outputs.screen {
                screen.publish(&self.state);
            }
            let lines = terminal::lines(&self.state);
            *self
                .channels
                .board
                .lock()
                .unwrap_or_else(PoisonError::into_inner) = lines;
        }
    }

    fn publish_map(&mut self) {
        self.shown.map = Instant::now();
        self.state.coverage = self.map.coverage();
        if matches!(self.state.tracking, Tracking::Lost | Tracking::Frozen) {
            self.state.coverage.go_back.clear();
        }
        if let Some(screen) = &self.outputs.screen {
            screen.publish_map(self.map.snapshot());
        }
    }

    fn look_at_host(&mut self) {
        let now = Instant::now();
        self.shown.host = now;
        self.state.battery = host::battery(&self.channels.power_supplies);
        // While it records, the recorder says it.
        if self.running.is_none() {
            self.state.storage = self.folder.as_deref().and_then(host::idle_storage);
        }
    }
}

/// The cameras of a rig, seen from above.
fn viewers(rig: &Rig) -> Vec<Viewer> {
    rig.cameras
        .values()
        .map(|camera| {
            let axis = camera.rig_from_camera.rotation * Vector3::z();
            let [focal_px, _] = camera.camera.focal_px();
            Viewer {
                yaw_rad: axis.y.atan2(axis.x),
                half_fov_rad: (0.5 * f64::from(camera.camera.width) / focal_px).atan(),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use lsfb_pipeline::loops::{Loop, LoopDecision, LoopScores};

    use super::super::odometry::tests::live;
    use super::*;

    fn controller() -> Controller {
        let outputs = Outputs {
            screen: None,
            foxglove: None,
            #[cfg(feature = "view")]
            rerun: None,
        };
        let channels = Channels {
            requests: None,
            events: sync_channel(1).1,
            starts: sync_channel(1).0,
            end: Arc::default(),
            board: Arc::default(),
            folder: None,
            power_supplies: PathBuf::new(),
        };
        Controller::new(outputs, channels)
    }

    /// A place that was recognised was said nowhere while one walked.
    #[test]
    fn loops_are_shown_until_the_walk_begins_again() {
        let mut controller = controller();
        let at = |x_m: f64| Se3 {
            translation: Vector3::new(x_m, 2.0, 1.0),
            ..Se3::identity()
        };
        let now = Instant::now();
        let step = live(99, StepOutcome::First, now).step;
        for k in 0..30 {
            controller.take_loop(&OnlineLoop {
                found: Loop {
                    earlier: step.time,
                    later: step.time,
                    decision: LoopDecision::Accepted,
                    scores: LoopScores::default(),
                    measured: None,
                },
                world_from_earlier: at(0.0),
                world_from_later: at(f64::from(k)),
                off_m: 0.1,
            });
        }
        assert_eq!(controller.state.loop_count, 30);
        let last = controller.state.loops.last().expect("a loop");
        assert_eq!((last.earlier_m, last.later_m), ([0.0, 2.0], [29.0, 2.0]));
        // What is sent five times a second stays small.
        assert!(controller.state.loops.len() <= 20);
        controller.take_step(&live(99, StepOutcome::First, now));
        assert_eq!(controller.state.loop_count, 0);
        assert!(controller.state.loops.is_empty());
    }

    /// The rig moves a metre per millisecond. Predictions of lost scans grew the path, and steps that came anew did not replace it.
    #[test]
    fn the_map_has_what_found_its_place_and_nothing_else() {
        use StepOutcome::{First, Lost, Registered};
        let now = Instant::now();
        let mut controller = controller();
        let shown = |controller: &Controller| {
            let x_m = controller.map.pose().map(|pose| pose.x_m.round());
            (controller.map.path_m().round(), x_m)
        };
        controller.take_step(&live(99, First, now));
        controller.take_step(&live(199, Registered, now));
        assert_eq!(shown(&controller), (100.0, Some(199.0)));
        assert_eq!(controller.state.tracking, Tracking::Good);
        controller.take_step(&live(299, Lost, now));
        assert_eq!(shown(&controller), (100.0, Some(199.0)));
        assert_eq!(controller.state.tracking, Tracking::Lost);
        // It had begun at another velocity: twice the way, and the third has no place still.
        let mut telling = live(399, Registered, now);
        let anew = [(99, First), (199, Registered), (299, Lost)];
        telling.step.anew = anew.map(|(ms, outcome)| live(ms, outcome, now).step).into();
        telling.step.world_from_rig.translation *= 2.0;
        for step in &mut telling.step.anew {
            step.world_from_rig.translation *= 2.0;
        }
        controller.take_step(&telling);
        assert_eq!(shown(&controller), (600.0, Some(798.0)));
        assert_eq!(controller.state.tracking, Tracking::Good);
    }
}
