//! A Rerun viewer that is told while it happens.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use lsfb_geometry::{Rig, Se3, Vector3};
use lsfb_types::{Image, ImuSample, Stamped, Timestamp};
use re_sdk::{AsComponents, RecordingStream, RecordingStreamBuilder};
use re_sdk_types::archetypes::{LineStrips3D, Points3D, Scalars, ViewCoordinates};
use re_sdk_types::components::Radius;

use crate::walk::{pinhole, transform};
use crate::{APPLICATION, Error, LINE_RADIUS, TIMELINE};

/// What waits for the viewer; more is passed over.
const QUEUE_ITEMS: usize = 64;
/// How long the last items may take at the end; a viewer that was never there must not hold the recorder.
const FAREWELL: Duration = Duration::from_secs(2);
/// Every n-th inertial sample is shown: 200 Hz is more than a plot can show.
const IMU_STRIDE: u64 = 4;
/// Scans of the map that stay in view, by entity; the oldest is replaced.
const MAP_SCANS: u64 = 600;
/// Every n-th registered scan goes into the map.
const MAP_STRIDE: u64 = 5;
const RIG_ENTITY: &str = "world/live/rig";
const UNSEEN_ENTITY: &str = "world/live/unseen";
const LOOPS_ENTITY: &str = "world/live/loops";
/// Green, as on the operator's page.
const LOOP_COLOUR: [u8; 3] = [0, 129, 62];
/// How far the line along what is not seen reaches to each side, metres.
const UNSEEN_M: f64 = 6.0;
/// Orange, as on the operator's page.
const UNSEEN_COLOUR: [u8; 3] = [255, 122, 0];

/// A connection to a viewer. Nothing here ever waits for it: a thread of its own sends, and what it is too slow for is passed
/// over.
#[derive(Debug)]
pub struct LiveView {
    queue: Option<SyncSender<Item>>,
    done: Receiver<()>,
    missed: Arc<AtomicU64>,
}

#[derive(Debug)]
enum Item {
    Rig(Box<Rig>),
    Image(String, Stamped<Image>),
    Imu(Stamped<ImuSample>),
    BeginAgain,
    Loop {
        time: Timestamp,
        earlier: Vector3<f64>,
        later: Vector3<f64>,
    },
    Step {
        time: Timestamp,
        world_from_rig: Se3,
        points_in_rig: Vec<Vector3<f64>>,
        unseen_in_world: Option<Vector3<f64>>,
    },
}

impl LiveView {
    /// Sends to the viewer at `url`, for instance `rerun+http://127.0.0.1:9876/proxy`, once it is there.
    pub fn connect(url: &str) -> Result<Self, Error> {
        let failed = |message: String| Error::Viewer {
            url: url.to_owned(),
            message,
        };
        let stream = RecordingStreamBuilder::new(APPLICATION)
            .recording_name("live")
            .connect_grpc_opts(url)
            .map_err(|error| failed(error.to_string()))?;
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        let (queue, items) = sync_channel(QUEUE_ITEMS);
        let (finished, done) = sync_channel(1);
        std::thread::Builder::new()
            .name("rerun".to_owned())
            .spawn(move || {
                let mut sender = Sender::new(stream);
                for item in items {
                    sender.send(item);
                }
                // Dropping the stream waits for the viewer.
                drop(sender);
                let _ = finished.try_send(());
            })
            .map_err(|error| failed(error.to_string()))?;
        Ok(Self {
            queue: Some(queue),
            done,
            missed: Arc::default(),
        })
    }

