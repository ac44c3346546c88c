//! Why a run has no figures.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Why a run has no figures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "cause", rename_all = "snake_case")]
pub enum Cause {
    /// The program could not be started.
    NotStarted {
        /// What the system said.
        why: String,
    },
    /// The program ended with an error.
    Crashed {
        /// Its exit code, or the signal that ended it.
        how: String,
    },
    /// It took more memory than allowed.
    OutOfMemory {
        /// What was allowed, MB.
        limit_mb: u64,
    },
    /// It took more time than allowed.
    TimedOut {
        /// What was allowed, seconds.
        limit_secs: f64,
    },
    /// It ended well and wrote no pose.
    NeverInitialised,
    /// Its trajectory covers too little of the truth.
    Lost {
        /// Share covered, 0 to 1.
        covered: f64,
    },
    /// Its trajectory cannot be judged.
    NotJudged {
        /// Why.
        why: String,
    },
}

impl Cause {
    /// Whether it was found when the trajectory was judged, and not when the program ended.
    pub(super) fn is_of_judge(&self) -> bool {
        matches!(
            self,
            Self::NeverInitialised | Self::Lost { .. } | Self::NotJudged { .. }
        )
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotStarted { why } => write!(f, "not started: {why}"),
            Self::Crashed { how } => write!(f, "crashed ({how})"),
            Self::OutOfMemory { limit_mb } => write!(f, "out of memory (more than {limit_mb} MB)"),
            Self::TimedOut { limit_secs } => write!(f, "timed out (more than {limit_secs} s)"),
            Self::NeverInitialised => f.write_str("never initialised"),
            Self::Lost { covered } => write!(f, "lost ({:.0} % covered)", 100.0 * covered),
            Self::NotJudged { why } => write!(f, "not evaluated: {why}"),
        }
    }
}
