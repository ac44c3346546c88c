//! Inertial samples of a recording, for commands that judge by them.

use std::path::Path;

use lsfb_calib::camera_imu::read_imu_table;
use lsfb_types::{Finding, ImuSample, Stamped, Timestamp, Verdict};

use crate::context::Context;
use crate::files::{about, name_of};

/// Samples of the recording's IMU in the order in which they stand. Those that cannot be read are counted and warned of: data is lost
/// then.
pub(super) fn inertial_samples(
    path: &Path,
    context: &Context,
    findings: &mut Vec<Finding>,
) -> anyhow::Result<Vec<Stamped<ImuSample>>> {
    let recording = context.open(path)?;
    let (mut samples, mut damaged) = (Vec::new(), 0_u64);
    for sample in about(path, recording.imu())? {
        match sample {
            Ok(sample) => samples.push(sample),
            Err(_) => damaged += 1,
        }
    }
    if damaged > 0 {
        context.lose_data();
        let what = format!("{damaged} IMU samples cannot be read and were left out");
        let found = Finding::new("damaged", Verdict::Warn, name_of(path), what);
        findings.push(found.remedy("check the recording with lsfb doctor --full"));
    }
    Ok(samples)
}

/// Whether a file is called as recordings are; others are tables.
pub(super) fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "mcap")
}

/// Inertial samples of a recording or of a csv as EuRoC has it, in order of time.
pub(super) fn ordered_samples(
    path: &Path,
    context: &Context,
    findings: &mut Vec<Finding>,
) -> anyhow::Result<Vec<Stamped<ImuSample>>> {
    let mut samples: Vec<Stamped<ImuSample>> = match is_recording(path) {
        true => inertial_samples(path, context, findings)?,
        false => read_imu_table(path)?
            .into_iter()
            .map(|(time, sample): (Timestamp, ImuSample)| Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample,
            })
            .collect(),
    };
    if samples.windows(2).any(|w| w[1].time < w[0].time) {
        let what = "IMU samples go back in time; they were sorted";
        findings.push(Finding::new(
            "unsorted-stamps",
            Verdict::Warn,
            name_of(path),
            what,
        ));
        samples.sort_by_key(|s| s.time);
    }
    Ok(samples)
}
