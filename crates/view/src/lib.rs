//! Maps, trajectories and recordings as an `.rrd` file for the [Rerun](https://rerun.io) viewer.
//!
//! This is the only crate that sees Rerun, 40 % of a full build. Everything is on one timeline, `time`: the synchronized
//! time of the recordings. Entities:
//!
//! | path | what |
//! | --- | --- |
//! | `world/map` | points of the HD map |
//! | `world/surface` | points of a LiDAR map |
//! | `world/cameras/<name>` | the images of a map's keyframes as pyramids |
//! | `world/trajectories/<name>` | trajectories as lines |
//! | `world/<walk>/rig` | pose of the rig |
//! | `world/<walk>/rig/<camera>` | images below their pinhole; lens distortion is not shown |
//! | `world/<walk>/scan` | LiDAR scans in the world, each point at the pose of its own time |
//! | `imu/<walk>/gyro_rad_s`, `imu/<walk>/accel_m_s2` | inertial samples |
//!
//! To look at what the tests write, `LSFB_KEEP_VIEW=<folder> cargo test --release -p lsfb-view`, then `rerun <folder>/walk.rrd`
//! with PyPI `rerun-sdk` of the same version; the viewer opens `<folder>/walk.mcap` as well.
//!
//! ```no_run
//! use lsfb_recording::{Recording, read_tum};
//! use lsfb_view::{ViewConfig, ViewInputs, Walk, write_rrd};
//!
//! let recording = Recording::open("scan.mcap".as_ref())?;
//! let walk = Walk {
//!     name: "scan".into(),
//!     rig: recording.rig()?,
//!     recording: &recording,
//!     world_from_rig: read_tum("scan.tum".as_ref())?,
//! };
//! let inputs = ViewInputs { walks: vec![walk], ..ViewInputs::default() };
//! write_rrd("demo.rrd".as_ref(), &inputs, &ViewConfig::default(), &lsfb_types::no_progress)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod layout;
mod live;
mod walk;

use std::path::{Path, PathBuf};

use lsfb_geometry::{Rig, Trajectory};
use lsfb_recording::Recording;
use lsfb_types::{Progress, ProgressFn};
use re_sdk::{AsComponents, RecordingStream, RecordingStreamBuilder};
use re_sdk_types::archetypes::{LineStrips3D, Points3D, ViewCoordinates};
use re_sdk_types::components::{Color, Radius};

pub use live::LiveView;

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The viewer's library refused.
    #[error("{}: cannot write the view: {message}", path.display())]
    Rerun {
        /// The file being written.
        path: PathBuf,
        /// Why.
        message: String,
    },
    /// A viewer cannot be told.
    #[error("{url}: {message}; expected an address like rerun+http://127.0.0.1:9876/proxy")]
    Viewer {
        /// Its address.
        url: String,
        /// Why.
        message: String,
    },
    /// Positions and colours do not belong together.
    #[error("map has {positions} positions but {colors} colours; give one colour each, or none")]
    MapColors {
        /// Number of positions.
        positions: usize,
        /// Number of colours.
        colors: usize,
    },
    /// A recording cannot be read.
    #[error(transparent)]
    Recording(#[from] lsfb_recording::Error),
    /// The progress callback asked for an early end.
    #[error("{0}")]
    Stopped(#[from] lsfb_types::Stopped),
}

/// Points of a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapPoints {
    /// Positions in the world, metres.
    pub positions_m: Vec<[f32; 3]>,
    /// One colour each (red, green, blue), or none at all.
    pub colors_rgb: Vec<[u8; 3]>,
}

/// A trajectory and how it is drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedTrajectory {
    /// Its name in the viewer.
    pub name: String,
    /// The poses.
    pub trajectory: Trajectory,
    /// Red, green, blue.
    pub color_rgb: [u8; 3],
}

/// The images that one camera took, each as a pyramid whose tip is the camera's centre and whose base is what it sees.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPyramids {
    /// The camera's name.
    pub name: String,
    /// Lines through points in the world, metres.
    pub strips_m: Vec<Vec<[f32; 3]>>,
    /// Red, green, blue.
    pub color_rgb: [u8; 3],
}

/// A recording and where its rig was.
pub struct Walk<'a> {
    /// Its name in the viewer.
    pub name: String,
    /// Images, scans and inertial samples.
    pub recording: &'a Recording,
    /// The sensors.
    pub rig: Rig,
    /// Poses; what was measured outside them is shown without place (images) or left out (scans).
    pub world_from_rig: Trajectory,
}

/// What is shown.
#[derive(Default)]
pub struct ViewInputs<'a> {
    /// Points of the HD map.
    pub map: MapPoints,
    /// Points of a LiDAR map.
    pub surface: MapPoints,
    /// Images of the map's keyframes.
    pub cameras: Vec<CameraPyramids>,
    /// Trajectories, one line each.
    pub trajectories: Vec<NamedTrajectory>,
    /// Recordings.
    pub walks: Vec<Walk<'a>>,
}

/// How much of it is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewConfig {
    /// Shortest time between two images of a camera, seconds.
    pub image_period_secs: f64,
    /// Shortest time between two scans, seconds.
    pub scan_period_secs: f64,
    /// Shortest time between two inertial samples, seconds.
    pub imu_period_secs: f64,
    /// Most points of one scan; the rest is left out evenly.
    pub points_per_scan: usize,
}

