//! Inertial samples of a recording, for commands that judge by them.

use std::path::Path;

use lsfb_types::{Finding, ImuSample, Stamped, Verdict};

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
        let what = format!("{damaged} inertial samples cannot be read and were left out");
        let found = Finding::new("damaged", Verdict::Warn, name_of(path), what);
        findings.push(found.remedy("look at the recording with lsfb doctor --full"));
    }
    Ok(samples)
}
