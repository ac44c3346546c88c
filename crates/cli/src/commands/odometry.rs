//! `lsfb odometry`: scans → trajectory.

use std::path::{Path, PathBuf};

use lsfb_drivers::any_lidar::Model;
use lsfb_pipeline::lidar_features::LidarFeatureConfig;
use lsfb_pipeline::loops::{Closing, Loops, close_loops, find_loops};
use lsfb_pipeline::odometry::{OdometryConfig, OdometryReport, OdometryResult};
use lsfb_pipeline::stored_clouds::{
    Firing, STORED_SHARE, StoredReport, StoringConfig, store_clouds,
};
use lsfb_recording::{Provenance, Recording, write_tum};
use lsfb_types::{Finding, Verdict};
use serde::Serialize;

use super::covariance_file;
use super::odometry_input::{Choice, InputReport, Scratch, is_ours, run as run_on};
use crate::context::Context;
use crate::files;
use crate::judged::{Judged, problem_lines};
use crate::one_of::one_of;
use crate::outcome::Outcome;

/// Run LiDAR(-inertial) odometry on a recording, ROS bag, packet capture or folder of clouds.
///
/// ROS bags (.bag, .db3, .mcap, rosbag2 folders) hold clouds, or packets of a LiDAR of --lidar-model, on
/// any topic, with or without an IMU. Point clouds are .pcd, .ply, .las, .laz, KITTI .bin or nuScenes
/// .pcd.bin. Written beside WALK.tum: WALK_covariance.txt, poses with covariance relative to the first,
/// for `lsfb eval --align origin`.
///
/// Exit code 3: packets or messages are missing or unreadable, scans have no pose, or the last position
/// is uncertain by more than a metre; also for gaps of 1.5 s or more without a registered scan, in
/// which no poses are written (lidar-gap). Exit code 4: IMU and scans contradict each other (axes,
/// clock, unit, or mounting): the trajectory is written, but wrong; or only one scan has a pose.
///
/// --out-loops detects revisited places, corrects the drift, and lists every loop candidate with its
/// scores and verdict; edit the verdicts and pass the list to --loops to use it as it is. Details:
/// docs/odometry.md.
///
/// Examples:
///   lsfb odometry scan.mcap --out scan.tum
///   lsfb odometry scan.mcap --out scan.tum --out-clouds clouds.mcap
///   lsfb odometry scan.mcap --out-loops loops.txt --out scan.tum
///   lsfb odometry scan.mcap --loops loops.txt --out scan.tum --force
///   lsfb odometry kitti/velodyne_points/data --outdoor --out kitti.tum
///   lsfb odometry walk.bag --lidar-topic /os_cloud_node/points --imu-topic /imu --rig rig.toml --out walk.tum
///   lsfb odometry drive.pcap --out drive.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recording, ROS bag, packet capture, or folder of point clouds.
    #[arg(value_name = "MCAP|BAG|PCAP|FOLDER")]
    input: PathBuf,
    /// Trajectory to write.
    #[arg(long, value_name = "TUM")]
    out: PathBuf,
    /// Detect and close loops, and write the list of loop candidates here.
    #[arg(long, value_name = "FILE")]
    out_loops: Option<PathBuf>,
    /// Close the loops that this list accepts; do not search for others.
    #[arg(long, value_name = "FILE", conflicts_with = "out_loops")]
    loops: Option<PathBuf>,
    /// Store the deskewed scans here, thinned to a fifth of their points; `lsfb map --stored-clouds` takes
    /// those of recordings of `lsfb scan`. Not written if IMU and scans contradict each other.
    #[arg(long, value_name = "MCAP")]
    out_clouds: Option<PathBuf>,
    /// Share of the points to store.
    #[arg(long, value_name = "PERCENT", default_value_t = 100.0 * STORED_SHARE, value_parser = share_percent, requires = "out_clouds")]
    clouds_percent: f64,
    /// Firing to which the stored scans are deskewed; poses are those of the last.
    #[arg(long, value_name = "FIRING", default_value = Firing::Last.key(), value_parser = one_of(&Firing::ALL, Firing::key), requires = "out_clouds")]
    clouds_at: Firing,
    /// Use settings for streets: long ranges, coarse voxels.
    #[arg(long)]
    outdoor: bool,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML", conflicts_with = "outdoor")]
    config: Option<PathBuf>,
    /// Rig with the LiDAR's pose relative to the IMU, and the noise of both. Recordings of `lsfb scan`
    /// contain one; a bag may give the pose in /tf_static.
    #[arg(long, value_name = "TOML")]
    rig: Option<PathBuf>,
    /// Topic of the scans, if a bag has several.
    #[arg(long = "lidar-topic", visible_alias = "lidar", value_name = "TOPIC")]
    lidar: Option<String>,
    /// Topic of the IMU, if a bag has several.
    #[arg(long = "imu-topic", visible_alias = "imu", value_name = "TOPIC")]
    imu: Option<String>,
    /// Scans per second, for a folder of clouds without times in the points, the file names, or a list
    /// beside them.
    #[arg(long, value_name = "HZ", default_value_t = 10.0, value_parser = rate_hz)]
    rate_hz: f64,
    /// Model of the spinning LiDAR. Packets of any other model are refused; points of clouds without times
    /// are timed by their azimuth.
    #[arg(long, value_name = "MODEL", value_parser = super::scan::lidar_model)]
    lidar_model: Option<Model>,
}

