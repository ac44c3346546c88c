//! `lsfb calib refine`: rotation between LiDAR and cameras without a board.

use std::path::PathBuf;

use lsfb_calib::verify::{VerifyConfig, refine};
use lsfb_recording::Provenance;

use super::calib::{listed, write_transforms};
use crate::context::Context;
use crate::outcome::Outcome;

/// Refine the rotation between LiDAR and cameras on any recording, without a board.
///
/// Brightness in LiDAR and images (mutual information) says how a camera is turned, edges check it; the rig must be right
/// within 2.5°. Each camera's transform goes to `lsfb calib joint`, which joins them with those to the IMU.
///
/// Examples:
///   lsfb calib refine scan.mcap --out refined.json
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
    /// What was found; the transforms lie beside it.
    #[arg(long, value_name = "JSON")]
    out: PathBuf,
    /// Settings (TOML), instead of the defaults.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// Refines, writes the transforms, prints what was found.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: VerifyConfig = super::config_or_default(arguments.config.as_deref())?;
    let recording = context.open(&arguments.recording)?;
    let mut provenance = Provenance::new(&config);
    provenance.add_input(&arguments.recording)?;
    let rig = super::rig_for(&recording, arguments.rig.as_deref(), &mut provenance)?;
    super::expect_writable(&arguments.out)?;
    let show = |p| context.show_or_end(p);
    let found = refine(&recording, &rig, &config, &show)?;
    let mut lines = Vec::new();
    for refined in &found {
        let mut line = format!("{}: {}", refined.camera, refined.sentence);
        let transforms = write_transforms(&arguments.out, refined.edge.as_slice())?;
        if !transforms.is_empty() {
            line += &format!(", {}", listed(&transforms));
        }
        lines.push(line);
    }
    let text = serde_json::to_string_pretty(&found)? + "\n";
    super::write(&arguments.out, text)?;
    provenance.write(&arguments.out)?;
    context.print(&found, || lines.join("\n"))?;
    Ok(Outcome::Done)
}
