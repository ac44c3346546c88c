//! `lsfb groundtruth`: a walk and an HD map → trajectory.

use std::path::{Path, PathBuf};

use lsfb_pipeline::ground_truth::{GroundTruth, GroundTruthConfig, ground_truth};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, write_tum};

use crate::context::Context;
use crate::outcome::Outcome;

/// Compute the ground-truth trajectory of a walk in an HD map.
///
/// Example:
///   lsfb groundtruth walk.mcap --map map --out walk.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The walk (MCAP) of a phone or glasses.
    recording: PathBuf,
    /// The map: a folder.
    #[arg(long, value_name = "DIR")]
    map: PathBuf,
    /// The trajectory (TUM), in the world of the map.
    #[arg(long, value_name = "TUM")]
    out: PathBuf,
    /// Settings (TOML), instead of the defaults.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// Computes, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: GroundTruthConfig = super::config_or_default(arguments.config.as_deref())?;
    let found = compute(
        &arguments.recording,
        &arguments.map,
        &arguments.out,
        &config,
        context,
    )?
    .ground_truth;
    let r = &found.report;
    context.print(r, || {
        let mut text = format!(
            "{}: {} poses, {} of {} frames localized, {} bridged, reprojection {:.3} px rms",
            arguments.out.display(),
            found.trajectory.len(),
            r.localized,
            r.frames,
            r.bridged,
            r.map_errors.rms_px
        );
        for warning in &r.warnings {
            text += &format!("\n  {warning}");
        }
        text
    })?;
    Ok(Outcome::Done)
}

/// A trajectory that was written, and where it comes from.
pub struct WrittenTrajectory {
    pub ground_truth: GroundTruth,
    pub provenance: Provenance,
}

/// Computes the trajectory and writes it with where it comes from.
pub fn compute(
    recording: &Path,
    map: &Path,
    out: &Path,
    config: &GroundTruthConfig,
    context: &Context,
) -> anyhow::Result<WrittenTrajectory> {
    super::expect_writable(out)?;
    let (walk, hd_map) = (context.open(recording)?, super::open_map(map)?);
    let found = super::about(
        recording,
        ground_truth(&walk, &hd_map, config, &|p| context.show(p)),
    )?;
    write_tum(out, &found.trajectory)?;
    let mut provenance = Provenance::new(config);
    provenance.add_input(recording)?;
    provenance.add_rig(&walk.rig()?);
    // The map's header has the hashes of its other files.
    provenance.add_input(&map.join(HdMap::HEADER))?;
    provenance.write(out)?;
    Ok(WrittenTrajectory {
        ground_truth: found,
        provenance,
    })
}