impl Default for ViewConfig {
    fn default() -> Self {
        Self {
            image_period_secs: 0.5,
            scan_period_secs: 0.5,
            imu_period_secs: 0.02,
            points_per_scan: 10_000,
        }
    }
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ViewReport {
    /// Images.
    pub images: u64,
    /// Scans.
    pub scans: u64,
    /// Inertial samples.
    pub imu_samples: u64,
    /// Messages or chunks that could not be read.
    pub unreadable: u64,
}

const APPLICATION: &str = "lsfb";
/// Radii in points of the screen: visible from any distance.
const MAP_POINT_RADIUS: f32 = 1.5;
const LINE_RADIUS: f32 = 2.0;
const SURFACE_POINT_RADIUS: f32 = 1.0;
const PYRAMID_RADIUS: f32 = 0.7;
/// The one timeline.
const TIMELINE: &str = "time";

/// Writes everything into `out`, replacing a file of that name. After an error nothing is left of it.
pub fn write_rrd(
    out: &Path,
    inputs: &ViewInputs<'_>,
    config: &ViewConfig,
    progress: ProgressFn<'_>,
) -> Result<ViewReport, Error> {
    for map in [&inputs.map, &inputs.surface] {
        if !map.colors_rgb.is_empty() && map.colors_rgb.len() != map.positions_m.len() {
            return Err(Error::MapColors {
                positions: map.positions_m.len(),
                colors: map.colors_rgb.len(),
            });
        }
    }
    let view = View::create(out, inputs)?;
    let written = log_all(&view, inputs, config, progress);
    if written.is_err() {
        drop(view);
        // What matters is the error above.
        let _ = std::fs::remove_file(out);
    }
    written
}

fn log_all(
    view: &View,
    inputs: &ViewInputs<'_>,
    config: &ViewConfig,
    progress: ProgressFn<'_>,
) -> Result<ViewReport, Error> {
    view.log_static("world", &ViewCoordinates::RIGHT_HAND_Z_UP())?;
    for (entity, map, radius) in [
        ("world/map", &inputs.map, MAP_POINT_RADIUS),
        ("world/surface", &inputs.surface, SURFACE_POINT_RADIUS),
    ] {
        if map.positions_m.is_empty() {
            continue;
        }
        let points = Points3D::new(map.positions_m.iter().copied())
            .with_radii([Radius::new_ui_points(radius)])
            .with_colors(
                map.colors_rgb
                    .iter()
                    .map(|c| Color::from_rgb(c[0], c[1], c[2])),
            );
        view.log_static(entity, &points)?;
    }
    for camera in &inputs.cameras {
        let [r, g, b] = camera.color_rgb;
        let strips = LineStrips3D::new(camera.strips_m.iter().cloned())
            .with_colors([Color::from_rgb(r, g, b)])
            .with_radii([Radius::new_ui_points(PYRAMID_RADIUS)]);
        view.log_static(&format!("world/cameras/{}", camera.name), &strips)?;
    }
    for line in &inputs.trajectories {
        let strip: Vec<[f32; 3]> = line
            .trajectory
            .poses()
            .iter()
            .map(|p| p.world_from_rig.translation.cast::<f32>().into())
            .collect();
        let [r, g, b] = line.color_rgb;
        let strips = LineStrips3D::new([strip])
            .with_colors([Color::from_rgb(r, g, b)])
            .with_radii([Radius::new_ui_points(LINE_RADIUS)]);
        view.log_static(&format!("world/trajectories/{}", line.name), &strips)?;
    }
    let mut report = ViewReport::default();
    let total = inputs.walks.len() as u64;
    for (done, walk) in inputs.walks.iter().enumerate() {
        let tell = |part: u64| {
            progress(Progress {
                stage: "writing view",
                done: done as u64 * walk::PARTS + part,
                total: total * walk::PARTS,
            })
        };
        walk::log(view, walk, config, &tell, &mut report)?;
    }
    view.finish()?;
    Ok(report)
}

/// The file being written.
struct View {
    path: PathBuf,
    stream: RecordingStream,
}

impl View {
    fn create(out: &Path, inputs: &ViewInputs<'_>) -> Result<Self, Error> {
        let name = out
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let stream = RecordingStreamBuilder::new(APPLICATION)
            .recording_name(name)
            .with_blueprint(layout::blueprint(inputs))
            .save(out)
            .map_err(|error| rerun_error(out, &error))?;
        // The time of writing means nothing to anyone who looks.
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        Ok(Self {
            path: out.to_owned(),
            stream,
        })
    }

    fn log_static(&self, entity: &str, what: &impl AsComponents) -> Result<(), Error> {
        self.stream
            .log_static(entity, what)
            .map_err(|error| rerun_error(&self.path, &error))
    }

    /// Logs something at the time that was set last.
    fn log(&self, entity: &str, what: &impl AsComponents) -> Result<(), Error> {
        self.stream
            .log(entity, what)
            .map_err(|error| rerun_error(&self.path, &error))
    }

    fn set_time(&self, time: lsfb_types::Timestamp) {
        self.stream
            .set_timestamp_nanos_since_epoch(TIMELINE, time.nanos());
    }

    fn finish(&self) -> Result<(), Error> {
        self.stream
            .flush_blocking()
            .map_err(|error| rerun_error(&self.path, &error))
    }
}

fn rerun_error(path: &Path, error: &dyn std::error::Error) -> Error {
    Error::Rerun {
        path: path.to_owned(),
        message: error.to_string(),
    }
}
