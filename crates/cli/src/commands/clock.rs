//! `lsfb clock`: the clocks of a recording, estimated again from its stamps.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lsfb_capture::clock::{ClockConfig, ClockReport, DeviceClock, estimate_clocks};
use lsfb_recording::Provenance;
use serde::Serialize;

use crate::bad_argument::BadArgument;
use crate::clock_page;
use crate::context::Context;
use crate::judged::{self, Judged};
use crate::outcome::Outcome;
use crate::pages;
use crate::standing;

/// Re-estimate every device's clock from the recorded counters and arrival times, and plot it.
///
/// The constant part of a transport delay cannot be observed by any one-way method and remains in the
/// offsets.
///
/// Examples:
///   lsfb clock scan.mcap
///   lsfb clock scan.mcap --out clocks.html --window-secs 300 --json
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The recording.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// Page with plots to write; by default beside the recording.
    #[arg(long, value_name = "HTML")]
    out: Option<PathBuf>,
    /// Length of the windows in which a line is fitted.
    #[arg(long, value_name = "SECS")]
    window_secs: Option<f64>,
}

#[derive(Serialize)]
struct Printed<'a> {
    page: &'a Path,
    #[serde(flatten)]
    report: &'a ClockReport,
}

/// Estimates, plots, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let mut config = ClockConfig::default();
    if let Some(secs) = arguments.window_secs {
        config.window_secs = secs;
    }
    BadArgument::check(config.check_bounds(""), &[])?;
    let page = arguments
        .out
        .clone()
        .unwrap_or_else(|| arguments.recording.with_extension("clocks.html"));
    let recording = context.open(&arguments.recording)?;
    let mut provenance = Provenance::new(&config);
    provenance.add_input(&arguments.recording)?;
    if let Some(said) = judged::said_before(context, &page, &provenance) {
        return said;
    }
    context.claim(&page, &[&arguments.recording])?;
    let report = estimate_clocks(&recording, &config, &|p| context.show(p))?;
    let name = arguments.recording.display().to_string();
    let judgement = report.judgement();
    standing::forget(&[&page])?;
    let content = clock_page::page(&name, &report, &judgement);
    pages::write(&page, content, &provenance)?;
    let printed = Printed {
        page: &page,
        report: &report,
    };
    let judged = Judged::new(&judgement, &report.summary(), &printed);
    let mut out = judged::problem_lines(&judgement);
    out.extend(report.devices.iter().map(line));
    let _ = write!(out, "{}\n{}", judged.summary, page.display());
    let finished = judged::Page {
        path: &page,
        beside: &[],
        made_from: &provenance,
    };
    finished.finish(context, &judged, &out)
}

fn line(clock: &DeviceClock) -> String {
    let mut out = format!("{:<14} ", clock.device);
    for (n, epoch) in clock.epochs.iter().enumerate() {
        if n > 0 {
            let _ = write!(
                out,
                "\n  stepped by {:.3} s at {:.3} s UTC, then ",
                epoch.step_ns as f64 / 1e9,
                epoch.arrival_start_ns as f64 / 1e9
            );
        }
        let _ = write!(
            out,
            "skew {:+.3} ± {:.3} ppm, σ {:.1} µs, {} pairs",
            epoch.skew_ppm, epoch.sigma_skew_ppm, epoch.sigma_us, epoch.pairs
        );
    }
    let _ = writeln!(
        out,
        "; delays above the minimum: median {:.2} ms, 99 % {:.2} ms; recorded stamps {}: {:+.1} µs, rms {:.1} µs",
        clock.delay_p50_ms,
        clock.delay_p99_ms,
        if clock.locked {
            "(locked)"
        } else {
            "(fitted live)"
        },
        clock.recorded_mean_us,
        clock.recorded_rms_us
    );
    out
}