/// What is said about a trajectory.
#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    odometry: &'a OdometryReport,
    input: &'a InputReport,
    /// Absent where loops were not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    loops: Option<Closing>,
    /// Absent where clouds were not stored.
    #[serde(skip_serializing_if = "Option::is_none")]
    clouds: Option<StoredReport>,
}

/// What the file of covariances says of itself.
const WHAT_IS_IN_IT: &str = "Relative to the first pose, which is taken as exact. Included: errors \
     of the scans against the map, and those that the map inherits from\nthe poses it was built \
     from. Not included: errors of the rig (pose of the LiDAR on the IMU, the LiDAR's scale and \
     clock).";
/// What it says besides where loops were closed.
const LOOPS_CLOSED: &str = "\nLoops are closed: the covariance is that of the graph of steps and loops, and holds only if no closed loop is false.";
/// What it says besides where scans are rare.
const RARE_SCANS: &str = "\nThe scans are more than a second apart: registration to the wrong surface is not included. Do not rely on it.";

fn rate_hz(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|hz| (0.01..=1000.0).contains(hz));
    rate.ok_or_else(|| "expected a number from 0.01 to 1000".to_owned())
}

fn share_percent(text: &str) -> Result<f64, String> {
    let share = text.parse().ok().filter(|p| (1.0..=100.0).contains(p));
    share.ok_or_else(|| "expected a number from 1 to 100".to_owned())
}

/// Stores the clouds that are asked for, of scans that are in a recording.
fn store(
    path: &Path,
    recording: &Recording,
    arguments: &Arguments,
    config: &OdometryConfig,
    result: &OdometryResult,
    context: &Context,
) -> anyhow::Result<StoredReport> {
    let storing = StoringConfig {
        odometry: config,
        features: LidarFeatureConfig::default(),
        share: arguments.clouds_percent / 100.0,
        firing: arguments.clouds_at,
    };
    let progress = |p| context.show(p);
    Ok(store_clouds(recording, result, &storing, path, &progress)?)
}

/// Closes the loops that are asked for; `None` where none are.
fn close(
    arguments: &Arguments,
    config: &OdometryConfig,
    result: &mut OdometryResult,
    context: &Context,
) -> anyhow::Result<Option<Closing>> {
    let progress = |p| context.show(p);
    let loops = match (&arguments.out_loops, &arguments.loops) {
        (Some(list), _) => {
            let loops = find_loops(result, config, &progress)?;
            files::write(list, loops.to_text())?;
            loops
        }
        (None, Some(list)) => Loops::read(list, result)?,
        (None, None) => return Ok(None),
    };
    Ok(Some(close_loops(result, &loops, &progress)?))
}

fn about_loops(loops: &Closing) -> String {
    format!(
        "\n  {} loops closed, {} rejected; poses moved by {:.2} m at most",
        loops.accepted, loops.rejected, loops.moved_m
    )
}

fn about_clouds(path: &Path, clouds: Option<&StoredReport>) -> String {
    let Some(stored) = clouds else {
        return format!(
            "\n  {}: not written because IMU and scans contradict each other",
            path.display()
        );
    };
    format!(
        "\n  {}: {} scans, {:.1} % of their points, {} edge points",
        path.display(),
        stored.scans,
        100.0 * stored.share(),
        stored.bends
    )
}

/// Whether the input is a recording of ours, with a rig in it.
fn is_recording(choice: &Choice) -> anyhow::Result<bool> {
    let ending = choice.path.extension().and_then(|e| e.to_str());
    Ok(ending.is_some_and(|e| e.eq_ignore_ascii_case("mcap")) && is_ours(choice)?)
}

