//! `lsfb align --imu`: motion capture beside an IMU on one body → the IMU's path, and how both sit and run.

use std::path::Path;

use lsfb_calib::camera_imu::read_imu_table;
use lsfb_eval::hand_eye::{ClockModel, MocapAlignment, MocapConfig, align_mocap};
use lsfb_types::{Finding, ImuSample, Judgement, Stamped, Timestamp, Verdict};

use super::super::inertial::inertial_samples;
use super::{Aligned, Arguments, finish, pose_text, read};
use crate::context::Context;
use crate::files::name_of;
use crate::outcome::Outcome;

/// An MCAP file begins so.
const MCAP: &str = "mcap";

/// Aligns the motion capture to the IMU, writes, prints.
pub(super) fn run(imu: &Path, arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let reference = read(&arguments.reference)?;
    let mut findings = reference.findings;
    let samples = samples(imu, context, &mut findings)?;
    let mut config = MocapConfig {
        offset_guess_secs: arguments.offset_secs,
        search_secs: arguments.search_secs,
        clock: match arguments.drift {
            true => ClockModel::Drifting,
            false => ClockModel::Constant,
        },
        ..MocapConfig::default()
    };
    if imu.extension().is_some_and(|e| e == MCAP)
        && let Ok(rig) = context.open(imu)?.rig()
        && let Some(imu) = rig.imu()
    {
        config.noise = imu.noise.clone();
    }
    let found = crate::commands::about(imu, align_mocap(&reference.poses, &samples, &config))?;
    findings.extend(found.findings.iter().cloned());
    finish(
        &Aligned {
            name: name_of(imu),
            judgement: Judgement::new(findings),
            found: &found,
            text: text(&found),
        },
        || found.path.clone(),
        arguments,
        context,
    )
}

/// In order of time.
fn samples(
    path: &Path,
    context: &Context,
    findings: &mut Vec<Finding>,
) -> anyhow::Result<Vec<Stamped<ImuSample>>> {
    let mut samples: Vec<Stamped<ImuSample>> = match path.extension().is_some_and(|e| e == MCAP) {
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
        let what = "inertial samples go back in time; they were sorted";
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

fn text(found: &MocapAlignment) -> String {
    let [least, most] = found.offset_range_secs;
    let vector = |v: [f64; 3]| format!("{:.4} {:.4} {:.4}", v[0], v[1], v[2]);
    pose_text("IMU on the markers' body", &found.markers_from_imu)
        + &format!(
            "offset of the clocks: {:+.6} s (σ {:.3} ms), between {least:+.6} and {most:+.6} s, drift {:.2} ppm\n\
             gyroscope bias {} rad/s, accelerometer bias {} m/s², gravity {} m/s²\n\
             left over: {:.4} m rms, {:.3}° rms; {} of {} poses do not fit\n\
             path: {} poses, {:.1} % of the time\n",
            found.offset_secs,
            1000.0 * found.sigma_offset_secs,
            1e6 * found.drift,
            vector(found.gyro_bias_rad_s),
            vector(found.accel_bias_m_s2),
            vector(found.gravity_m_s2),
            found.translation_m.rmse,
            found.rotation_deg.rmse,
            found.outliers,
            found.poses,
            found.path.len(),
            100.0 * found.given
        )
}
