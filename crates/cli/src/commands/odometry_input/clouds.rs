//! Odometry of a folder of clouds.

use lsfb_datasets::{CloudFolder, ScanTimes};
use lsfb_pipeline::odometry::{OdometryConfig, TimedScan};
use lsfb_types::{Progress, Stamped};

use super::sensors::Sensors;
use super::{Choice, InputReport, Run, expect_no_topics};
use crate::commands::about;
use crate::context::Context;

/// Runs the odometry on the clouds of a folder.
pub(super) fn run(
    choice: &Choice,
    config: &OdometryConfig,
    context: &Context,
) -> anyhow::Result<Run> {
    expect_no_topics(choice)?;
    let clouds = CloudFolder::open(choice.path, choice.rate_hz)?;
    let mut run = Sensors::lidar_alone(choice)?.start(choice, config)?;
    for scan in clouds.scans() {
        context.show(Progress {
            stage: "lidar odometry",
            done: run.taken(),
            total: clouds.len() as u64,
        })?;
        let scan = scan?;
        run.push(TimedScan {
            scan: Stamped {
                time: scan.time,
                arrival: scan.time,
                device_ticks: 0,
                sample: scan.cloud.scan,
            },
            times: scan.cloud.times,
        })?;
    }
    let mut warnings = Vec::new();
    let scan_times = match clouds.scan_times() {
        ScanTimes::Points => "points".to_owned(),
        ScanTimes::Names => "file names".to_owned(),
        ScanTimes::List => "list beside the files".to_owned(),
        ScanTimes::Rate => {
            let rate = format!("{} scans per second (--rate-hz)", choice.rate_hz);
            warnings.push(format!(
                "the times of the scans are unknown: {rate} are assumed"
            ));
            rate
        }
    };
    Ok(Run {
        result: about(choice.path, run.finish())?,
        input: InputReport {
            scan_times,
            warnings,
            ..InputReport::default()
        },
    })
}
