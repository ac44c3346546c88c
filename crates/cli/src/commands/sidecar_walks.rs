//! `lsfb sidecar walks`: each phone of a recording becomes a file of its own.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::ensure;
use lsfb_capture::walks::{Walk, WalkClock, phones, walk_path, write_walk};
use lsfb_geometry::Rig;
use serde::Serialize;

use crate::context::Context;
use crate::judged::printable;
use crate::outcome::Outcome;

/// Extract the walk of each phone, with its clock estimated from all clock exchanges.
///
/// Every message keeps three stamps: the phone's own, its arrival, and the time on the rig's clock
/// computed from it. The recording is not changed. For a recording in parts, run it on each part. Exit
/// code 3: messages could not be read, or keep the recording's time because there were too few clock
/// exchanges.
///
/// Examples:
///   lsfb sidecar walks scan.mcap --out walks
///   lsfb sidecar walks scan.mcap --out walks --device pixel8 --json
///   lsfb sidecar walks scan.mcap --out walks --device pixel8 --rig pixel8-clock.toml --force
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recording that contains phones.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// Folder for the walks, NAME.walk.mcap each.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Extract only this phone.
    #[arg(long, value_name = "NAME")]
    device: Option<String>,
    /// Rig of the phone instead of the one that it sent: a newer calibration, or one with the clocks from
    /// `lsfb calib verify --out-rig`.
    #[arg(long, value_name = "TOML", requires = "device")]
    rig: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report {
    walks: Vec<Walk>,
}

/// Writes the walks, prints what is known of their clocks.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let recording = context.open(&arguments.recording)?;
    let mut devices = phones(&recording);
    let name = arguments.recording.display();
    ensure!(
        !devices.is_empty(),
        "{name}: it contains no phone; `lsfb scan` records phones paired with `lsfb sidecar pair`"
    );
    if let Some(wanted) = &arguments.device {
        let known = devices.join(", ");
        devices.retain(|device| device == wanted);
        ensure!(
            !devices.is_empty(),
            "{name}: it does not contain phone {wanted:?}, but {known}"
        );
    }
    for device in &devices {
        context.claim(&walk_path(&arguments.out, device), &[&arguments.recording])?;
    }
    let rig = arguments.rig.as_deref().map(Rig::read).transpose()?;
    let mut walks = Vec::new();
    for device in &devices {
        let path = walk_path(&arguments.out, device);
        walks.push(write_walk(&recording, device, rig.as_ref(), &path, &|p| {
            context.show(p)
        })?);
    }
    let lost: u64 = walks.iter().map(|w| w.unreadable + w.unmapped).sum();
    let report = Report { walks };
    context.print(&report, || printable(text(&report.walks).trim_end()))?;
    Ok(match lost {
        0 => Outcome::Done,
        _ => Outcome::DataLost,
    })
}

fn text(walks: &[Walk]) -> String {
    let mut out = String::new();
    for walk in walks {
        let _ = write!(out, "{}: {} messages", walk.path.display(), walk.messages);
        if walk.unreadable > 0 {
            let _ = write!(out, ", {} UNREADABLE", walk.unreadable);
        }
        out.push('\n');
        if walk.unmapped > 0 {
            let _ = writeln!(
                out,
                "  {} messages KEEP RECORDING TIME: too few clock exchanges",
                walk.unmapped
            );
        }
        for clock in &walk.clocks {
            let _ = writeln!(out, "  clock {}: {}", clock.clock_id, words_of(clock));
        }
        if walk.mapped == 0 && walk.unmapped == 0 {
            let _ = writeln!(out, "  its stamps are UTC and are kept");
        }
    }
    out
}

/// What is known of a clock.
fn words_of(clock: &WalkClock) -> String {
    let Some(asymmetry_us) = clock.asymmetry_at_most_us else {
        return format!("unknown, from {} clock exchanges", clock.unusable);
    };
    let mut words = format!("{} exchanges", clock.exchanges);
    if clock.unusable > 0 {
        let _ = write!(words, " and {} unusable ones", clock.unusable);
    }
    if let Some(sigma_us) = clock.sigma_us {
        let _ = write!(words, ", σ {sigma_us:.0} µs");
    }
    if let Some(apart_us) = clock.utc_apart_us {
        let _ = write!(words, ", {:+.1} ms from the rig's", apart_us / 1e3);
    }
    let _ = write!(
        words,
        ", at most {:.1} ms error from unequal delays",
        asymmetry_us / 1e3
    );
    match clock.steps {
        0 => {}
        1 => words.push_str(", restarted once"),
        steps => {
            let _ = write!(words, ", restarted {steps} times");
        }
    }
    words
}
