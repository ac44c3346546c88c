//! Errors that are judgements: what they found of the data, and how a failed command ends.

use std::error::Error;
use std::fmt;

use lsfb_types::{Finding, Judgement};
use serde::Serialize;

use crate::bad_argument::BadArgument;
use crate::outcome::Outcome;

/// A finding for which a command gives nothing, where no library refuses.
#[derive(Debug)]
pub struct Refused(pub Finding);

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.message())
    }
}

impl Error for Refused {}

/// A command that failed, as `--json` gives it; `verdict` and `findings` where a check of the data did.
#[derive(Serialize)]
pub struct Failed {
    #[serde(flatten)]
    judgement: Option<Judgement>,
    error: String,
    #[serde(skip)]
    is_argument: bool,
}

impl Failed {
    /// `message` is what the terminal says.
    pub fn new(error: &anyhow::Error, message: &str) -> Self {
        Self {
            judgement: finding(error).map(|found| Judgement::new(vec![found])),
            error: message.to_owned(),
            is_argument: error.chain().any(|cause| cause.is::<BadArgument>()),
        }
    }

    /// The exit code that goes with it.
    pub fn outcome(&self) -> Outcome {
        match (&self.judgement, self.is_argument) {
            (_, true) => Outcome::BadArguments,
            (Some(_), false) => Outcome::JudgementFailed,
            (None, false) => Outcome::Failed,
        }
    }
}

/// What an error found of the data; `None` where something could not be done at all.
pub fn finding(error: &anyhow::Error) -> Option<Finding> {
    error.chain().find_map(finding_of)
}

fn finding_of(cause: &(dyn Error + 'static)) -> Option<Finding> {
    if let Some(Refused(finding)) = cause.downcast_ref() {
        return Some(finding.clone());
    }
    if let Some(error) = cause.downcast_ref::<lsfb_pipeline::Error>() {
        return error.finding();
    }
    if let Some(error) = cause.downcast_ref::<lsfb_calib::Error>() {
        return error.finding();
    }
    cause.downcast_ref::<lsfb_eval::Error>()?.finding()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn json(error: &anyhow::Error) -> serde_json::Value {
        serde_json::to_value(Failed::new(error, "why")).expect("JSON")
    }

    /// Once the same exit code as a file that is not there, and nothing for programs.
    #[test]
    fn a_refusal_is_found_below_what_was_added_to_it() {
        let refused = lsfb_pipeline::Refusal::TooFewScans { scans: 1 };
        let error = anyhow::Error::new(lsfb_pipeline::Error::from(refused)).context("scan.mcap");
        assert_eq!(Failed::new(&error, "").outcome(), Outcome::JudgementFailed);
        let json = json(&error);
        assert_eq!(json["verdict"], "fail");
        assert_eq!(json["findings"][0]["code"], "few-scans");
        assert_eq!(json["findings"][0]["limit"]["at_least"], 2.0);
        assert_eq!(json["error"], "why");
    }

    #[test]
    fn what_could_not_be_done_is_no_judgement() {
        let error = anyhow::Error::new(std::io::Error::other("disk full")).context("scan.mcap");
        assert_eq!(Failed::new(&error, "").outcome(), Outcome::Failed);
        assert_eq!(json(&error), serde_json::json!({ "error": "why" }));
    }

    /// An option with a value that it cannot have ended as a missing file did.
    #[test]
    fn what_was_asked_for_wrongly_is_told_from_what_failed() {
        let error = anyhow::Error::new(BadArgument::new("--words is 0")).context("map");
        assert_eq!(Failed::new(&error, "").outcome(), Outcome::BadArguments);
        assert_eq!(json(&error), serde_json::json!({ "error": "why" }));
    }
}
