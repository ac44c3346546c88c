//! `lsfb align --imu --reference-imu`: two gyroscopes on one body → the offset of their clocks.

use std::path::Path;

use lsfb_eval::hand_eye::{GyroAlignment, GyroSample, HandEyeConfig, align_gyroscopes};
use lsfb_types::{Finding, Judgement};

use super::super::inertial::ordered_samples;
use crate::context::Context;
use crate::files::name_of;
use crate::judged::{Judged, lines};
use crate::outcome::Outcome;

/// Aligns the gyroscopes, prints.
pub(super) fn run(
    imu: &Path,
    reference: &Path,
    config: &HandEyeConfig,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let mut findings = Vec::new();
    let first = rates(imu, context, &mut findings)?;
    let second = rates(reference, context, &mut findings)?;
    let found = align_gyroscopes(&first, &second, config, &|p| context.show(p));
    let found = crate::commands::about(imu, found)?;
    findings.extend(found.findings.iter().cloned());
    let judgement = Judgement::new(findings);
    let name = name_of(imu);
    let judged = Judged::new(&judgement, &name, &found);
    context.print(&judged, || {
        format!("{}\n{}", text(&found), lines(&judgement))
            .trim_end()
            .to_owned()
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

fn rates(
    path: &Path,
    context: &Context,
    findings: &mut Vec<Finding>,
) -> anyhow::Result<Vec<GyroSample>> {
    let samples = ordered_samples(path, context, findings)?;
    let rate = |s: &lsfb_types::Stamped<lsfb_types::ImuSample>| GyroSample {
        time: s.time,
        rate_rad_s: s.sample.angular_velocity_rad_s.into(),
    };
    Ok(samples.iter().map(rate).collect())
}

fn text(found: &GyroAlignment) -> String {
    let [qx, qy, qz, qw] = found.rotation_xyzw;
    let [x, y, z] = found.bias_rad_s;
    let apart = found.halves_apart_secs.map_or(String::new(), |apart| {
        format!(
            ", {:+.3} ms from the first half to the second",
            1000.0 * apart
        )
    });
    format!(
        "clock offset: {:+.6} s (σ {:.3} ms){apart}; correlation of angular rates {:.3}\nreference \
         gyroscope from the other: rotation x y z w {qx:.6} {qy:.6} {qz:.6} {qw:.6}, bias difference \
         {x:.4} {y:.4} {z:.4} rad/s\nresidual: {:.4} rad/s rms\n",
        found.offset_secs,
        1000.0 * found.sigma_offset_secs,
        found.correlation,
        found.rms_rad_s
    )
}
