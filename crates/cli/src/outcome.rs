//! How a command ends.

use std::process::ExitCode;

use lsfb_types::Verdict;

/// Exit codes and what they mean, the same in all commands: as the help has them, and the table of `README.md`.
pub const EXIT_CODES: [(&str, &str); 6] = [
    ("0", "done"),
    (
        "1",
        "failed: it could not be done (files, settings, the system); the last line of stderr says why",
    ),
    ("2", "bad arguments"),
    (
        "3",
        "finished, but incomplete: data was lost or unreadable, or parts of the result are uncertain or were left out; the report says which",
    ),
    (
        "4",
        "a check of the data failed; the findings say why, and a result that was written must not be used",
    ),
    (
        "129, 130, 143",
        "stopped by a closed terminal (SIGHUP), Ctrl-C or SIGTERM",
    ),
];

/// As the help shows them.
pub fn exit_codes() -> String {
    let lines = EXIT_CODES.map(|(code, meaning)| format!("  {code:<13}  {meaning}\n"));
    format!("Exit codes:\n{}", lines.concat())
}

/// How a command ends that nobody stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Everything asked for was done.
    Done,
    /// Finished, but data was lost or unreadable, or parts of the result are uncertain or were left out; the report says which.
    DataLost,
    /// A check failed, of a recording, a machine, a calibration; the findings say why.
    JudgementFailed,
    /// It could not be done.
    Failed,
    /// It was asked for wrongly.
    BadArguments,
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
    /// One of [`EXIT_CODES`].
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => ExitCode::SUCCESS,
            Outcome::DataLost => ExitCode::from(3),
            Outcome::JudgementFailed => ExitCode::from(4),
            Outcome::Failed => ExitCode::FAILURE,
            Outcome::BadArguments => ExitCode::from(2),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The help, the README and the handbook of odometry had three lists, and none of them had 129.
    #[test]
    fn the_readme_has_the_same_codes() {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../");
        let readme = std::fs::read_to_string(format!("{root}README.md")).expect("README.md");
        let rows = EXIT_CODES.map(|(code, meaning)| format!("| {code} | {meaning} |\n"));
        let table = format!("| code | meaning |\n| --- | --- |\n{}\n", rows.concat());
        assert!(readme.contains(&table), "README.md lacks:\n{table}");
    }

    #[test]
    fn what_a_command_ends_with_is_in_the_table() {
        let known: Vec<&str> = EXIT_CODES
            .iter()
            .flat_map(|(codes, _)| codes.split(", "))
            .collect();
        for outcome in [
            Outcome::Done,
            Outcome::DataLost,
            Outcome::JudgementFailed,
            Outcome::Failed,
            Outcome::BadArguments,
        ] {
            let code = match outcome {
                Outcome::Done => 0,
                Outcome::DataLost => 3,
                Outcome::JudgementFailed => 4,
                Outcome::Failed => 1,
                Outcome::BadArguments => 2,
            };
            assert_eq!(ExitCode::from(outcome), ExitCode::from(code));
            assert!(known.contains(&code.to_string().as_str()));
        }
        for signal in crate::stop::SIGNALS {
            let code = crate::stop::exit_code(signal);
            assert!(known.contains(&code.to_string().as_str()), "{code}");
        }
    }
}
