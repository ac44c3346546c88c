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
    /// There is no pose.
    #[error("the {role} trajectory has no pose")]
    Empty {
        /// "truth" or "estimate".
        role: &'static str,
    },
    /// Stamps go back.
    #[error(
        "{role} trajectory: pose {index} (t = {time_secs} s) is older than the one before it; sort it by time"
    )]
    Reordered {
        /// "truth" or "estimate".
        role: &'static str,
        /// Counted from zero.
        index: usize,
        /// Its stamp, seconds, as text.
        time_secs: String,
    },
    /// Two poses have one stamp, and the caller refuses that.
    #[error(
        "{role} trajectory: {count} stamps occur twice, first at t = {time_secs} s; keep one pose per stamp"
    )]
    Duplicated {
        /// "truth" or "estimate".
        role: &'static str,
        /// How many poses repeat the stamp before them.
        count: usize,
        /// The first such stamp, seconds, as text.
        time_secs: String,
    },
    /// A pose holds NaN or infinity.
    #[error("{role} trajectory: pose {index} (t = {time_secs} s) is not finite")]
    NotFinite {
        /// "truth" or "estimate".
        role: &'static str,
        /// Counted from zero.
        index: usize,
        /// Its stamp, seconds, as text.
        time_secs: String,
    },
    /// No two stamps are near enough.
    #[error(
        "no pose of the estimate is within {max_difference_secs} s of one of the truth: truth spans {truth_span}, \
         estimate {estimate_span}; same clock? shift the stamps or raise the allowed difference"
    )]
    NoMatch {
        /// Allowed difference, seconds.
        max_difference_secs: f64,
        /// First and last stamp.
        truth_span: String,
        /// First and last stamp.
        estimate_span: String,
    },
    /// Fewer pairs than the computation needs.
    #[error("only {matched} poses match, {needed} are needed for {purpose}")]
    TooFewMatches {
        /// Pairs found.
        matched: usize,
        /// Pairs needed.
        needed: usize,
        /// What for.
        purpose: &'static str,
    },
    /// The matched positions lie on one line or in one point.
    #[error(
        "the matched positions lie on one line, so that no rotation follows from them; evaluate with origin alignment or none"
    )]
    Degenerate,
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
    /// A delta that means nothing.
    #[error("delta {delta} {unit} is out of range: {expected}")]
    BadDelta {
        /// The delta asked for.
        delta: f64,
        /// Its unit.
        unit: DeltaUnit,
        /// What is allowed.
        expected: &'static str,
    },
    /// A relation that is defined for pairs of pairs only.
    #[error("{relation} is defined for relative errors only")]
    RelativeOnly {
        /// The relation asked for.
        relation: PoseRelation,
    },
    /// The maximal stamp difference is negative or not finite.
    #[error("maximal stamp difference {value} s must be a number of seconds, zero or more")]
    BadMaxDifference {
        /// Value given, seconds.
        value: f64,
    },
}
