//! What `lsfb odometry` runs on: a recording of ours, somebody's bag, a capture of packets, a folder of clouds.

mod bag;
mod clouds;
mod packets;
mod scratch;
mod sensors;

use std::path::Path;

use anyhow::Context as _;
use lsfb_datasets::RosBag;
use lsfb_drivers::any_lidar::Model;
use lsfb_pipeline::odometry::{OdometryConfig, OdometryResult, run_odometry};
use lsfb_recording::Recording;
use lsfb_types::{Finding, Judgement, Verdict};
use serde::Serialize;

use crate::bad_argument::BadArgument;
use crate::commands::{about, expect_file};
use crate::context::Context;
pub use scratch::Scratch;

/// What the command line says about the input.
pub struct Choice<'a> {
    pub path: &'a Path,
    pub rig: Option<&'a Path>,
    pub lidar: Option<&'a str>,
    pub imu: Option<&'a str>,
    pub rate_hz: f64,
    /// The sensor: of packets the one that they must be of; of clouds one whose azimuths are times.
    pub model: Option<Model>,
    /// Where the scans of an input that is no recording of ours are kept, for whoever stores clouds of them.
    pub keep: Option<&'a Path>,
}

/// What the scans and samples were taken from.
#[derive(Clone, Debug, Default, Serialize)]
pub struct InputReport {
    /// The topic of the scans.
    pub lidar_topic: Option<String>,
    /// The topic of the inertial samples.
    pub imu_topic: Option<String>,
    /// Where the LiDAR's pose on the IMU is from; absent without IMU.
    pub extrinsic: Option<&'static str>,
    /// When the scans were taken, by what.
    pub scan_times: String,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// The odometry's result, and what it was made from.
pub struct Run {
    pub result: OdometryResult,
    pub input: InputReport,
}

impl Run {
    /// What is found about the trajectory, and about what it was made from.
    pub fn judgement(&self) -> Judgement {
        let mut findings = self.result.report.findings();
        let of_input = self.input.warnings.iter();
        findings.extend(
            of_input.map(|what| Finding::new("input", Verdict::Warn, "input", what.clone())),
        );
        Judgement::new(findings)
    }
}

/// Runs the odometry on whatever the input is.
pub fn run(choice: &Choice, config: &OdometryConfig, context: &Context) -> anyhow::Result<Run> {
    expect_file(choice.path, "record one with `lsfb scan`")?;
    let ending = choice.path.extension().and_then(|e| e.to_str());
    let ending = ending.map(str::to_lowercase);
    let run = match ending.as_deref() {
        Some("mcap") if is_ours(choice)? => of_recording(choice, config, context),
        Some("pcap" | "pcapng") => packets::run(choice, config, context),
        Some("mcap" | "db3" | "bag") => bag::run(choice, config, context),
        _ if choice.path.is_dir() && holds_a_bag(choice.path)? => bag::run(choice, config, context),
        _ => clouds::run(choice, config, context),
    }?;
    run.result.expect_poses(choice.path)?;
    Ok(run)
}

/// Whether an MCAP has a rig of its own, good or bad, and no other is asked for.
pub fn is_ours(choice: &Choice) -> anyhow::Result<bool> {
    let is_foreign = choice.lidar.is_some() || choice.imu.is_some() || choice.rig.is_some();
    let rig = Recording::open(choice.path)?.rig();
    let has_none = matches!(rig, Err(lsfb_recording::Error::MissingAttachment { .. }));
    Ok(!is_foreign && !has_none)
}

fn holds_a_bag(folder: &Path) -> anyhow::Result<bool> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    for entry in entries {
        if RosBag::is_file_of_one(&entry?.path()) {
            return Ok(true);
        }
    }
    Ok(false)
}

fn of_recording(
    choice: &Choice,
    config: &OdometryConfig,
    context: &Context,
) -> anyhow::Result<Run> {
    let recording = context.open(choice.path)?;
    let result = run_odometry(&recording, config, &|p| context.show(p));
    Ok(Run {
        result: about(choice.path, result)?,
        input: InputReport {
            lidar_topic: Some(format!("/{}/points", recording.main_lidar())),
            extrinsic: Some("rig"),
            scan_times: "message stamps".to_owned(),
            ..InputReport::default()
        },
    })
}

/// Fails where a topic is named that the input cannot have.
fn expect_no_topics(choice: &Choice) -> anyhow::Result<()> {
    anyhow::ensure!(
        choice.imu.is_none() && choice.lidar.is_none(),
        BadArgument::new(format!(
            "--imu-topic and --lidar-topic name topics of a bag, but {} is not a bag",
            choice.path.display()
        ))
    );
    Ok(())
}
