//! `lsfb doctor`: is this recording good?

use std::fmt::Write as _;
use std::path::PathBuf;

use lsfb_capture::doctor::{Depth, Diagnosis, DoctorConfig, Verdict, examine};
use lsfb_recording::Recording;

use super::doctor_host::{self, HostReport};
use crate::context::Context;
use crate::outcome::Outcome;

/// Judge a recording: PASS, WARN or FAIL for the file, each sensor, each clock, and what was lost.
///
/// With --host: judge this machine instead, before it records: limits, permissions, clock, disk; with the remedy of each.
///
/// Looks at the indexes, which is fast whatever the size of the file; --full reads everything and compares checksums.
/// Exit code 3: something failed.
///
/// Examples:
///   lsfb doctor scan.mcap
///   lsfb doctor scan.mcap --full --json
///   lsfb doctor --host /media/recordings
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The recording.
    #[arg(required_unless_present = "host")]
    recording: Option<PathBuf>,
    /// Look at this machine, and at the disk of FOLDER, where 256 MB are written for a moment.
    #[arg(long, value_name = "FOLDER", num_args = 0..=1, default_missing_value = ".", conflicts_with_all = ["recording", "full", "config"])]
    host: Option<PathBuf>,
    /// Read every byte and compare the checksums.
    #[arg(long)]
    full: bool,
    /// Thresholds (TOML) instead of the recommended ones.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// Examines, prints the verdicts.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    if let Some(folder) = &arguments.host {
        let report = HostReport::of_this_machine(folder);
        context.print(&report, || report.text())?;
        return Ok(match report.verdict {
            doctor_host::Verdict::Pass | doctor_host::Verdict::Warn => Outcome::Done,
            doctor_host::Verdict::Fail => Outcome::DataLost,
        });
    }
    let Some(path) = &arguments.recording else {
        anyhow::bail!("name a recording, or --host");
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
    context.print(&diagnosis, || text(&diagnosis))?;
    Ok(match diagnosis.verdict {
        Verdict::Pass | Verdict::Warn => Outcome::Done,
        Verdict::Fail => Outcome::DataLost,
    })
}

fn text(diagnosis: &Diagnosis) -> String {
    let mut out = String::new();
    for finding in &diagnosis.findings {
        let _ = write!(
            out,
            "{}  {:<20} {}",
            label(finding.verdict),
            finding.subject,
            finding.found
        );
        if finding.verdict != Verdict::Pass && !finding.threshold.is_empty() {
            let _ = write!(out, " (good: {})", finding.threshold);
        }
        out.push('\n');
    }
    let _ = write!(
        out,
        "{}  {:.1} MB, {:.1} s, {} messages",
        label(diagnosis.verdict),
        diagnosis.bytes as f64 / 1e6,
        diagnosis.duration_secs,
        diagnosis.messages
    );
    out
}

fn label(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass => "PASS",
        Verdict::Warn => "WARN",
        Verdict::Fail => "FAIL",
    }
}