/// Runs the odometry, prints its report.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config = match &arguments.config {
        Some(path) => super::read_config(path)?,
        None if arguments.outdoor => OdometryConfig::outdoor(),
        None => OdometryConfig::default(),
    };
    super::expect_file(&arguments.input, "record one with `lsfb scan`")?;
    let read: Vec<&Path> = [&arguments.input]
        .into_iter()
        .chain(&arguments.rig)
        .chain(&arguments.loops)
        .map(PathBuf::as_path)
        .collect();
    let beside = files::beside(&arguments.out, "covariance");
    let results: Vec<&Path> = [&arguments.out, &beside]
        .into_iter()
        .chain(&arguments.out_loops)
        .chain(&arguments.out_clouds)
        .map(PathBuf::as_path)
        .collect();
    for result in results {
        context.claim(result, &read)?;
    }
    let choice = Choice {
        path: &arguments.input,
        rig: arguments.rig.as_deref(),
        lidar: arguments.lidar.as_deref(),
        imu: arguments.imu.as_deref(),
        rate_hz: arguments.rate_hz,
        model: arguments.lidar_model,
        keep: None,
    };
    let kept = match arguments.out_clouds.is_some() && !is_recording(&choice)? {
        true => Some(Scratch::new("scans")?),
        false => None,
    };
    let choice = Choice {
        keep: kept.as_ref().map(|kept| kept.scans.as_path()),
        ..choice
    };
    let mut found = run_on(&choice, &config, context)?;
    let loops = close(arguments, &config, &mut found.result, context)?;
    context.check_stop()?;
    write_tum(&arguments.out, &found.result.trajectory_outside_gaps())?;
    let scan_poses = found.result.scan_poses.iter();
    let scan_poses = scan_poses.map(|scan| (&scan.pose, &scan.covariance));
    let mut says = WHAT_IS_IN_IT.to_owned();
    if loops.is_some_and(|l| l.moved_m > 0.0) {
        says += LOOPS_CLOSED;
    }
    if found.result.report.has_rare_scans() {
        says += RARE_SCANS;
    }
    files::write(&beside, covariance_file::text(&says, scan_poses))?;
    let mut provenance = Provenance::new(&config);
    super::calib_input::add_input(&mut provenance, &arguments.input)?;
    for input in arguments.rig.iter().chain(&arguments.loops) {
        provenance.add_input(input)?;
    }
    let judgement = found.judgement();
    let failures = judgement.findings().iter();
    let failures = failures.filter(|finding| finding.verdict == Verdict::Fail);
    let failures = failures.map(Finding::sentence).collect();
    provenance.with_failures(failures).write(&arguments.out)?;
    // None of a trajectory that is wrong.
    let out_clouds = arguments.out_clouds.as_deref();
    let out_clouds = out_clouds.filter(|_| judgement.verdict() != Verdict::Fail);
    let clouds = out_clouds.map(|path| {
        let recording = match &kept {
            Some(kept) => Recording::open(&kept.scans)?,
            None => context.open(&arguments.input)?,
        };
        let stored = store(path, &recording, arguments, &config, &found.result, context)?;
        provenance.write(path)?;
        anyhow::Ok(stored)
    });
    let clouds = clouds.transpose()?;
    let r = &found.result.report;
    let report = Report {
        odometry: r,
        input: &found.input,
        loops,
        clouds,
    };
    let summary = format!("{} of {} scans registered", r.registered, r.scans);
    context.print(&Judged::new(&judgement, &summary, &report), || {
        let mut text = format!(
            "{}: {summary}, path {:.2} m, residual {:.1} mm to the map's planes",
            arguments.out.display(),
            r.path_length_m,
            r.plane_rms_m * 1e3
        );
        let deskewed = [
            (r.deskew.by_times, "by point times"),
            (r.deskew.by_azimuth, "by azimuth"),
            (r.deskew.none, "not at all"),
        ];
        let deskewed = deskewed.iter().filter(|(scans, _)| *scans > 0);
        let deskewed: Vec<String> = deskewed.map(|(n, how)| format!("{n} {how}")).collect();
        text += &format!("\n  scans deskewed: {}", deskewed.join(", "));
        if let Some(loops) = &loops {
            text += &about_loops(loops);
        }
        if let Some(path) = &arguments.out_clouds {
            text += &about_clouds(path, clouds.as_ref());
        }
        text += &format!("\n{}", problem_lines(&judgement));
        text.trim_end().to_owned()
    })?;
    Ok(match (judgement.verdict(), r.is_whole()) {
        (Verdict::Fail, _) => Outcome::JudgementFailed,
        (_, true) => Outcome::Done,
        (_, false) => Outcome::DataLost,
    })
}
