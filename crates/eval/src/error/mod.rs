//! Why a trajectory could not be judged, and what of it is a judgement of the data.

mod finding;
#[cfg(test)]
mod tests;

use std::path::PathBuf;

use crate::relation::{DeltaUnit, PoseRelation};

/// Why a trajectory could not be judged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line is not what its format says.
    #[error("{path}, line {line}: {what}")]
    BadLine {
        /// The file.
        path: PathBuf,
        /// Counted from one.
        line: usize,
        /// What is wrong and what was expected.
        what: String,
    },
    /// A file is no trajectory, or too large for one.
    #[error("{path}: {what}")]
    NotATrajectory {
        /// The file.
        path: PathBuf,
        /// What was found and what is understood.
        what: String,
    },
    /// A recording could not be read.
    #[error(transparent)]
    Recording(#[from] lsfb_recording::Error),
    /// The unit of the stamps is not clear.
    #[error(
        "{path}: stamps advance by {step} per pose, which may be {possible}; give the unit (s, ms, us, ns)"
    )]
    UnknownStampUnit {
        /// The file.
        path: PathBuf,
        /// Median step, in the file's unit.
        step: f64,
        /// Units in which that makes sense.
        possible: String,
    },
    /// Most poses share a stamp with another pose, elsewhere.
    #[error("{}", self.message())]
    CoarseStamps {
        /// The file.
        path: PathBuf,
        /// Poses.
        poses: usize,
        /// Different stamps.
        distinct: usize,
    },
    /// The device is not there, or none of several was chosen.
    #[error("{path}: choose the device whose trajectory to use; the file has {devices}")]
    NoSuchDevice {
        /// The file.
        path: PathBuf,
        /// Devices there are.
        devices: String,
    },
    /// Positions are not enough.
    #[error("{purpose} need orientations, but the file has only positions")]
    NeedsOrientation {
        /// What for.
        purpose: &'static str,
    },
    /// A file is no survey.
    #[error("{path}: not a survey: {what}")]
    NotASurvey {
        /// The file.
        path: PathBuf,
        /// What was found.
        what: String,
    },
    /// Nothing says where a mark is.
    #[error("{}", self.message())]
    UndeterminedMark {
        /// The mark.
        mark: String,
    },
    /// The distances fit a mark on either side of others.
    #[error("{}", self.message())]
    TwoPlaces {
        /// The mark.
        mark: String,
        /// How far apart, metres.
        apart_m: f64,
    },
    /// A mark is visited that no distance names.
    #[error("mark {mark} is visited, but has no distance")]
    UnknownMark {
        /// The mark.
        mark: String,
    },
    /// The device did not rest on marks, or so it seems.
    #[error("{}", self.message())]
    TooFewRests {
        /// Rests found.
        rests: usize,
        /// Marks, or visits of marks.
        marks: usize,
    },
    /// No inertial sample is of the time of the trajectory.
    #[error("{}", self.message())]
    NoInertialSamples {
        /// First and last pose.
        poses_span: String,
        /// First and last sample.
        samples_span: String,
    },
    /// More rests and marks than can be tried.
    #[error(
        "{rests} rests and {marks} marks have too many combinations; require longer rests, or check in parts"
    )]
    TooManyRests {
        /// Rests found.
        rests: usize,
        /// Marks, or visits of marks.
        marks: usize,
    },
    /// Rests fit different marks equally well.
    #[error("{}", self.message())]
    AmbiguousRests {
        /// Rests that fit.
        rests: usize,
    },
    /// No distance of a survey is between points of the map.
    #[error("no distance has both ends among the survey's points; add map points (point A x y z)")]
    NoMapDistance,
    /// A trajectory in which no keyframe of a map lies.
    #[error("{}", self.message())]
    NoKeyframe,
    /// A trajectory that does not pass through the keyframes of a map.
    #[error("{}", self.message())]
    AnotherTrajectory {
        /// At most, centimetres.
        far_cm: f64,
        /// At most, degrees.
        far_deg: f64,
    },
    /// Too few poses for what was asked.
    #[error("{}", self.message())]
    TooFewPoses {
        /// "estimate", "reference" or "aligned".
        role: &'static str,
        /// Poses there are.
        poses: usize,
        /// Poses needed.
        needed: usize,
    },
    /// Stamps that cannot be of one walk.
    #[error("{}", self.message())]
    TooLong {
        /// "estimate" or "reference".
        role: &'static str,
        /// From the first to the last stamp, seconds.
        span_secs: f64,
    },
    /// Poses of motion capture that hardly ever are where an IMU leads.
    #[error("{}", self.message())]
    NotOneMotion {
        /// That fit.
        fit: usize,
        /// Of so many.
        poses: usize,
        /// At least.
        needed: usize,
        /// Mean size of the specific force, m/s².
        force_m_s2: f64,
    },
    /// Inertial samples are missing.
    #[error("{}", self.message())]
    InertialGap {
        /// The longest gap, seconds.
        gap_secs: f64,
    },
    /// A filter lost its numbers.
    #[error("{}", self.message())]
    Unstable {
        /// Since the IMU's first sample, seconds.
        secs: f64,
    },
    /// A trajectory from whose motion no clock can be read.
    #[error("{}", self.message())]
    EvenRotation {
        /// "estimate" or "reference".
        role: &'static str,
    },
    /// Two trajectories are never at one time within the search.
    #[error("{}", self.message())]
    NoCommonTime {
        /// How far was searched, seconds.
        search_secs: f64,
        /// Around which offset, seconds.
        around_secs: f64,
        /// What both span, seconds since the estimate's first pose.
        spans: String,
    },
    /// Their angular speeds are not alike at any offset.
    #[error("{}", self.message())]
    NotOneBody {
        /// The best correlation.
        correlation: f64,
    },
    /// Two offsets fit equally well.
    #[error("{}", self.message())]
    TwoOffsets {
        /// The one, seconds.
        first_secs: f64,
        /// The other, seconds.
        second_secs: f64,
    },
    /// The bodies turned about one axis only.
    #[error("{}", self.message())]
    OneAxis {
        /// Turns about the main axis, degrees rms.
        first_deg: f64,
        /// Turns about the second axis, degrees rms.
        second_deg: f64,
    },
    /// A benchmark's plan means nothing.
    #[error("{path}: {what}")]
    BadPlan {
        /// The file, or the run's folder.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// Only recordings can be written in other layouts.
    #[error(
        "{path}: not a recording that can be written in the layout {layout}; give an MCAP file, or use `as_is`"
    )]
    NotExported {
        /// What the plan names.
        path: PathBuf,
        /// The layout.
        layout: &'static str,
    },
    /// A setting outside its bounds.
    #[error(transparent)]
    Setting(#[from] lsfb_types::OutOfBounds),
    /// The caller asked for an early end.
    #[error("{0}")]
    Stopped(#[from] lsfb_types::Stopped),
    /// Least squares had no answer.
    #[error("{}", self.message())]
    Solver(#[from] lsfb_solver::Error),
    /// There is no pose.
    #[error("{}", self.message())]
    Empty {
        /// "truth" or "estimate".
        role: &'static str,
    },
    /// Stamps go back.
    #[error("{}", self.message())]
    Reordered {
        /// "truth" or "estimate".
        role: &'static str,
        /// Counted from zero.
        index: usize,
        /// Its stamp, seconds, as text.
        time_secs: String,
    },
    /// Two poses have one stamp, and the caller refuses that.
    #[error("{}", self.message())]
    Duplicated {
        /// "truth" or "estimate".
        role: &'static str,
        /// How many poses repeat the stamp before them.
        count: usize,
        /// The first such stamp, seconds, as text.
        time_secs: String,
    },
    /// A pose holds NaN or infinity.
    #[error("{}", self.message())]
    NotFinite {
        /// "truth" or "estimate".
        role: &'static str,
        /// Counted from zero.
        index: usize,
        /// Its stamp, seconds, as text.
        time_secs: String,
    },
    /// No two stamps are near enough.
    #[error("{}", self.message())]
    NoMatch {
        /// Allowed difference, seconds.
        max_difference_secs: f64,
        /// First and last stamp.
        truth_span: String,
        /// First and last stamp.
        estimate_span: String,
        /// What may be wrong with them; empty, or begins with `; `.
        hint: String,
    },
    /// A position that no walk has.
    #[error("{}", self.message())]
    TooFar {
        /// Which trajectory.
        role: &'static str,
        /// Counted from zero.
        index: usize,
        /// Its stamp, seconds, as text.
        time_secs: String,
        /// The limit, metres.
        limit_m: f64,
    },
    /// A walk that stands in two tables.
    #[error("{}", self.message())]
    CopiedScans {
        /// Scans that are copies.
        scans: usize,
    },
    /// Fewer pairs than the computation needs.
    #[error("{}", self.message())]
    TooFewMatches {
        /// Pairs found.
        matched: usize,
        /// Pairs needed.
        needed: usize,
        /// What for.
        purpose: &'static str,
    },
    /// The matched positions lie on one line or in one point.
    #[error("{}", self.message())]
    Degenerate,
    /// The matched positions do not move sideways.
    #[error("{}", self.message())]
    NoHeading,
    /// All matched poses have one stamp.
    #[error("{}", self.message())]
    NoDuration {
        /// That moment, seconds, as text.
        time_secs: String,
    },
    /// A file of a dataset is not what it should be.
    #[error("{path}: {what}")]
    BadDataset {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// A relative error was asked for, and no two poses are so far apart.
    #[error("no two of {poses} matched poses are {delta} {unit} apart; choose a smaller delta")]
    NoPairs {
        /// Matched poses.
        poses: usize,
        /// The delta asked for.
        delta: f64,
        /// Its unit.
        unit: DeltaUnit,
    },
    /// A relation that is defined for pairs of pairs only.
    #[error("{relation} is defined for relative errors only")]
    RelativeOnly {
        /// The relation asked for.
        relation: PoseRelation,
    },
}

impl Error {
    /// As the finding says it.
    fn message(&self) -> String {
        self.finding()
            .map_or_else(String::new, |found| found.message())
    }
}