    /// What was passed over because the viewer is slow or absent.
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }

    /// Shows where the cameras are.
    pub fn rig(&self, rig: &Rig) {
        self.put(|| Item::Rig(Box::new(rig.clone())));
    }

    /// Shows an image of a camera.
    pub fn image(&self, camera: &str, image: &Stamped<Image>) {
        self.put(|| Item::Image(camera.to_owned(), image.clone()));
    }

    /// Shows an inertial sample.
    pub fn imu(&self, sample: &Stamped<ImuSample>) {
        self.put(|| Item::Imu(sample.clone()));
    }

    /// Forgets the path: the walk began otherwise than was thought, and its steps come anew.
    pub fn begin_again(&self) {
        self.put(|| Item::BeginAgain);
    }

    /// Shows where the rig is, what the LiDAR saw from there, and the direction along or about which it sees no motion, where there is one.
    pub fn step(
        &self,
        time: Timestamp,
        world_from_rig: &Se3,
        points_in_rig: &[Vector3<f64>],
        unseen_in_world: Option<Vector3<f64>>,
    ) {
        self.put(|| Item::Step {
            time,
            world_from_rig: *world_from_rig,
            points_in_rig: points_in_rig.to_vec(),
            unseen_in_world,
        });
    }

    /// Shows that a place was recognised at the end of a scan: where the walk has it, and where it had it before.
    pub fn found_loop(&self, time: Timestamp, earlier: &Vector3<f64>, later: &Vector3<f64>) {
        self.put(|| Item::Loop {
            time,
            earlier: *earlier,
            later: *later,
        });
    }

    fn put(&self, item: impl FnOnce() -> Item) {
        let sent = self
            .queue
            .as_ref()
            .is_some_and(|q| q.try_send(item()).is_ok());
        if !sent {
            self.missed.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Drop for LiveView {
    fn drop(&mut self) {
        self.queue = None;
        match self.done.recv_timeout(FAREWELL) {
            // A viewer that does not answer is left behind with its thread.
            Ok(()) | Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
        }
    }
}

/// The end that may wait.
struct Sender {
    stream: RecordingStream,
    samples: u64,
    scans: u64,
    path: Vec<[f32; 3]>,
    loops: Vec<[[f32; 3]; 2]>,
    shows_unseen: bool,
}

impl Sender {
    fn new(stream: RecordingStream) -> Self {
        let sender = Self {
            stream,
            samples: 0,
            scans: 0,
            path: Vec::new(),
            loops: Vec::new(),
            shows_unseen: false,
        };
        sender.log_static("world", &ViewCoordinates::RIGHT_HAND_Z_UP());
        sender
    }

    fn send(&mut self, item: Item) {
        match item {
            Item::Rig(rig) => {
                for (name, camera) in &rig.cameras {
                    let entity = format!("{RIG_ENTITY}/{name}");
                    self.log_static(&entity, &transform(&camera.rig_from_camera));
                    self.log_static(&entity, &pinhole(&camera.camera));
                }
                self.samples = 0;
                self.begin_again();
            }
            Item::Image(camera, image) => {
                self.set_time(image.time);
                let Image {
                    width,
                    height,
                    pixels,
                    ..
                } = image.sample;
                let shown = re_sdk_types::archetypes::Image::from_l8(pixels, [width, height]);
                self.log(&format!("{RIG_ENTITY}/{camera}"), &shown);
            }
            Item::Imu(sample) => {
                self.samples += 1;
                if self.samples.is_multiple_of(IMU_STRIDE) {
                    self.set_time(sample.time);
                    let ImuSample {
                        angular_velocity_rad_s,
                        specific_force_m_s2,
                    } = sample.sample;
                    self.log("imu/live/gyro_rad_s", &Scalars::new(angular_velocity_rad_s));
                    self.log("imu/live/accel_m_s2", &Scalars::new(specific_force_m_s2));
                }
            }
            Item::BeginAgain => self.begin_again(),
            Item::Loop {
                time,
                earlier,
                later,
            } => {
                self.set_time(time);
                let visits = [earlier, later].map(|p| p.map(|v| v as f32).into());
                self.loops.push(visits);
                self.show_loops();
            }
            Item::Step {
                time,
                world_from_rig,
                points_in_rig,
                unseen_in_world,
            } => {
                self.step(time, &world_from_rig, &points_in_rig);
                self.unseen(&world_from_rig.translation, unseen_in_world);
            }
        }
    }

    /// What was shown is replaced as steps come: the first scan of the map takes the place of the first.
    fn begin_again(&mut self) {
        self.scans = 0;
        self.path.clear();
        if !self.loops.is_empty() {
            self.loops.clear();
            self.show_loops();
        }
    }

    /// Places that were recognised: a line between both visits of each, which has no length where the odometry has not drifted.
    fn show_loops(&self) {
        let lines = LineStrips3D::new(self.loops.iter().map(|visits| visits.as_slice()))
            .with_radii([Radius::new_ui_points(2.0 * LINE_RADIUS)])
            .with_colors([LOOP_COLOUR]);
        self.log(LOOPS_ENTITY, &lines);
        let places = Points3D::new(self.loops.iter().map(|[_, later]| *later))
            .with_radii([Radius::new_ui_points(4.0 * LINE_RADIUS)])
            .with_colors([LOOP_COLOUR])
            .with_labels(self.loops.iter().map(|_| "recognised"));
        self.log(&format!("{LOOPS_ENTITY}/places"), &places);
    }

    fn step(&mut self, time: Timestamp, world_from_rig: &Se3, points_in_rig: &[Vector3<f64>]) {
        self.set_time(time);
        self.log(RIG_ENTITY, &transform(world_from_rig));
        let to_world = |p: &Vector3<f64>| -> [f32; 3] {
            let point = world_from_rig.rotation * p + world_from_rig.translation;
            [point.x as f32, point.y as f32, point.z as f32]
        };
        if self.scans.is_multiple_of(MAP_STRIDE) {
            let points = Points3D::new(points_in_rig.iter().map(to_world))
                .with_radii([Radius::new_ui_points(1.5)]);
            let slot = self.scans / MAP_STRIDE % MAP_SCANS;
            self.log(&format!("world/live/map/{slot}"), &points);
        }
        self.path.push(to_world(&Vector3::zeros()));
        // The whole line is sent anew.
        if self.scans.is_multiple_of(MAP_STRIDE) {
            let line = LineStrips3D::new([self.path.as_slice()])
                .with_radii([Radius::new_ui_points(LINE_RADIUS)]);
            self.log("world/live/path", &line);
        }
        self.scans += 1;
    }

    /// A line through the rig; without one that which was there goes.
    fn unseen(&mut self, at: &Vector3<f64>, direction: Option<Vector3<f64>>) {
        if direction.is_none() && !self.shows_unseen {
            return;
        }
        self.shows_unseen = direction.is_some();
        let line = direction.map(|d| {
            let end = |side: f64| {
                let end = at + d * (side * UNSEEN_M);
                [end.x as f32, end.y as f32, end.z as f32]
            };
            [end(-1.0), end(1.0)]
        });
        let lines = LineStrips3D::new(line)
            .with_radii([Radius::new_ui_points(2.0 * LINE_RADIUS)])
            .with_colors([UNSEEN_COLOUR])
            .with_labels(line.map(|_| "not seen by the LiDAR"));
        self.log(UNSEEN_ENTITY, &lines);
    }

    fn set_time(&self, time: Timestamp) {
        self.stream
            .set_timestamp_nanos_since_epoch(TIMELINE, time.nanos());
    }

    // The stream refuses only what cannot be encoded; what is lost on the way it does not tell.
    fn log(&self, entity: &str, what: &impl AsComponents) {
        let _ = self.stream.log(entity, what);
    }

    fn log_static(&self, entity: &str, what: &impl AsComponents) {
        let _ = self.stream.log_static(entity, what);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    #[test]
    fn a_viewer_that_is_not_there_holds_nobody() {
        let view = LiveView::connect("rerun+http://127.0.0.1:9/proxy").unwrap();
        let began = Instant::now();
        let time = Timestamp::from_nanos(1_772_359_200_000_000_000);
        for n in 0..2_000 {
            let points = vec![Vector3::new(1.0, 2.0, f64::from(n)); 100];
            let unseen = (n % 2 == 0).then(Vector3::x);
            view.step(
                time.plus_nanos(i64::from(n)),
                &Se3::identity(),
                &points,
                unseen,
            );
        }
        assert!(
            began.elapsed() < Duration::from_secs(1),
            "{:?}",
            began.elapsed()
        );
        assert!(view.missed() > 0);
        drop(view);
        assert!(
            began.elapsed() < Duration::from_secs(5),
            "{:?}",
            began.elapsed()
        );
    }

    /// Steps of a walk that began otherwise were a path that jumped.
    #[test]
    fn a_walk_that_begins_again_has_one_path() {
        let mut sender = Sender::new(RecordingStream::disabled());
        let step = |x_m: f64| Item::Step {
            time: Timestamp::from_nanos(0),
            world_from_rig: Se3 {
                translation: Vector3::new(x_m, 0.0, 0.0),
                ..Se3::identity()
            },
            points_in_rig: Vec::new(),
            unseen_in_world: None,
        };
        let found = Item::Loop {
            time: Timestamp::from_nanos(0),
            earlier: Vector3::zeros(),
            later: Vector3::x(),
        };
        for item in [step(0.0), step(1.0), found] {
            sender.send(item);
        }
        assert_eq!(sender.loops, [[[0.0; 3], [1.0, 0.0, 0.0]]]);
        let items = [Item::BeginAgain, step(0.0), step(2.0)];
        items.into_iter().for_each(|item| sender.send(item));
        assert_eq!(sender.path, [[0.0; 3], [2.0, 0.0, 0.0]]);
        assert!(sender.loops.is_empty());
        assert_eq!(sender.scans, 2);
    }

    #[test]
    fn an_address_that_is_none_is_refused() {
        for url in ["", "127.0.0.1", "http://127.0.0.1:80/x"] {
            let message = LiveView::connect(url).unwrap_err().to_string();
            assert!(message.contains("rerun+http"), "{message}");
        }
    }
}
