//! `lsfb align`: two trajectories of one body by two systems → both transforms and the offset of their clocks.

mod gyroscopes;
mod mocap;

use std::path::{Path, PathBuf};

use lsfb_eval::hand_eye::{ClockModel, HandEye, HandEyeConfig, UncertainPose, align_trajectories};
use lsfb_eval::{Error, Orientations, ReadOptions, TrajectoryFile, read_trajectory};
use lsfb_geometry::{StampedPose, Trajectory};
use lsfb_recording::write_tum;
use lsfb_types::Judgement;
use serde::Serialize;

use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::files::name_of;
use crate::judged::{Judged, lines};
use crate::outcome::Outcome;

/// Align two trajectories of one rigid body, for example GNSS/INS or motion capture with glasses.
///
/// Each may have its own world, body and clock. Estimates the pose of one body on the other, the
/// transform between the worlds, and the clock offset, with standard deviations; a motion that does not
/// determine them is refused (turn about two axes). --out writes the reference as ground truth of the
/// estimate's body, on the estimate's clock, for `lsfb eval`, without poses where it jumps (swapped
/// markers). Exit code 4, nothing written: fewer than half of the poses fit, or two halves of the walk
/// clearly differ (the mounting slipped, or a clock jumped).
///
/// Motion capture is better aligned with an IMU on the device (--imu): the path of the IMU is smoother
/// than the markers' jitter, and bridges short stretches of lost or swapped markers.
///
/// Without a network to synchronize them, two recordings with an IMU each (--reference-imu) are brought
/// to one clock by their gyroscopes: hold both devices together and turn them about two axes for half a
/// minute.
///
/// Examples:
///   lsfb align glasses.tum --reference mocap.csv --out truth.tum
///   lsfb align glasses.tum --reference novatel.tum --offset-secs 18 --drift --json
///   lsfb align --imu walk.mcap --reference mocap.csv --out truth.tum
///   lsfb align --imu phone.mcap --reference-imu scan.mcap --offset-secs 3600 --search-secs 60
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trajectory to align, of any program.
    #[arg(
        value_name = "TRAJECTORY",
        required_unless_present = "imu",
        conflicts_with = "imu"
    )]
    estimate: Option<PathBuf>,
    /// IMU data of the device instead of a trajectory: a recording, or a csv in EuRoC's format.
    #[arg(long, value_name = "MCAP|CSV")]
    imu: Option<PathBuf>,
    /// Reference trajectory, of any program.
    #[arg(
        long,
        value_name = "TRAJECTORY",
        required_unless_present = "reference_imu"
    )]
    reference: Option<PathBuf>,
    /// IMU data of another device on the same body instead: a recording, or a csv in EuRoC's format.
    #[arg(
        long,
        value_name = "MCAP|CSV",
        requires = "imu",
        conflicts_with_all = ["reference", "drift", "out"]
    )]
    reference_imu: Option<PathBuf>,
    /// Approximate offset to add to the estimate's stamps to get the reference's.
    #[arg(
        long,
        default_value_t = 0.0,
        value_name = "SECS",
        allow_negative_numbers = true
    )]
    offset_secs: f64,
    /// Search range of the offset around --offset-secs.
    #[arg(long, default_value_t = 10.0, value_name = "SECS")]
    search_secs: f64,
    /// Also estimate a constant drift of the offset.
    #[arg(long)]
    drift: bool,
    /// Also write the reference as ground truth of the estimate's body.
    #[arg(long, value_name = "TUM")]
    out: Option<PathBuf>,
}

