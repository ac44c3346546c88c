//! Why a calibration could not be made.

mod join;
mod reasons;

pub use join::JoinProblem;
pub use reasons::{
    BadImu, NoRest, PatternExcess, PoorMotion, SeenInstead, TargetProblem, WrongSize, WrongUnit,
};

/// Why a calibration could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// An image could not be read.
    #[error(transparent)]
    Image(#[from] lsfb_perception::image::ImageError),
    /// What another program recorded could not be read.
    #[error(transparent)]
    Dataset(#[from] lsfb_datasets::Error),
    /// A file is not what it should be.
    #[error("{path}: {problem}")]
    Parse {
        /// The file.
        path: String,
        /// Where in it, what is wrong and what was expected.
        problem: String,
    },
    /// A board whose numbers are impossible.
    #[error("invalid target: {0}")]
    Target(#[from] TargetProblem),
    /// A camera saw the target too seldom.
    #[error(
        "camera {camera}: the target was found in {found} of {images} images, but {needed} are needed: check the target's kind and size ({target}), the focus, and that the whole board is lit"
    )]
    TargetNotSeen {
        /// The camera.
        camera: String,
        /// Images in which it was found.
        found: usize,
        /// Images looked at.
        images: usize,
        /// Images needed.
        needed: usize,
        /// What was looked for.
        target: String,
    },
    /// Most images of a camera are one image.
    #[error(
        "camera {camera}: the target was found in {found} images, but only {different} of them differ (the others are duplicates), and {needed} are needed: move the board or the camera between images, and check that the camera does not repeat images"
    )]
    CopiedImages {
        /// The camera.
        camera: String,
        /// Images in which it was found.
        found: usize,
        /// Those that are no copies of others.
        different: usize,
        /// Images needed.
        needed: usize,
    },
    /// A camera saw another target.
    #[error("camera {camera}: the {target} is in none of {images} images, but {instead}")]
    OtherTarget {
        /// The camera.
        camera: String,
        /// What was looked for.
        target: String,
        /// Images looked at.
        images: usize,
        /// What was seen, and what to do.
        instead: SeenInstead,
    },
    /// The views do not fit the model.
    #[error(
        "camera {camera}: {}: the target's geometry is wrong ({target}), the board is upside down or bent, or the lens is not {model}",
        missed(*rms_px)
    )]
    DoesNotFit {
        /// The camera.
        camera: String,
        /// Root mean square of the reprojection error, pixels.
        rms_px: f64,
        /// What was looked for.
        target: String,
        /// The lens model.
        model: &'static str,
    },
    /// The views fit another lens model, not the one that was asked for.
    #[error(
        "camera {camera}: the lens model {model} does not fit these views ({}), but {other} does, with a reprojection error of {other_rms_px:.2} px: use --model {other}",
        missed(*rms_px)
    )]
    AnotherModelFits {
        /// The camera.
        camera: String,
        /// The lens model asked for.
        model: &'static str,
        /// Median reprojection error under it, pixels.
        rms_px: f64,
        /// A lens model that fits.
        other: &'static str,
        /// Root mean square of the reprojection error under that one, pixels.
        other_rms_px: f64,
    },
    /// The views do not determine a parameter.
    #[error("camera {camera}: {parameters} cannot be determined from these views: {advice}")]
    Undetermined {
        /// The camera.
        camera: String,
        /// Names of the parameters with their standard deviations.
        parameters: String,
        /// What to record.
        advice: &'static str,
    },
    /// Two cameras were given the same images.
    #[error("{first} and {second} show the same images: both were given the same folder or topic")]
    SameImages {
        /// A camera.
        first: String,
        /// The other.
        second: String,
    },
    /// Numbers that are right in other units only.
    #[error("{what}: {problem}")]
    Unit {
        /// Whose numbers they are.
        what: String,
        /// What they look like, and what is needed.
        problem: WrongUnit,
    },
    /// Cameras or sensors do not share enough.
    #[error("{first} and {second}: {cause}")]
    NotJoined {
        /// A sensor.
        first: String,
        /// The other.
        second: String,
        /// What is missing and what to do.
        cause: JoinProblem,
    },
    /// The motion of the rig does not say enough.
    #[error("the motion is too poor: {0}")]
    Motion(#[from] PoorMotion),
    /// Samples of an IMU that contradict what cameras see.
    #[error("the IMU samples are implausible: {0}")]
    Imu(#[from] BadImu),
    /// A recording from which an IMU's noise cannot be read.
    #[error("the noise cannot be determined from this recording: {0}")]
    NotAtRest(#[from] NoRest),
    /// A setting lies outside its bounds.
    #[error(transparent)]
    Setting(#[from] lsfb_types::OutOfBounds),
    /// The LiDAR saw the board too seldom.
    #[error(
        "lidar: a board of {:.0} × {:.0} mm was found in {found} of {scans} scans, but {needed} are needed: check its size, that it stands free (no wall or person within 20 cm behind it), and that at least three beams hit it",
        width_m * 1e3,
        height_m * 1e3
    )]
    BoardNotSeen {
        /// Scans in which something like it was found.
        found: usize,
        /// Scans looked at.
        scans: usize,
        /// Scans needed.
        needed: usize,
        /// Width of the plate, metres.
        width_m: f64,
        /// Height of the plate, metres.
        height_m: f64,
    },
    /// What was said of the board's size is not what the sensors see.
    #[error("the board's size is wrong: {0}")]
    BoardSize(#[from] WrongSize),
    /// The board always faced the same way.
    #[error(
        "the boards' normals differ by only {tilt_deg:.1}° about a second axis, but {needed_deg:.0}° are needed: translation along {direction} depends on the outlines alone; {advice}"
    )]
    OneSided {
        /// Spread of the normals about the axis about which they differ least, degrees.
        tilt_deg: f64,
        /// Spread needed, degrees.
        needed_deg: f64,
        /// What is not determined.
        direction: String,
        /// What to record.
        advice: String,
    },
    /// The least-squares problem could not be solved.
    #[error("solving failed: {0}")]
    Solver(#[from] lsfb_solver::Error),
    /// The progress callback asked for an early end.
    #[error("{0}")]
    Stopped(#[from] lsfb_types::Stopped),
}

/// By how much corners are missed, in words: an error is infinite where a lens does not see them at all.
pub(crate) fn missed(rms_px: f64) -> String {
    if rms_px.is_finite() {
        format!("reprojection error is {rms_px:.1} px")
    } else {
        "most corners are outside the lens's field of view".to_owned()
    }
}
