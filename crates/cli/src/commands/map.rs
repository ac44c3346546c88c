//! `lsfb map`: a scan → HD map.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_pipeline::hd_map::{HdMap, PosedMapConfig, build_map_from_posed_images};
use lsfb_pipeline::mapping::{MappingConfig, MappingReport, build_map};
use lsfb_pipeline::posed_images::PosedImages;
use lsfb_recording::{Provenance, write_tum};
use serde::{Deserialize, Serialize};

use crate::context::Context;
use crate::outcome::Outcome;
use crate::standing;

/// Build an HD map from a scanner's recording, or from images with known poses.
///
/// An existing map, built by this program from the same recording with the same settings, is not built again.
///
/// Examples:
///   lsfb map scan.mcap --out map --out-trajectory scan.tum
///   lsfb map --posed-images hololens_office --holdout-every 5 --out office-map
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The scanner's recording.
    #[arg(
        value_name = "MCAP",
        required_unless_present = "posed_images",
        conflicts_with = "posed_images"
    )]
    recording: Option<PathBuf>,
    /// Folder with K.txt, poses_T_world_cam_rowmajor4x4.txt and images/.
    #[arg(long, value_name = "FOLDER")]
    posed_images: Option<PathBuf>,
    /// Hold out every N-th of those images, to localize them later.
    #[arg(long, value_name = "N", requires = "posed_images")]
    holdout_every: Option<usize>,
    /// The map to write, a folder.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Also write the scanner's trajectory.
    #[arg(long, value_name = "TUM", conflicts_with = "posed_images")]
    out_trajectory: Option<PathBuf>,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

#[derive(Serialize)]
struct MapSummary<R> {
    map: PathBuf,
    points: usize,
    keyframes: usize,
    observations: usize,
    report: R,
}

/// Builds, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    if let Some(folder) = &arguments.posed_images {
        return from_posed_images(folder, arguments, context);
    }
    let recording = arguments.recording.as_deref().context("give a recording")?;
    let config: MappingConfig = super::config_or_default(arguments.config.as_deref())?;
    let job = MapJob {
        recording,
        out: &arguments.out,
        out_trajectory: arguments.out_trajectory.as_deref(),
        config: &config,
    };
    let built = job.build(context, |result| context.claim(result, &[recording]))?;
    let r = &built.report;
    context.print(&summary(&arguments.out, &built.map, r), || {
        let mut text = format!(
            "{}: {} points, {} observations in {} images, reprojection {:.3} px rms ({:.3} px before Eq. 4)",
            arguments.out.display(),
            r.points,
            r.observations,
            r.images,
            r.reprojection_rms_px,
            r.reprojection_rms_before_px
        );
        for warning in r.odometry.warnings.iter().chain(&r.warnings) {
            text += &format!("\n  {warning}");
        }
        text
    })?;
    Ok(Outcome::Done)
}

/// A map that was written, and where it comes from.
pub struct WrittenMap {
    pub map: HdMap,
    pub report: MappingReport,
    /// Of every observation in the map.
    pub reprojection_errors_px: Vec<f32>,
    pub provenance: Provenance,
}

/// What is said of a map that stands.
#[derive(Serialize, Deserialize)]
struct Said {
    report: MappingReport,
    reprojection_errors_px: Vec<f32>,
}

/// A map to be built of a recording.
pub struct MapJob<'a> {
    pub recording: &'a Path,
    pub out: &'a Path,
    pub out_trajectory: Option<&'a Path>,
    pub config: &'a MappingConfig,
}

impl MapJob<'_> {
    /// Builds the map and writes it, its trajectory and where both come from, unless they stand. `claim` is asked before
    /// anything is replaced.
    pub fn build(
        &self,
        context: &Context,
        claim: impl Fn(&Path) -> anyhow::Result<()>,
    ) -> anyhow::Result<WrittenMap> {
        let outputs: Vec<&Path> = [Some(self.out), self.out_trajectory]
            .into_iter()
            .flatten()
            .collect();
        let scan = context.open(self.recording)?;
        let mut provenance = Provenance::new(self.config);
        provenance.add_input(self.recording)?;
        provenance.add_rig(&super::about(self.recording, scan.rig())?);
        if let Some(Said {
            report,
            reprojection_errors_px,
        }) = context.standing(&outputs, &provenance)
        {
            return Ok(WrittenMap {
                map: super::open_map(self.out)?,
                report,
                reprojection_errors_px,
                provenance,
            });
        }
        outputs.iter().try_for_each(|result| claim(result))?;
        let result = super::about(
            self.recording,
            build_map(&scan, self.config, &|p| context.show(p)),
        )?;
        standing::forget(&outputs)?;
        result.map.write(self.out)?;
        provenance.write(self.out)?;
        if let Some(path) = self.out_trajectory {
            write_tum(path, &result.trajectory)?;
            provenance.write(path)?;
        }
        let errors_px = result.report.reprojection_errors_px.iter();
        let said = Said {
            reprojection_errors_px: errors_px.map(|px| *px as f32).collect(),
            report: result.report,
        };
        standing::finish(&outputs, &[], &provenance, &said)?;
        Ok(WrittenMap {
            map: result.map,
            report: said.report,
            reprojection_errors_px: said.reprojection_errors_px,
            provenance,
        })
    }
}

fn from_posed_images(
    folder: &Path,
    arguments: &Arguments,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let config: PosedMapConfig = super::config_or_default(arguments.config.as_deref())?;
    super::expect_file(folder, "name a folder of posed images")?;
    context.claim(&arguments.out, &[])?;
    let posed = PosedImages::read(folder)?.without_every(arguments.holdout_every.unwrap_or(0));
    let map = build_map_from_posed_images(&posed, &config, &|p| context.show(p))?;
    map.write(&arguments.out)?;
    context.print(&summary(&arguments.out, &map, ()), || {
        format!(
            "{}: {} points in {} keyframes",
            arguments.out.display(),
            map.point_count(),
            map.keyframe_count()
        )
    })?;
    Ok(Outcome::Done)
}

fn summary<R>(out: &Path, map: &HdMap, report: R) -> MapSummary<R> {
    MapSummary {
        map: out.to_owned(),
        points: map.point_count(),
        keyframes: map.keyframe_count(),
        observations: map.observation_count(),
        report,
    }
}
