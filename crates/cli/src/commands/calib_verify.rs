//! `lsfb calib verify`: whether a rig fits a recording.

use std::path::PathBuf;

use lsfb_calib::verify::{VerifyConfig, verify};
use lsfb_recording::Provenance;
use serde::Serialize;

use super::calib_result::Results;
use crate::context::Context;
use crate::judged::{self, Judged};
use crate::outcome::Outcome;

/// Check a rig on any recording, without a board.
///
/// Compares the cameras with the gyroscope (time offset, rotation), the LiDAR with the images, and the cameras with each other;
/// draws LiDAR returns over one image of each camera. Exit code 4 if a check fails.
///
/// Examples:
///   lsfb calib verify scan.mcap
///   lsfb calib verify scan.mcap --rig rig.toml --out report.html --json
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
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

#[derive(Serialize)]
struct Printed<'a> {
    outcome: &'static str,
    page: PathBuf,
    pictures: &'a [PathBuf],
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
    if let Some(said) = judged::said_before(context, &page, &provenance) {
        return said;
    }
    let results = Results {
        out: &page,
        transforms: &[],
        others: &[],
        rig: None,
        read: vec![&arguments.recording],
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
    let beside = |camera: &str| super::name_of(&picture(camera));
    super::write(&page, found.to_html("Rig verification", &beside))?;
    provenance.write(&page)?;
    let judgement = found.judgement();
    let printed = Printed {
        outcome: judgement.verdict().name(),
        page: page.clone(),
        pictures: &pictures,
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
