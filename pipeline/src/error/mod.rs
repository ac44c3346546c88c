//! What can go wrong in this crate, and what of it is a judgement of the data.

mod finding;
mod refusal;
mod shortage;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use lsfb_types::{Finding, Timestamp, Verdict};

pub use refusal::Refusal;
pub use shortage::MapShortage;
pub(crate) use shortage::{MIN_FEATURES_PER_IMAGE, MIN_MAP_POINTS};

/// What can go wrong in this crate: what, where, and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A setting lies outside its bounds.
    #[error(transparent)]
    Setting(#[from] lsfb_types::OutOfBounds),
    /// A camera is used that the rig does not have.
    #[error("rig {rig} has no camera {camera}: give the rig file that belongs to these images")]
    UnknownCamera {
        /// The camera asked for.
        camera: String,
        /// The rig's name.
        rig: String,
    },
    /// The principal point of a camera lies where no lens has it in images of its size.
    #[error(
        "the principal point of camera {camera}, ({x:.1}, {y:.1}) px, is far from the centre of its {width} × {height} images: give the intrinsics for images of this size",
        x = principal_px[0], y = principal_px[1], width = size_px[0], height = size_px[1]
    )]
    PrincipalPointOffCentre {
        /// The camera.
        camera: String,
        /// Size of its images, pixels.
        size_px: [u32; 2],
        /// Its principal point, pixels.
        principal_px: [f64; 2],
    },
    /// An image is not as large as its camera's images are.
    #[error(
        "{path}: {found_width} × {found_height} px, but camera {camera} has {width} × {height}: give the intrinsics for images of this size, or the original images", path = path.display(),
        found_width = found_px[0], found_height = found_px[1], width = expected_px[0], height = expected_px[1]
    )]
    ImageSize {
        /// The image.
        path: PathBuf,
        /// The camera.
        camera: String,
        /// Size of the camera's images, pixels.
        expected_px: [u32; 2],
        /// Size of this one, pixels.
        found_px: [u32; 2],
    },
    /// Stored clouds cannot be mapped with.
    #[error("{path}: {reason}", path = path.display())]
    StoredClouds {
        /// The file.
        path: PathBuf,
        /// Why, and what to do.
        reason: String,
    },
    /// A list of posed images is not what it should be.
    #[error("{path}, line {line}: {reason}", path = path.display())]
    PosedImages {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        reason: &'static str,
    },
    /// A list of posed images of another program is not what it should be.
    #[error("{path}: {reason}", path = path.display())]
    PosedLayout {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// An image file cannot be read.
    #[error(transparent)]
    Image(#[from] lsfb_perception::image::ImageError),
    /// A folder holds no map.
    #[error("{folder}: no map here (map.toml is missing): give a folder written by `lsfb map`, or map again if that was interrupted", folder = folder.display())]
    NoMap {
        /// The folder.
        folder: PathBuf,
    },
    /// A map was written by another version.
    #[error("{path}: format version {found}, this program reads {oldest} to {expected}: map again, or use the program that wrote it", path = path.display())]
    MapVersion {
        /// The header file.
        path: PathBuf,
        /// The file's version.
        found: u32,
        /// The oldest that is read.
        oldest: u32,
        /// Ours.
        expected: u32,
    },
    /// A file of a map is damaged.
    #[error("{path}: {reason}; the map is damaged: copy it again or map again", path = path.display())]
    MapFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A file of descriptors is not what it should be.
    #[error(
        "{path}: {reason}: give a .bvecs file of descriptors of 128 bytes", path = path.display()
    )]
    DescriptorFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// More descriptors than an index has numbers for.
    #[error("{count} descriptors are too many for one index (at most 4294967295): split the map")]
    TooManyDescriptors {
        /// Number of descriptors.
        count: usize,
    },
    /// A file is no codebook of VLAD vectors.
    #[error("{path}: {problem}: make a codebook with `lsfb models codebook`", path = path.display())]
    BadCodebook {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A view of a walk that is of none of its frames or cameras, or out of their order.
    #[error(
        "view {view} of the walk belongs to none of its frames or cameras, is out of order, or has keypoints without descriptors"
    )]
    UnknownView {
        /// Its number.
        view: usize,
    },
    /// Weights of a network could not be read.
    #[error(transparent)]
    Network(#[from] lsfb_networks::Error),
    /// A file of weights holds others than are asked for.
    #[error("{path}: contains {found}, not {expected}: add the right weights with `lsfb models add`", path = path.display())]
    OtherWeights {
        /// The file.
        path: PathBuf,
        /// What is asked for.
        expected: String,
        /// What it holds.
        found: String,
    },
    /// Descriptors of one feature are to be looked up among those of another.
    #[error(
        "the map holds {map} features, the images have {images}, and their descriptors cannot be compared: localize with the map's feature, or map again with the other"
    )]
    WrongFeature {
        /// The map's.
        map: String,
        /// The query's.
        images: String,
    },
    /// A map point refers to something that is not there.
    #[error("map point {point}: {reason}")]
    MapContent {
        /// Index of the point.
        point: usize,
        /// What is wrong.
        reason: &'static str,
    },
    /// A format knows no camera of a kind.
    #[error(
        "{format} has no camera model {model}: calibrate with another lens model, or export in another format"
    )]
    CameraFormat {
        /// COLMAP's name of the model.
        model: String,
        /// The format.
        format: &'static str,
    },
    /// Points do not fit into a LAS file.
    #[error("the points do not fit into a LAS file: {reason}")]
    Las {
        /// Why.
        reason: String,
    },
    /// No point of a map lies in a region.
    #[error("no point of the map lies in that region: `lsfb map info` shows its extent")]
    EmptyRegion,
    /// Two maps of which the second alone stands in a surveyed frame.
    #[error(
        "the second map has a surveyed frame but the first does not, and the result keeps the frame of the first: name the surveyed map first"
    )]
    SurveyedSecond,
    /// An image belongs to a keyframe that is not there.
    #[error("an image belongs to keyframe {keyframe}, but there are {count}")]
    UnknownKeyframe {
        /// The keyframe.
        keyframe: usize,
        /// How many there are.
        count: usize,
    },
    /// A sensor is needed that the rig does not have.
    #[error("rig {rig} has no {sensor}: give the rig file of the device that recorded this")]
    SensorMissing {
        /// The sensor.
        sensor: &'static str,
        /// The rig's name.
        rig: String,
    },
    /// The system gives no more threads.
    #[error("cannot start a thread: {message}")]
    Threads {
        /// What it says.
        message: String,
    },
    /// A least-squares problem could not be solved.
    #[error("{}", of_solver(.0).message())]
    Solver(#[from] lsfb_solver::Error),
    /// A recording could not be read.
    #[error(transparent)]
    Recording(#[from] lsfb_recording::Error),
    /// What the data is refused for.
    #[error("{}", .0.finding().message())]
    Refused(#[from] Refusal),
    /// A walk that another one is to be solved together with is refused by itself.
    #[error("{path}, which was to be solved together with it: {error}", path = path.display())]
    OtherWalk {
        /// Its recording.
        path: PathBuf,
        /// Why.
        error: Box<Error>,
    },
    /// Files are named by cameras.
    #[error("camera name {name:?} cannot be used as a file name: rename the camera in the rig")]
    CameraName {
        /// Its name.
        name: String,
    },
    /// A line of a list of loops cannot be used.
    #[error("{path}:{line}: {reason}", path = path.display())]
    LoopLine {
        /// The file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A line of a list of clicks cannot be used.
    #[error("{path}:{line}: {reason}", path = path.display())]
    ClickLine {
        /// The file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A line of a list of control points cannot be used.
    #[error("{path}:{line}: {reason}", path = path.display())]
    ControlPointLine {
        /// The file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A loop is of a scan that has no pose.
    #[error("no scan has a pose at {time} s: give the loop list of this walk")]
    UnknownScan {
        /// End of the scan.
        time: Timestamp,
    },
    /// A loop is to be closed that was not measured.
    #[error("the loop from {earlier} s to {later} s was not measured: reject it, or add its pose")]
    LoopNotMeasured {
        /// End of the earlier scan.
        earlier: Timestamp,
        /// End of the later scan.
        later: Timestamp,
    },
    /// The progress callback asked for an early end.
    #[error("{0}")]
    Stopped(#[from] lsfb_types::Stopped),
}

impl Error {
    /// What was found, where the data is refused; `None` where something could not be read, written or done at all.
    pub fn finding(&self) -> Option<Finding> {
        match self {
            Self::Refused(refusal) => Some(refusal.finding()),
            Self::Solver(problem) => problem.finding().map(|_| of_solver(problem)),
            Self::OtherWalk { path, error } => {
                let found = error.finding()?;
                let path = path.display().to_string();
                let subject = match found.subject.as_str() {
                    "" => path,
                    own if own == path => path,
                    part => format!("{path}, {part}"),
                };
                Some(Finding { subject, ..found })
            }
            _ => None,
        }
    }

    /// Names the path in an I/O error: `fs::read(path).map_err(Error::io(path))`.
    pub fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }
}

/// A problem of the solver in words; only what was measured has something to be done about.
fn of_solver(problem: &lsfb_solver::Error) -> Finding {
    let found = problem.finding();
    let found = found.unwrap_or_else(|| Finding::new("", Verdict::Fail, "", problem.to_string()));
    Finding {
        what: format!("optimisation: {}", found.what),
        ..found
    }
}
