//! What the LiDAR of a recording saw, at the poses of a trajectory: read once for `lsfb map depth` and `lsfb map view`.

use std::path::Path;

use lsfb_geometry::Trajectory;
use lsfb_pipeline::odometry::scan_count;
use lsfb_pipeline::surface::{SurfaceBuilder, SurfaceConfig};
use lsfb_recording::{Provenance, Recording, provenance_path};
use lsfb_types::{Finding, Limit, Progress, Verdict};

use crate::context::Context;
use crate::refused::Refused;

/// Inserts all scans that the trajectory reaches, and counts them.
pub fn insert_scans(
    path: &Path,
    recording: &Recording,
    world_from_rig: &Trajectory,
    config: &SurfaceConfig,
    context: &Context,
) -> anyhow::Result<(SurfaceBuilder, u64)> {
    let rig = recording.rig()?;
    let mut builder = SurfaceBuilder::new(&rig, config).ok_or_else(|| {
        anyhow::anyhow!(
            "{}: its rig has no LiDAR, so that there is no surface",
            path.display()
        )
    })?;
    let total = scan_count(recording);
    let mut inserted = 0;
    for (done, scan) in (0..).zip(recording.scans()?) {
        context.show(Progress {
            stage: "surface",
            done,
            total,
        })?;
        match scan {
            Ok(scan) => inserted += u64::from(builder.insert(&scan, world_from_rig)),
            Err(damage) => {
                context.say(&format!("warning: {}: {damage}", path.display()));
                context.lose_data();
            }
        }
    }
    if inserted == 0 {
        let subject = path.display().to_string();
        let what = "no scan lies within the trajectory";
        let outside = Finding::new("start-elsewhere", Verdict::Fail, subject, what)
            .value(0.0, "")
            .limit(Limit::AtLeast(1.0))
            .remedy("give the one that `lsfb map --out-trajectory` wrote for this recording");
        return Err(Refused(outside).into());
    }
    Ok((builder, inserted))
}

/// Refuses a trajectory, or clouds, that say themselves, by the provenance beside them, that they are of another recording, or that they are wrong.
pub fn check_source(trajectory: &Path, recording: &Path) -> anyhow::Result<()> {
    let Some(of_trajectory) = Provenance::beside(trajectory) else {
        return Ok(());
    };
    let mut own = Provenance::new(&());
    own.add_input(recording)?;
    let is_own = |hash: &String| own.inputs.values().any(|h| h == hash);
    let sources = &of_trajectory.inputs;
    anyhow::ensure!(
        sources.is_empty() || sources.values().any(is_own),
        "{} was made from {}, not from {}: according to its provenance ({}); give the recording that it belongs to",
        trajectory.display(),
        sources.keys().cloned().collect::<Vec<_>>().join(" and "),
        recording.display(),
        provenance_path(trajectory).display()
    );
    expect_sound(trajectory)
}

/// Refuses a trajectory, or clouds, with which something was found wrong when they were made, as the provenance beside them says.
pub fn expect_sound(trajectory: &Path) -> anyhow::Result<()> {
    let failures = Provenance::beside(trajectory).map_or_else(Vec::new, |p| p.failures);
    if failures.is_empty() {
        return Ok(());
    }
    let what = format!(
        "failed its checks when it was made ({}), and everything made from it would be wrong too",
        failures.join("; ")
    );
    let subject = trajectory.display().to_string();
    let refused = Finding::new("failed-trajectory", Verdict::Fail, subject, what)
        .remedy("fix that, and make it again");
    Err(Refused(refused).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trajectory_of_another_recording_is_refused_by_its_provenance() {
        let folder = tempfile::tempdir().expect("folder");
        let at = |name: &str| folder.path().join(name);
        for name in ["a.mcap", "b.mcap"] {
            std::fs::write(at(name), name).expect("a file");
        }
        let trajectory = at("a.tum");
        check_source(&trajectory, &at("b.mcap")).expect("nothing says of what it is");
        let mut provenance = Provenance::new(&());
        provenance.add_input(&at("a.mcap")).expect("a hash");
        provenance.write(&trajectory).expect("a file");
        check_source(&trajectory, &at("a.mcap")).expect("its own");
        // The same bytes under another name are the same recording.
        std::fs::copy(at("a.mcap"), at("copy.mcap")).expect("a copy");
        check_source(&trajectory, &at("copy.mcap")).expect("its own");
        let error = check_source(&trajectory, &at("b.mcap")).expect_err("another's");
        let said = error.to_string();
        assert!(said.contains("made from a.mcap, not from"), "{said}");
        // And one that failed is used for nothing.
        let failed = provenance.with_failures(vec!["IMU: its axes are exchanged".to_owned()]);
        failed.write(&trajectory).expect("a file");
        let error = check_source(&trajectory, &at("a.mcap")).expect_err("failed");
        assert!(error.to_string().contains("axes are exchanged"), "{error}");
        // Where it is not asked of which recording it is, too.
        let error = expect_sound(&trajectory).expect_err("failed").to_string();
        assert!(error.contains("axes are exchanged"), "{error}");
    }
}
