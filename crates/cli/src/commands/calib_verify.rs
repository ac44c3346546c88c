//! `lsfb calib verify`: whether a rig fits a recording.

use std::path::{Path, PathBuf};

use lsfb_calib::verify::{MeasuredClock, VerifyConfig, verify};
use lsfb_geometry::Rig;
use lsfb_recording::{Provenance, Recording};
use lsfb_types::{Finding, Verdict};
use serde::Serialize;

use super::calib_result::Results;
use crate::context::Context;
use crate::judged::{self, Judged};
use crate::outcome::Outcome;
use crate::pages;

/// Check a rig on any recording, without a board.
///
/// Compares the cameras with the gyroscope (time offset, rotation), the LiDAR with the images, and the
/// cameras with each other; draws LiDAR returns over one image of each camera. Exit code 4: a check
/// failed.
///
/// Examples:
///   lsfb calib verify scan.mcap
///   lsfb calib verify scan.mcap --rig rig.toml --out report.html --json
///   lsfb calib verify phone.mcap --rig phone.toml --out-rig phone-clock.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The recording.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// The rig to check, instead of the recording's own.
    #[arg(long, value_name = "TOML")]
    rig: Option<PathBuf>,
    /// The page to write, with pictures beside it; by default beside the recording.
    #[arg(long, value_name = "HTML")]
    out: Option<PathBuf>,
    /// Also write the rig with each camera's time offset as measured against the gyroscope, for cameras
    /// with stamps of an unknown clock (rig_from_camera_s). It is checked again before it is written.
    #[arg(long, value_name = "TOML")]
    out_rig: Option<PathBuf>,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

#[derive(Serialize)]
struct Printed<'a> {
    page: PathBuf,
    pictures: &'a [PathBuf],
    clocks: &'a [MeasuredClock],
    #[serde(flatten)]
    verification: &'a lsfb_calib::verify::Verification,
}

/// Checks, writes page and pictures, prints the table.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: VerifyConfig = super::config_or_default(arguments.config.as_deref())?;
    let recording = context.open(&arguments.recording)?;
    let mut provenance = Provenance::new(&config);
    provenance.add_input(&arguments.recording)?;
    let rig = super::rig_for(&recording, arguments.rig.as_deref(), &mut provenance)?;
    let page = match &arguments.out {
        Some(path) => path.clone(),
        None => arguments.recording.with_extension("verify.html"),
    };
    // The same page says nothing of a rig that is asked for.
    if arguments.out_rig.is_none()
        && let Some(said) = judged::said_before(context, &page, &provenance)
    {
        return said;
    }
    let results = Results {
        out: &page,
        transforms: &[],
        others: &[arguments.out_rig.as_deref()],
        rig: None,
        read: [Some(&arguments.recording), arguments.rig.as_ref()]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path)
            .collect(),
    };
    results.claim(context)?;
    let show = |p| context.show(p);
    let found = verify(&recording, &rig, &config, &show)?;
    let picture = |camera: &str| page.with_extension(format!("{camera}.png"));
    let mut pictures = Vec::new();
    for overlay in &found.overlays {
        let path = picture(&overlay.camera);
        super::write(&path, &overlay.png)?;
        pictures.push(path);
    }
    let mut clocks = Vec::new();
    let mut judgement = found.judgement();
    let mut not_written = None;
    if let Some(out) = &arguments.out_rig {
        let (corrected, measured) = found.with_measured_clocks(&rig);
        clocks = measured;
        not_written = write_clocks(out, &recording, &corrected, &clocks, &config, context)?;
        match &not_written {
            Some(why) => judgement.push(why.clone()),
            None => {
                provenance.write(out)?;
            }
        }
    }
    // Last, as the page says what became of the rig that was asked for.
    let content = found.page("Rig verification", &judgement);
    pages::write(&page, content, &provenance)?;
    provenance.write(&page)?;
    let printed = Printed {
        page: page.clone(),
        pictures: &pictures,
        clocks: &clocks,
        verification: &found,
    };
    let judged = Judged::new(&judgement, &found.summary(), &printed);
    let mut text = format!("{}. See {}.", judged.summary, page.display());
    for c in &found.checks {
        let value = match (c.value, c.sigma) {
            (Some(value), Some(sigma)) => format!("{value:8.2} ± {sigma:.2} {}", c.unit),
            _ => String::new(),
        };
        text += &format!(
            "\n  {:7} {:28} {value:20} {}",
            c.outcome, c.name, c.sentence
        );
    }
    if let Some(why) = &not_written {
        text += &format!("\n  {:7} {}", why.verdict, why.message());
    }
    for clock in &clocks {
        text += &format!(
            "\n  {}: {}",
            super::name_of(arguments.out_rig.as_deref().unwrap_or(&page)),
            in_words(clock)
        );
    }
    for path in &pictures {
        text += &format!("\n  {}", path.display());
    }
    let finished = judged::Page {
        path: &page,
        beside: &pictures,
        made_from: &provenance,
    };
    finished.finish(context, &judged, &text)
}

/// Writes the rig with the clocks that were measured, where it fits the recording then; what was measured, and by what, stands above. Gives why it
/// is not written.
fn write_clocks(
    out: &Path,
    recording: &Recording,
    rig: &Rig,
    clocks: &[MeasuredClock],
    config: &VerifyConfig,
    context: &Context,
) -> anyhow::Result<Option<Finding>> {
    let not_written = |what: String, remedy: &str| {
        let subject = out.display().to_string();
        Finding::new("time-offset", Verdict::Fail, subject, what).remedy(remedy)
    };
    if clocks.is_empty() {
        let what = "no camera's clock could be measured to half a millisecond, constant in time and with correct axes, so that no rig is written";
        let remedy = "see the page: its checks give the reasons";
        return Ok(Some(not_written(what.to_owned(), remedy)));
    }
    let again = verify(recording, rig, config, &|p| context.show(p))?;
    let failed = again
        .checks
        .iter()
        .find(|c| c.code == "time-offset" && c.outcome == Verdict::Fail);
    if let Some(check) = failed {
        let what = format!(
            "not written, because the rig does not fit with the measured clocks either: {}: {}",
            check.name, check.sentence
        );
        return Ok(Some(not_written(what, "calibrate the cameras anew")));
    }
    let measured: String = clocks
        .iter()
        .map(|clock| format!("# {}\n", in_words(clock)))
        .collect();
    let text = format!(
        "# rig_from_camera_s by `lsfb calib verify`, from images and gyroscope of one recording:\n{measured}\n{}",
        rig.to_toml()
    );
    super::write(out, text.as_bytes())?;
    Ok(None)
}

fn in_words(clock: &MeasuredClock) -> String {
    format!(
        "{} {:+.3} ± {:.3} ms, {:+.3} ms before",
        clock.camera,
        clock.rig_from_camera_s * 1e3,
        clock.sigma_s * 1e3,
        clock.stated_s * 1e3
    )
}
