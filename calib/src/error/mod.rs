//! Why a calibration could not be made, and what of it is a judgement of the data.

mod finding;
mod join;
mod join_finding;
mod reasons;
#[cfg(test)]
mod tests;

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
    #[error("{}", self.message())]
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
    #[error("{}", self.message())]
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
    #[error("{}", self.message())]
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
    #[error("{}", self.message())]
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
    #[error("{}", self.message())]
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
    #[error("{}", self.message())]
    Undetermined {
        /// The camera.
        camera: String,
        /// Names of the parameters with their standard deviations.
        parameters: String,
        /// What to record.
        advice: &'static str,
    },
    /// Two cameras were given the same images.
    #[error("{}", self.message())]
    SameImages {
        /// A camera.
        first: String,
        /// The other.
        second: String,
    },
    /// Numbers that are right in other units only.
    #[error("{}", self.message())]
    Unit {
        /// Whose numbers they are.
        what: String,
        /// What they look like, and what is needed.
        problem: WrongUnit,
    },
    /// Cameras or sensors do not share enough.
    #[error("{}", self.message())]
    NotJoined {
        /// A sensor.
        first: String,
        /// The other.
        second: String,
        /// What is missing and what to do.
        cause: JoinProblem,
    },
    /// The motion of the rig does not say enough.
    #[error("{}", self.message())]
    Motion(#[from] PoorMotion),
    /// Samples of an IMU that contradict what cameras see.
    #[error("{}", self.message())]
    Imu(#[from] BadImu),
    /// A recording from which an IMU's noise cannot be read.
    #[error("{}", self.message())]
    NotAtRest(#[from] NoRest),
    /// A setting lies outside its bounds.
    #[error(transparent)]
    Setting(#[from] lsfb_types::OutOfBounds),
    /// The LiDAR saw the board too seldom.
    #[error("{}", self.message())]
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
    #[error("{}", self.message())]
    BoardSize(#[from] WrongSize),
    /// The board always faced the same way.
    #[error("{}", self.message())]
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
    #[error("{}", self.message())]
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

impl Error {
    /// As the finding says it, where there is one.
    fn message(&self) -> String {
        match (self.finding(), self) {
            (Some(found), _) => found.message(),
            (
                None,
                Self::NotJoined {
                    first,
                    second,
                    cause,
                },
            ) => {
                format!("{first} and {second}: {cause}")
            }
            (None, Self::Solver(problem)) => format!("solving failed: {problem}"),
            (None, _) => String::new(),
        }
    }
}
