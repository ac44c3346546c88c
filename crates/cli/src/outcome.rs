//! How a command ends.

use std::process::ExitCode;

use lsfb_types::Verdict;

/// What a command that did not fail has to say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Everything asked for was done.
    Done,
    /// Finished, but data was lost on the way, or parts of a walk have no poses; the report says which.
    DataLost,
    /// Finished, and what was judged failed: a recording, a machine, a calibration; the findings say why.
    JudgementFailed,
}

impl Outcome {
    /// Of a command that judges.
    pub fn of(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Fail => Self::JudgementFailed,
            Verdict::Unknown | Verdict::Pass | Verdict::Warn => Self::Done,
        }
    }
}

impl From<Outcome> for ExitCode {
    /// 0 done, 3 finished but data was lost, 4 what was judged failed. (1 is failure, 2 bad arguments.)
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => ExitCode::SUCCESS,
            Outcome::DataLost => ExitCode::from(3),
            Outcome::JudgementFailed => ExitCode::from(4),
        }
    }
}
