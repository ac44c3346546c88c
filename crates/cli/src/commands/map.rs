//! `lsfb map`: a scan → HD map.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_pipeline::hd_map::{HdMap, PosedMapConfig, build_map_from_posed_images};
use lsfb_pipeline::mapping::{MappingConfig, MappingResult, build_map};
use lsfb_pipeline::posed_images::PosedImages;
use lsfb_recording::{Provenance, write_tum};
use serde::Serialize;

use crate::context::Context;
use crate::outcome::Outcome;

/// Build an HD map from a scanner's recording, or from images with known poses.
///
/// Examples:
///   lsfb map scan.mcap --out map --trajectory scan.tum
///   lsfb map --posed-images hololens_office --without-every 5 --out office-map
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The recording (MCAP).
    #[arg(
        required_unless_present = "posed_images",
        conflicts_with = "posed_images"
    )]
    recording: Option<PathBuf>,
    /// Folder with K.txt, poses_T_world_cam_rowmajor4x4.txt and images/.
    #[arg(long, value_name = "DIR")]
    posed_images: Option<PathBuf>,
    /// Leave out every N-th of those images, so that they can be localized.
    #[arg(long, value_name = "N", requires = "posed_images")]
    without_every: Option<usize>,
    /// The map: a folder.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The scanner's trajectory (TUM).
    #[arg(long, value_name = "TUM", conflicts_with = "posed_images")]
    trajectory: Option<PathBuf>,
    /// Settings (TOML), instead of the defaults.
    #[arg(long, value_name = "FILE")]
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
    let recording = arguments.recording.as_deref().context("name a recording")?;
    let config: MappingConfig = super::config_or_default(arguments.config.as_deref())?;
    let result = build(
        recording,
        &arguments.out,
        arguments.trajectory.as_deref(),
        &config,
        context,
    )?
    .mapping;
    let r = &result.report;
    context.print(&summary(&arguments.out, &result.map, r), || {
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
    pub mapping: MappingResult,
    pub provenance: Provenance,
}

/// Builds the map of a recording and writes it, its trajectory and where both come from.
pub fn build(
    recording: &Path,
    out: &Path,
    trajectory: Option<&Path>,
    config: &MappingConfig,
    context: &Context,
) -> anyhow::Result<WrittenMap> {
    for result in [Some(out), trajectory].into_iter().flatten() {
        super::expect_writable(result)?;
    }
    let scan = context.open(recording)?;
    let result = super::about(recording, build_map(&scan, config, &|p| context.show(p)))?;
    result.map.write(out)?;
    let mut provenance = Provenance::new(config);
    provenance.add_input(recording)?;
    provenance.add_rig(&scan.rig()?);
    provenance.write(out)?;
    if let Some(path) = trajectory {
        write_tum(path, &result.trajectory)?;
        provenance.write(path)?;
    }
    Ok(WrittenMap {
        mapping: result,
        provenance,
    })
}

fn from_posed_images(
    folder: &Path,
    arguments: &Arguments,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let config: PosedMapConfig = super::config_or_default(arguments.config.as_deref())?;
    super::expect_writable(&arguments.out)?;
    super::expect_file(folder, "name a folder of posed images")?;
    let posed = PosedImages::read(folder)?.without_every(arguments.without_every.unwrap_or(0));
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
