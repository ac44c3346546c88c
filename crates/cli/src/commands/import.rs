//! `lsfb import`: a recording of another program becomes one of ours.

use std::fmt::Write as _;
use std::path::PathBuf;

use lsfb_capture::doctor::examine_imus;
use lsfb_datasets::import::{Format, ImportConfig, ImportReport, RecordCount, import};
use lsfb_geometry::Rig;
use lsfb_recording::{Provenance, Recording};
use lsfb_types::StampUnit;

use crate::context::Context;
use crate::files::expect_file;
use crate::judged::{Judged, printable, problem_lines};
use crate::one_of::one_of;
use crate::outcome::Outcome;

/// Convert a recording of another program or phone app.
///
/// Reads EuRoC and TUM-VI folders, walks of Indoor Location 2.0, ios_logger, StrayScanner, MARSLogger,
/// VideoIMUCapture, Spectacular Rec, kapture, LaMAR sessions, and VRS files of Project Aria. The format
/// is detected from the content. Every record is counted, and anything that a recording cannot hold is
/// listed; ground truth and trajectories stay beside it. Stamps are the device's own, so that such a
/// recording says nothing about its clock. Videos need `ffmpeg` on this system. The IMU data is checked
/// as by `lsfb doctor`, and written unchanged. Exit code 3: records could not be read.
///
/// Examples:
///   lsfb import mav0 --out walk.mcap
///   lsfb import 5dd9e7c29191710006b57061.txt.gz --out mall.mcap --device oppo
///   lsfb import maupertuis --out campus.mcap --format kapture --stamp-unit s --rig rig.toml --json
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recording of the other program.
    #[arg(value_name = "FILE_OR_FOLDER")]
    source: PathBuf,
    /// Recording to write.
    #[arg(long, value_name = "MCAP")]
    out: PathBuf,
    /// Format of the source; detected by default.
    #[arg(long, value_name = "FORMAT", value_parser = one_of(&Format::ALL, Format::name))]
    format: Option<Format>,
    /// Name of the device in the topics, `/sidecar/NAME/…`: letters, digits, `-` and `_`.
    #[arg(long, value_name = "NAME", default_value = "phone", value_parser = device_name)]
    device: String,
    /// Unit of the stamps, if the format leaves it open (kapture, LaMAR); by default inferred from their
    /// magnitude.
    #[arg(long, value_name = "UNIT", value_parser = one_of(&StampUnit::ALL, StampUnit::sign))]
    stamp_unit: Option<StampUnit>,
    /// Rig of the device to attach, instead of the calibration in the source.
    #[arg(long, value_name = "TOML")]
    rig: Option<PathBuf>,
}

fn device_name(text: &str) -> Result<String, String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    match (1..=64).contains(&text.len()) && text.chars().all(is_plain) {
        true => Ok(text.to_owned()),
        false => Err("expected 1 to 64 letters, digits, '-' and '_'".to_owned()),
    }
}

/// Imports, prints what became of every kind of record.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    expect_file(
        &arguments.source,
        "give a file or folder of another program",
    )?;
    context.claim(&arguments.out, &[&arguments.source])?;
    let config = ImportConfig {
        format: arguments.format,
        device: arguments.device.clone(),
        stamp_unit: arguments.stamp_unit,
        rig: arguments.rig.as_deref().map(Rig::read).transpose()?,
        replace_trajectories: context.force(),
    };
    let report = import(&arguments.source, &arguments.out, &config, &|p| {
        context.show(p)
    })?;
    let mut provenance = Provenance::new(&config);
    for input in &report.inputs {
        provenance.add_input(input)?;
    }
    provenance.write(&arguments.out)?;
    let imus = examine_imus(&Recording::open(&arguments.out)?)?;
    let what = format!("{} of {}", report.format, report.device);
    context.print(&Judged::new(&imus, &what, &report), || {
        printable((text(&report) + &problem_lines(&imus)).trim_end())
    })?;
    Ok(match report.unreadable() {
        0 => Outcome::Done,
        _ => Outcome::DataLost,
    })
}

fn text(report: &ImportReport) -> String {
    let mut out = format!(
        "{}: {} of {}, {:.1} s, stamps {}\n",
        report.recording.display(),
        report.format,
        report.device,
        report.duration_secs,
        match report.clock.name() {
            "utc" => "in time of day, from the device's own clock",
            _ => "relative to an arbitrary zero of the device",
        },
    );
    for count in &report.records {
        out.push_str(&line(count));
    }
    for left in &report.left_out {
        let _ = writeln!(
            out,
            "  left out: {} {}: {}",
            left.records, left.what, left.why
        );
    }
    for path in &report.trajectories {
        let _ = writeln!(out, "  trajectory: {}", path.display());
    }
    for note in &report.notes {
        let _ = writeln!(out, "  note: {note}");
    }
    out.push_str(match report.has_rig {
        true => "  rig attached\n",
        false => "  no rig: give one with --rig before using images\n",
    });
    out
}

fn line(count: &RecordCount) -> String {
    let made = match count.derived {
        true => "made from other records".to_owned(),
        false => format!("{} read", count.read),
    };
    let mut line = format!(
        "  {:<40} {made}, {} written on {}",
        count.what, count.written, count.topic
    );
    for (number, what) in [
        (count.repeated, "repeated"),
        (count.reordered, "out of order"),
    ] {
        if number > 0 {
            let _ = write!(line, ", {number} {what}");
        }
    }
    if count.unreadable > 0 {
        let first = count.first_problem.as_deref().unwrap_or_default();
        let _ = write!(
            line,
            ", {} UNREADABLE; the first: {first}",
            count.unreadable
        );
    }
    line.push('\n');
    line
}
