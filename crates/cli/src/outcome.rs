//! How a command ends.

use std::process::ExitCode;

/// What a command that did not fail has to say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Everything asked for was done.
    Done,
    /// Finished, but data was lost on the way; the report says which.
    DataLost,
}

impl From<Outcome> for ExitCode {
    /// 0 done, 3 finished but data was lost. (1 is failure, 2 bad arguments.)
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => ExitCode::SUCCESS,
            Outcome::DataLost => ExitCode::from(3),
        }
    }
}
