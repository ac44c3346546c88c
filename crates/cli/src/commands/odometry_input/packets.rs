//! Odometry of packets, which become scans in a file that is gone afterwards.

use std::path::Path;

use lsfb_capture::{CaptureReport, Ending, ReplayConfig, replay};
use lsfb_drivers::any_lidar::Settings;
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::pcap::PcapSource;
use lsfb_geometry::MAIN_LIDAR;
use lsfb_pipeline::odometry::{OdometryConfig, OdometryResult, OdometryRun, TimedScan};
use lsfb_recording::Recording;
use lsfb_recording::cloud::{PointTimes, TimesBegin};
use lsfb_types::{Finding, Progress, Verdict};

use super::scratch::Scratch;
use super::sensors::Sensors;
use super::{Choice, InputReport, Run, expect_no_topics};
use crate::context::Context;
use crate::refused::Refused;

/// Runs the odometry on a capture of packets.
pub(super) fn run(
    choice: &Choice,
    config: &OdometryConfig,
    context: &Context,
) -> anyhow::Result<Run> {
    expect_no_topics(choice)?;
    let scratch = Scratch::new("packets")?;
    let source = PcapSource::open(choice.path, &[])?;
    let decoded = decode(source, &scratch.scans, choice, context)?;
    let run = Sensors::lidar_alone(choice)?.start(choice, config)?;
    Ok(Run {
        result: run_on_scans(&scratch.scans, run, context)?,
        input: InputReport {
            scan_times: "packets".to_owned(),
            warnings: about_packets(&decoded, context),
            ..InputReport::default()
        },
    })
}

/// The odometry over scans that were decoded from packets.
pub(super) fn run_on_scans(
    path: &Path,
    mut run: OdometryRun,
    context: &Context,
) -> anyhow::Result<OdometryResult> {
    let recording = Recording::open(path)?;
    for scan in recording.scans_of(MAIN_LIDAR)? {
        context.show(Progress {
            stage: "lidar odometry",
            done: run.taken(),
            total: 0,
        })?;
        let times = PointTimes::Field {
            name: "t".to_owned(),
            begins: TimesBegin::AfterStamp { nanos: 0 },
        };
        run.push(TimedScan { scan: scan?, times })?;
    }
    Ok(run.finish()?)
}

/// Makes scans of packets.
pub(super) fn decode(
    source: impl PacketSource,
    out: &Path,
    choice: &Choice,
    context: &Context,
) -> anyhow::Result<CaptureReport> {
    let config = ReplayConfig {
        lidar: Settings {
            model: choice.model,
            ..Settings::default()
        },
        ..ReplayConfig::default()
    };
    let report = replay(source, &config, out, &|p| context.show(p))?;
    if report.streams.iter().all(|stream| stream.decoded == 0) {
        let bad = report.streams.iter().find_map(|s| s.first_bad.as_deref());
        let why = bad.unwrap_or("it has no LiDAR packets");
        let subject = choice.path.display().to_string();
        let what = format!("no scan could be assembled: {why}");
        let none = Finding::new("no-scans", Verdict::Fail, subject, what)
            .remedy("check the model (--lidar-model) and its calibration file");
        return Err(Refused(none).into());
    }
    Ok(report)
}

/// What the odometry's reader should know of packets: where any are missing or cannot be read, data is lost.
pub(super) fn about_packets(report: &CaptureReport, context: &Context) -> Vec<String> {
    let mut said = Vec::new();
    if report.lost > 0 {
        context.lose_data();
        let bad = report.streams.iter().find_map(|s| s.first_bad.as_ref());
        let bad = bad.map_or(String::new(), |bad| {
            format!("; the first unreadable one: {bad}")
        });
        said.push(format!(
            "{} packets are missing or unreadable{bad}",
            report.lost
        ));
        let endings = report.streams.iter().filter_map(|s| match &s.ending {
            Ending::Lost(why) => Some(why.clone()),
            Ending::Stopped | Ending::EndOfStream => None,
        });
        said.extend(endings);
    }
    if report.streams.len() > 1 {
        let names: Vec<&str> = report.streams.iter().map(|s| s.name.as_str()).collect();
        said.push(format!(
            "packets of several LiDARs ({}): the scans of {MAIN_LIDAR} are used",
            names.join(", ")
        ));
    }
    said.extend(report.streams.iter().flat_map(|s| s.notes.iter().cloned()));
    said
}
