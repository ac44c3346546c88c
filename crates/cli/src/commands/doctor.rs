//! `lsfb doctor`: is this recording good?

use std::path::{Path, PathBuf};

use lsfb_capture::doctor::{Depth, DoctorConfig, examine};
use lsfb_recording::Recording;
use lsfb_types::Judgement;
use serde::Serialize;

use super::doctor_host;
use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::judged;
use crate::outcome::Outcome;

/// Check a recording: PASS, WARN or FAIL for the file, each sensor, each clock, and lost data.
///
/// Reads only the indexes, which is fast for files of any size, and says what was not checked; --full
/// reads everything and verifies the checksums. --host checks this machine before a recording (limits,
/// permissions, clock, disk), with a remedy for each problem. Exit code 4: a check failed.
///
/// Examples:
///   lsfb doctor scan.mcap
///   lsfb doctor scan.mcap --full --json
///   lsfb doctor --host /media/recordings
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recording to check.
    #[arg(value_name = "MCAP", required_unless_present = "host")]
    recording: Option<PathBuf>,
    /// Check this machine and the disk of FOLDER; 256 MB are written there and removed.
    #[arg(long, value_name = "FOLDER", num_args = 0..=1, default_missing_value = ".", conflicts_with_all = ["recording", "full", "config"])]
    host: Option<PathBuf>,
    /// Read every byte and verify the checksums.
    #[arg(long)]
    full: bool,
    /// Thresholds instead of the recommended ones.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

/// Examines, prints the verdicts.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    if let Some(folder) = &arguments.host {
        let judgement = doctor_host::judge_this_machine(folder);
        return print(&judgement, "this machine", &Host { folder }, context);
    }
    let Some(path) = &arguments.recording else {
        anyhow::bail!(BadArgument::new("give a recording, or --host"));
    };
    let mut config: DoctorConfig = match &arguments.config {
        Some(path) => super::read_config(path)?,
        None => DoctorConfig::default(),
    };
    if arguments.full {
        config.read = Depth::Everything;
    }
    let recording = Recording::open(path)?;
    let diagnosis = examine(&recording, &config, &|p| context.show(p))?;
    print(
        &diagnosis.judgement,
        &diagnosis.summary(),
        &diagnosis.facts,
        context,
    )
}

/// What `--host` looked at beside the machine.
#[derive(Serialize)]
struct Host<'a> {
    folder: &'a Path,
}

fn print<T: Serialize>(
    judgement: &Judgement,
    summary: &str,
    result: &T,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let printed = judged::Judged::new(judgement, summary, result);
    context.print(&printed, || {
        judged::printable(&format!("{}{}", judged::lines(judgement), printed.summary))
    })?;
    Ok(Outcome::of(judgement.verdict()))
}
