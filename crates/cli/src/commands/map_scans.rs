//! `lsfb map scans`: poses of clouds refined by what they show, without images.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_datasets::{CloudFolder, ScanTimes, is_graph_folder, read_graph_folder};
use lsfb_geometry::{Trajectory, Vector3};
use lsfb_pipeline::mapping::{PosedScan, RefinedScans, ScanPoseConfig, refine_scan_poses};
use lsfb_recording::{Provenance, read_tum, write_tum};
use lsfb_types::{Judgement, Timestamp};

use super::calib_input::add_input;
use crate::context::Context;
use crate::outcome::Outcome;

/// Clouds a second where nothing says when they were taken: such a folder is refused.
const NO_RATE_HZ: f64 = 1.0;

/// Refine the poses of point clouds by their planes and edges.
///
/// Uses the LiDAR terms of Eq. 4, for scans without images. The clouds must be deskewed. The folder
/// holds either graph.txt with their poses, and planes_K.bin and edges_K.bin or folders with
/// points.bin, as gtsam_points writes them; or files that `lsfb odometry` reads, timed by their names
/// or times.txt. In the second case a trajectory gives the poses, and only planes are compared. The
/// first pose is held fixed.
///
/// Examples:
///   lsfb map scans newer_01 --out refined.tum
///   lsfb map scans clouds --trajectory other-slam.tum --out refined.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment, after_long_help = settings())]
pub struct ScansArguments {
    /// Folder of point clouds.
    #[arg(value_name = "FOLDER")]
    clouds: PathBuf,
    /// Poses of the LiDAR, required if the folder has none. If it has, these replace them: one pose per
    /// cloud, in the same order.
    #[arg(long, value_name = "TUM")]
    trajectory: Option<PathBuf>,
    /// Refined poses to write; with graph.txt, cloud k (from 0) is at k seconds.
    #[arg(long, value_name = "TUM")]
    out: PathBuf,
    /// Settings instead of the defaults; `lsfb map scans --help` lists them.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

fn settings() -> String {
    let settings = toml::to_string(&ScanPoseConfig::default()).unwrap_or_default();
    format!("Settings of --config and their defaults:\n\n{settings}")
}

/// Does it.
pub fn scans(arguments: &ScansArguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: ScanPoseConfig = super::config_or_default(arguments.config.as_deref())?;
    let folder = &arguments.clouds;
    super::expect_file(folder, "give a folder of clouds")?;
    let mut read = vec![folder.as_path()];
    read.extend(arguments.trajectory.as_deref());
    context.claim(&arguments.out, &read)?;
    let given = arguments.trajectory.as_deref().map(read_tum).transpose()?;
    let scans = match is_graph_folder(folder) {
        true => of_graph(folder, given.as_ref())?,
        false => {
            let missing = "the poses of the clouds are unknown: give --trajectory";
            let given = given.with_context(|| format!("{}: {missing}", folder.display()))?;
            of_files(folder, &given)?
        }
    };
    let found = refine_scan_poses(&scans, &config, &|p| context.show(p));
    let RefinedScans { poses, report } = super::about(folder, found)?;
    write_tum(&arguments.out, &Trajectory::new(poses))?;
    let mut provenance = Provenance::new(&config);
    add_input(&mut provenance, folder)?;
    if let Some(path) = &arguments.trajectory {
        provenance.add_input(path)?;
    }
    provenance.write(&arguments.out)?;
    let judgement = Judgement::new(report.findings());
    let summary = serde_json::json!({
        "verdict": judgement.verdict(),
        "findings": judgement.findings(),
        "report": &report,
    });
    context.print(&summary, || {
        let (before, after) = (&report.lidar_before, &report.lidar_after);
        let mut text = format!(
            "{}: {} scans; {} planes agree to {:.1} cm rms (before {:.1} cm), {} edges to {:.1} cm (before {:.1} cm); moved by up to {:.1} cm and {:.2}°",
            arguments.out.display(),
            report.scans,
            after.plane_matches,
            1e2 * after.plane_rms_m,
            1e2 * before.plane_rms_m,
            after.edge_matches,
            1e2 * after.edge_rms_m,
            1e2 * before.edge_rms_m,
            1e2 * report.moved_m,
            report.turned_deg
        );
        for finding in judgement.problems() {
            text += &format!("\n  {}", finding.sentence());
        }
        text
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

fn of_graph(folder: &Path, given: Option<&Trajectory>) -> anyhow::Result<Vec<PosedScan>> {
    let clouds = read_graph_folder(folder)?;
    let poses = given.map(Trajectory::poses);
    if let Some(poses) = poses {
        anyhow::ensure!(
            poses.len() == clouds.len(),
            "{}: {} clouds, but {} poses in --trajectory",
            folder.display(),
            clouds.len(),
            poses.len()
        );
    }
    let scan = |(k, cloud): (usize, lsfb_datasets::GraphCloud)| PosedScan {
        time: Timestamp::from_secs_f64(k as f64),
        world_from_lidar: poses.map_or(cloud.world_from_lidar, |p| p[k].world_from_rig),
        on_surfaces: cloud.points,
        on_edges: cloud.edges,
    };
    Ok(clouds.into_iter().enumerate().map(scan).collect())
}

fn of_files(folder: &Path, given: &Trajectory) -> anyhow::Result<Vec<PosedScan>> {
    let clouds = CloudFolder::open(folder, NO_RATE_HZ)?;
    let mut scans = Vec::with_capacity(clouds.len());
    for scan in clouds.scans() {
        let scan = scan?;
        anyhow::ensure!(
            clouds.scan_times() != ScanTimes::Rate,
            "{}: the times of the clouds are unknown: use stamps as file names, or a times.txt",
            folder.display()
        );
        let pose = given
            .at(scan.time)
            .with_context(|| format!("{}: it is outside the trajectory", scan.path.display()))?;
        let points = scan.cloud.scan.points.iter();
        scans.push(PosedScan {
            time: scan.time,
            world_from_lidar: pose,
            on_surfaces: points
                .map(|p| Vector3::from(p.position_m.map(f64::from)))
                .collect(),
            on_edges: Vec::new(),
        });
    }
    Ok(scans)
}
