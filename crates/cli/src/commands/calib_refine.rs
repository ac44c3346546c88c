//! `lsfb calib refine`: the LiDAR's pose to cameras without a board.

use std::path::{Path, PathBuf};

use lsfb_calib::joint::LIDAR;
use lsfb_calib::refine::{Compared, RefineConfig, Refinement, refine};
use lsfb_recording::Provenance;
use serde::Serialize;

use super::calib_result::{Results, listed, write_transforms};
use crate::context::Context;
use crate::judged::{self, Judged};
use crate::outcome::Outcome;
use crate::pages;

/// Refine the LiDAR's pose relative to the cameras on any recording, without a board.
///
/// Image corners are placed on surfaces measured by the LiDAR and found again from other viewpoints,
/// which determines each camera's rotation and translation to the LiDAR. The rig must be right within
/// 2.5° and 5 cm. Walk through a furnished place for 30 s or more, and turn. Anything that the
/// recording does not determine is named and left unchanged. Use `lsfb calib joint` to join these
/// transforms with those to the IMU. Exit code 4: a camera could not be placed.
///
/// Examples:
///   lsfb calib refine scan.mcap --out refined.html
///   lsfb calib refine scan.mcap --rig by-hand.toml --out refined.html --json
///   lsfb calib joint --rig rig.toml --transform refined.cam0-lidar.json --transform refined.cam1-lidar.json --out rig2.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The recording.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// The rig to start from, instead of the recording's own.
    #[arg(long, value_name = "TOML")]
    rig: Option<PathBuf>,
    /// The page to write; pictures and the cameras' transforms are written beside it.
    #[arg(long, value_name = "HTML")]
    out: PathBuf,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

#[derive(Serialize)]
struct Printed<'a> {
    page: &'a Path,
    transforms: &'a [PathBuf],
    pictures: &'a [PathBuf],
    cameras: &'a [Refinement],
}

/// Refines, writes page, pictures and transforms, prints what was found.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: RefineConfig = super::config_or_default(arguments.config.as_deref())?;
    let recording = context.open(&arguments.recording)?;
    let mut provenance = Provenance::new(&config);
    provenance.add_input(&arguments.recording)?;
    let rig = super::rig_for(&recording, arguments.rig.as_deref(), &mut provenance)?;
    if let Some(said) = judged::said_before(context, &arguments.out, &provenance) {
        return said;
    }
    let cameras = rig.cameras.keys();
    let pairs: Vec<[&str; 2]> = cameras.map(|name| [name.as_str(), LIDAR]).collect();
    let results = Results {
        out: &arguments.out,
        transforms: &pairs,
        others: &[],
        rig: None,
        read: vec![&arguments.recording],
    };
    results.claim(context)?;
    let show = |p| context.show(p);
    let found = refine(&recording, &rig, &config, &show)?;
    let page = &arguments.out;
    let picture = |camera: &str, which: Compared| {
        page.with_extension(format!("{camera}-{}.png", which.name()))
    };
    let (mut transforms, mut pictures) = (Vec::new(), Vec::new());
    for refined in &found.cameras {
        transforms.extend(write_transforms(page, refined.edge.as_slice())?);
        let overlays = refined.overlays.iter().flatten();
        for (overlay, which) in overlays.zip([Compared::Before, Compared::After]) {
            let path = picture(&refined.camera, which);
            super::write(&path, &overlay.png)?;
            pictures.push(path);
        }
    }
    pages::write(page, found.page("LiDAR–camera refinement"), &provenance)?;
    provenance.write(page)?;
    let printed = Printed {
        page,
        transforms: &transforms,
        pictures: &pictures,
        cameras: &found.cameras,
    };
    let judgement = found.judgement();
    let judged = Judged::new(&judgement, &found.summary(), &printed);
    let mut text = format!("{}. See {}.", judged.summary, page.display());
    for c in &found.cameras {
        text += &format!("\n  {}: {}", c.camera, c.sentence);
    }
    if !transforms.is_empty() {
        text += &format!("\n  for `lsfb calib joint`: {}", listed(&transforms));
    }
    let finished = judged::Page {
        path: page,
        beside: &[&transforms[..], &pictures].concat(),
        made_from: &provenance,
    };
    finished.finish(context, &judged, &text)
}
