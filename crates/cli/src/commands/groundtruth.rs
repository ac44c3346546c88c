//! `lsfb groundtruth`: a walk and an HD map → trajectory.

use std::path::{Path, PathBuf};

use lsfb_pipeline::ground_truth::{GroundTruth, GroundTruthConfig, ground_truth};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, read_tum, write_tum};

use crate::context::Context;
use crate::outcome::Outcome;
use crate::standing;

/// Compute the ground-truth trajectory of a walk in an HD map.
///
/// An existing trajectory, made by this program from the same walk and map with the same settings, is not computed again.
///
/// Examples:
///   lsfb groundtruth walk.mcap --map map --out walk.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The recording of a walk with a phone or glasses.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// The map, a folder.
    #[arg(long, value_name = "FOLDER")]
    map: PathBuf,
    /// The trajectory to write, in the map's world frame.
    #[arg(long, value_name = "TUM")]
    out: PathBuf,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

/// Computes, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: GroundTruthConfig = super::config_or_default(arguments.config.as_deref())?;
    let job = WalkJob {
        recording: &arguments.recording,
        map: &arguments.map,
        out: &arguments.out,
        config: &config,
    };
    let found = job
        .compute(context, |result| {
            context.claim(result, &[&arguments.recording])
        })?
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

/// A trajectory to be computed of a walk.
pub struct WalkJob<'a> {
    pub recording: &'a Path,
    pub map: &'a Path,
    pub out: &'a Path,
    pub config: &'a GroundTruthConfig,
}

impl WalkJob<'_> {
    /// Computes the trajectory and writes it with where it comes from, unless it stands. `claim` is asked before anything is
    /// replaced.
    pub fn compute(
        &self,
        context: &Context,
        claim: impl Fn(&Path) -> anyhow::Result<()>,
    ) -> anyhow::Result<WrittenTrajectory> {
        let (walk, hd_map) = (context.open(self.recording)?, super::open_map(self.map)?);
        let mut provenance = Provenance::new(self.config);
        provenance.add_input(self.recording)?;
        provenance.add_rig(&super::about(self.recording, walk.rig())?);
        // The map's header has the hashes of its other files.
        provenance.add_input(&self.map.join(HdMap::HEADER))?;
        if let Some(report) = context.standing(&[self.out], &provenance) {
            let trajectory = read_tum(self.out)?;
            return Ok(WrittenTrajectory {
                ground_truth: GroundTruth { trajectory, report },
                provenance,
            });
        }
        claim(self.out)?;
        let found = super::about(
            self.recording,
            ground_truth(&walk, &hd_map, self.config, &|p| context.show(p)),
        )?;
        standing::forget(&[self.out])?;
        write_tum(self.out, &found.trajectory)?;
        provenance.write(self.out)?;
        standing::finish(&[self.out], &[], &provenance, &found.report)?;
        Ok(WrittenTrajectory {
            ground_truth: found,
            provenance,
        })
    }
}