/// Aligns, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config = HandEyeConfig {
        offset_guess_secs: arguments.offset_secs,
        search_secs: arguments.search_secs,
        clock: match arguments.drift {
            true => ClockModel::Drifting,
            false => ClockModel::Constant,
        },
    };
    let named = [("offset_guess_secs", "--offset-secs")];
    BadArgument::check(config.check_bounds(""), &named)?;
    let inputs = [arguments.estimate.as_ref(), arguments.imu.as_ref()];
    let Some(input) = inputs.into_iter().flatten().next() else {
        anyhow::bail!("give a trajectory, or IMU data with --imu");
    };
    if let Some(reference) = &arguments.reference_imu {
        return gyroscopes::run(input, reference, &config, context);
    }
    let Some(path) = &arguments.reference else {
        anyhow::bail!("give a trajectory with --reference, or IMU data with --reference-imu");
    };
    if let Some(out) = &arguments.out {
        context.claim(out, &[input, path])?;
    }
    if arguments.imu.is_some() {
        return mocap::run(input, path, &config, arguments, context);
    }
    let estimate = read(input)?;
    let reference = read(path)?;
    let show = |p| context.show(p);
    let found = align_trajectories(&estimate.poses, &reference.poses, &config, &show)?;
    let mut findings = [estimate.findings, reference.findings].concat();
    findings.extend(found.findings.iter().cloned());
    let truth = found.as_truth(&estimate.poses, &reference.poses);
    findings.extend(truth.finding());
    finish(
        &Aligned {
            name: name_of(input),
            judgement: Judgement::new(findings),
            found: &found,
            text: text(&found),
        },
        || truth.poses,
        arguments,
        context,
    )
}

/// An alignment of either kind.
struct Aligned<'a, T: Serialize> {
    /// What was aligned.
    name: String,
    judgement: Judgement,
    found: &'a T,
    /// What was found, for people.
    text: String,
}

/// Writes the `truth` unless the alignment failed, and prints.
fn finish<T: Serialize>(
    aligned: &Aligned<'_, T>,
    truth: impl FnOnce() -> Vec<StampedPose>,
    arguments: &Arguments,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let judgement = &aligned.judgement;
    let outcome = Outcome::of(judgement.verdict());
    context.check_stop()?;
    // What must not be used is not written.
    if let Some(out) = arguments.out.as_ref().filter(|_| outcome == Outcome::Done) {
        write_tum(out, &Trajectory::new(truth()))?;
    }
    let judged = Judged::new(judgement, &aligned.name, aligned.found);
    context.print(&judged, || {
        format!("{}\n{}", aligned.text, lines(judgement))
            .trim_end()
            .to_owned()
    })?;
    Ok(outcome)
}

fn read(path: &Path) -> anyhow::Result<TrajectoryFile> {
    let file = read_trajectory(path, &ReadOptions::default())?;
    match file.orientations {
        Orientations::Known => Ok(file),
        Orientations::Missing => super::about(
            path,
            Err(Error::NeedsOrientation {
                purpose: "alignments of two bodies",
            }),
        ),
    }
}

/// A pose with its uncertainty, a line.
fn pose_text(name: &str, pose: &UncertainPose) -> String {
    let [x, y, z] = pose.translation_m;
    let [qx, qy, qz, qw] = pose.rotation_xyzw;
    let worst = |values: [f64; 3]| values.into_iter().fold(0.0, f64::max);
    format!(
        "{name}: translation {x:.4} {y:.4} {z:.4} m (σ up to {:.1} mm), rotation x y z w {qx:.6} {qy:.6} {qz:.6} {qw:.6} (σ up to {:.3}°)\n",
        1000.0 * worst(pose.sigma_translation_m),
        worst(pose.sigma_rotation_deg)
    )
}

fn text(found: &HandEye) -> String {
    let [first, second, third] = found.excitation.turn_rms_deg;
    pose_text(
        "estimate's body in the reference's body frame",
        &found.reference_from_estimate_body,
    ) + &pose_text(
        "estimate's world in the reference's world",
        &found.reference_from_estimate_world,
    ) + &format!(
        "clock offset: {:+.6} s (σ {:.3} ms), drift {:.2} ppm; correlation of angular rates \
             {:.3}\nrotated by {first:.1}°, {second:.1}°, {third:.1}° rms about its three \
             axes\nresidual: {:.4} m rms, {:.3}° rms; {} of {} poses do not fit\n",
        found.offset_secs,
        1000.0 * found.sigma_offset_secs,
        1e6 * found.drift,
        found.correlation,
        found.translation_m.rmse,
        found.rotation_deg.rmse,
        found.outliers,
        found.poses
    )
}
