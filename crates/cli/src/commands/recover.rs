//! `lsfb recover`: a whole file from an interrupted or damaged recording.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Context as _;
use lsfb_recording::recover;
use serde::Serialize;

use crate::context::Context;
use crate::outcome::Outcome;

/// Recover a damaged or interrupted recording: copy what is readable into a new file with a new index.
///
/// Chunks with a correct checksum are copied unchanged; of a truncated last chunk, the complete
/// messages are copied. The damaged file is not changed. Exit code 3: recovered, but data is missing.
///
/// Examples:
///   lsfb recover scan.mcap --out scan-recovered.mcap
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The damaged recording.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// The new recording.
    #[arg(long, value_name = "MCAP")]
    out: PathBuf,
}

#[derive(Serialize)]
struct Report {
    path: PathBuf,
    bytes: u64,
    messages: u64,
    salvaged_messages: u64,
    chunks: u64,
    missing: Vec<String>,
}

/// Recovers, prints what is missing.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let out = &arguments.out;
    context.claim(out, &[&arguments.recording])?;
    // What is there stays until there is something in its place.
    let made = match out.is_file() {
        true => out.with_added_extension("new"),
        false => out.clone(),
    };
    if made != *out && made.is_file() {
        std::fs::remove_file(&made).with_context(|| made.display().to_string())?;
    }
    let recovered = recover(&arguments.recording, &made, &|p| context.show(p))?;
    if made != *out {
        std::fs::rename(&made, out).with_context(|| out.display().to_string())?;
    }
    let report = Report {
        path: out.clone(),
        bytes: recovered.bytes,
        messages: recovered.messages,
        salvaged_messages: recovered.salvaged_messages,
        chunks: recovered.chunks,
        missing: recovered.damage.iter().map(ToString::to_string).collect(),
    };
    context.print(&report, || {
        let mut out = format!(
            "{}: {:.1} MB, {} messages in {} chunks",
            report.path.display(),
            report.bytes as f64 / 1e6,
            report.messages,
            report.chunks
        );
        if report.salvaged_messages > 0 {
            let _ = write!(
                out,
                "\n  {} messages come from a damaged chunk: complete, but without a valid checksum",
                report.salvaged_messages
            );
        }
        for missing in &report.missing {
            let _ = write!(out, "\n  missing: {missing}");
        }
        out
    })?;
    Ok(if report.missing.is_empty() {
        Outcome::Done
    } else {
        Outcome::DataLost
    })
}
