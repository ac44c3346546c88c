//! `lsfb align --imu`: motion capture beside an IMU on one body → the IMU's path, and how both sit and run.

use std::path::Path;

use lsfb_eval::hand_eye::{HandEyeConfig, MocapAlignment, MocapConfig, align_mocap};
use lsfb_types::Judgement;

use super::super::inertial::{is_recording, ordered_samples};
use super::{Aligned, Arguments, finish, pose_text, read};
use crate::context::Context;
use crate::files::name_of;
use crate::outcome::Outcome;

/// Aligns the motion capture to the IMU, writes, prints.
pub(super) fn run(
    imu: &Path,
    reference: &Path,
    search: &HandEyeConfig,
    arguments: &Arguments,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let reference = read(reference)?;
    let mut findings = reference.findings;
    let samples = ordered_samples(imu, context, &mut findings)?;
    let mut config = MocapConfig {
        offset_guess_secs: search.offset_guess_secs,
        search_secs: search.search_secs,
        clock: search.clock,
        ..MocapConfig::default()
    };
    if is_recording(imu)
        && let Ok(rig) = context.open(imu)?.rig()
        && let Some(imu) = rig.imu()
    {
        config.noise = imu.noise.clone();
    }
    let show = |p| context.show(p);
    let found = align_mocap(&reference.poses, &samples, &config, &show);
    let found = crate::commands::about(imu, found)?;
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

fn text(found: &MocapAlignment) -> String {
    let [least, most] = found.offset_range_secs;
    let vector = |v: [f64; 3]| format!("{:.4} {:.4} {:.4}", v[0], v[1], v[2]);
    pose_text("IMU in the markers' body frame", &found.markers_from_imu)
        + &format!(
            "clock offset: {:+.6} s (σ {:.3} ms), between {least:+.6} and {most:+.6} s, drift {:.2} \
             ppm\ngyroscope bias {} rad/s, accelerometer bias {} m/s², gravity {} m/s²\nresidual: \
             {:.4} m rms, {:.3}° rms; {} of {} poses do not fit\npath: {} poses, {:.1} % of the \
             time\n",
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
