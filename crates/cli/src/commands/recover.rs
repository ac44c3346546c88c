//! `lsfb recover`: a whole file from an interrupted or damaged recording.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_recording::recover;
use serde::Serialize;

use crate::context::Context;
use crate::outcome::Outcome;

/// Write what can be read of a damaged recording into a new file, with a new index and end.
///
/// Chunks whose checksum is right are copied as they are; of one that was torn at the end the whole messages are taken.
/// The damaged file stays as it is. Exit code 3: recovered, but something is missing.
///
/// Examples:
///   lsfb recover scan.mcap --out scan-whole.mcap
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The damaged recording.
    recording: PathBuf,
    /// The new file; one that is there already is not replaced.
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

/// Whether both names lead to one file, which must not be replaced by itself.
fn same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// Recovers, prints what is missing.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    context.claim(&arguments.out)?;
    if arguments.out.is_file() && !same_file(&arguments.recording, &arguments.out) {
        std::fs::remove_file(&arguments.out)
            .with_context(|| arguments.out.display().to_string())?;
    }
    let recovered = recover(&arguments.recording, &arguments.out, &|p| context.show(p))?;
    let report = Report {
        path: recovered.path,
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
                "\n  {} messages come from a torn chunk: whole, but nothing has checked them",
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
