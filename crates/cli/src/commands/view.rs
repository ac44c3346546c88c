//! `lsfb view`: recordings, maps and trajectories → `.rrd` for the Rerun viewer.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_geometry::Trajectory;
use lsfb_recording::read_tum;
use lsfb_view::{MapPoints, NamedTrajectory, ViewConfig, ViewInputs, ViewReport, Walk, write_rrd};

use crate::context::Context;
use crate::outcome::Outcome;

/// Colours of trajectories, in order: distinguishable without red and green.
const COLORS: [[u8; 3]; 4] = [
    [230, 159, 0],
    [86, 180, 233],
    [204, 121, 167],
    [0, 158, 115],
];

/// Write a file for the Rerun viewer (`pip install rerun-sdk==0.36.3; rerun FILE`).
///
/// The n-th trajectory places the n-th recording; a recording without a trajectory is shown in its own frame.
///
/// Examples:
///   lsfb view scan.mcap walk.mcap --trajectory scan.tum --trajectory walk.tum --map map --out session.rrd
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recordings to show.
    #[arg(value_name = "MCAP", required_unless_present_any = ["trajectory", "map"])]
    recordings: Vec<PathBuf>,
    /// A trajectory; may be repeated.
    #[arg(long, value_name = "TUM")]
    trajectory: Vec<PathBuf>,
    /// HD map (folder).
    #[arg(long, value_name = "FOLDER")]
    map: Option<PathBuf>,
    /// Rerun file to write.
    #[arg(long, value_name = "RRD")]
    out: PathBuf,
}

/// Writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let read: Vec<&Path> = arguments
        .recordings
        .iter()
        .chain(&arguments.trajectory)
        .map(PathBuf::as_path)
        .collect();
    context.claim(&arguments.out, &read)?;
    let report = write(
        &arguments.recordings,
        &arguments.trajectory,
        arguments.map.as_deref(),
        &arguments.out,
        context,
    )?;
    context.print(
        &serde_json::json!({ "out": arguments.out, "images": report.images, "scans": report.scans }),
        || format!("{}: {} images, {} scans", arguments.out.display(), report.images, report.scans),
    )?;
    Ok(Outcome::Done)
}

/// Writes `out`.
pub fn write(
    recordings: &[PathBuf],
    trajectories: &[PathBuf],
    map: Option<&Path>,
    out: &Path,
    context: &Context,
) -> anyhow::Result<ViewReport> {
    let name = |path: &Path| {
        path.file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let opened = recordings
        .iter()
        .map(|path| context.open(path))
        .collect::<Result<Vec<_>, _>>()?;
    let known = trajectories
        .iter()
        .map(|path| read_tum(path))
        .collect::<Result<Vec<_>, _>>()?;
    let mut inputs = ViewInputs::default();
    if let Some(map) = map {
        let map = super::open_map(map)?;
        let positions = map.positions().map(|p| p.cast::<f32>().into());
        inputs.map = MapPoints {
            positions_m: positions.collect(),
            colors_rgb: Vec::new(),
        };
    }
    for (index, (path, trajectory)) in trajectories.iter().zip(&known).enumerate() {
        let color_rgb = COLORS[index % COLORS.len()];
        inputs.trajectories.push(NamedTrajectory {
            name: name(path),
            trajectory: trajectory.clone(),
            color_rgb,
        });
    }
    for (index, (path, recording)) in recordings.iter().zip(&opened).enumerate() {
        inputs.walks.push(Walk {
            name: name(path),
            recording,
            rig: recording.rig()?,
            world_from_rig: known
                .get(index)
                .cloned()
                .unwrap_or_else(|| Trajectory::new(Vec::new())),
        });
    }
    write_rrd(out, &inputs, &ViewConfig::default(), &|p| context.show(p))
        .context("cannot write the Rerun file")
}
