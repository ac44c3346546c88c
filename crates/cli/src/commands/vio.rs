//! `lsfb vio`: a walk without a map → trajectory.

use std::path::{Path, PathBuf};

use lsfb_datasets::import::{ImportConfig, import};
use lsfb_geometry::Rig;
use lsfb_pipeline::ground_truth::{
    Beginning, MotionConfig, MotionReport, RecordedMotion, motion_of_recording_in_stages,
};
use lsfb_recording::{Provenance, write_tum};
use lsfb_types::{Judgement, Verdict};

use super::covariance_file;
use crate::context::Context;
use crate::files;
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;
use crate::standing;

/// Compute the motion of a walk from its images and IMU alone, without a map.
///
/// Tracks features in one or several cameras, initializes gravity, velocity and scale at rest or in
/// motion, and adjusts the whole walk at once. Poses are those of the IMU, ten per second, in a
/// gravity-aligned world that begins at the first one. Revisited places are recognized and the drift in
/// between is corrected (finding revisits); without revisits the drift grows with the distance. Places
/// that look alike are told apart by the largest possible drift.
///
/// The walk is a recording, or anything that `lsfb import` reads, such as EuRoC or TUM-VI; not a ROS
/// bag. The rig, from the recording or --rig, must hold the cameras' poses on the IMU and its noise.
/// Written beside WALK.tum: WALK_covariance.txt, poses with covariance relative to the first, for `lsfb
/// eval --align origin`.
///
/// Exit code 3: stretches where too little can be tracked (darkness, a covered lens) have no poses.
/// Exit code 4: a camera certainly differs from the rig (camera-off), which bends the trajectory.
/// Images and IMU that do not belong together are refused. An interrupted run resumes after tracking,
/// from WALK.tum.unfinished.
///
/// Examples:
///   lsfb vio walk.mcap --out walk.tum
///   lsfb vio walk.mcap --camera cam0 --out mono.tum --json
///   lsfb vio MH_01_easy/mav0 --out mh01.tum
///   lsfb vio dataset-room1_512_16 --rig rig.toml --out room1.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Walk: a recording, or anything that `lsfb import` reads.
    #[arg(value_name = "MCAP|FOLDER")]
    walk: PathBuf,
    /// Trajectory to write.
    #[arg(long, value_name = "TUM")]
    out: PathBuf,
    /// Cameras to use, separated by commas or once for each; by default all cameras of the rig.
    #[arg(long = "camera", value_name = "NAME", value_delimiter = ',')]
    cameras: Vec<String>,
    /// Rig of the device, instead of the recording's own.
    #[arg(long, value_name = "TOML")]
    rig: Option<PathBuf>,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

/// What the file of covariances says of itself.
const WHAT_IS_IN_IT: &str = "Relative to the first pose, which is taken as exact. Included: errors \
     of images, of the IMU, and of the cameras as far as the rig file may\nbe wrong. Not included: \
     features tracked wrongly throughout.";

/// A recording made of another program's, for as long as it is read.
struct Imported(PathBuf);

impl Imported {
    fn new(arguments: &Arguments, context: &Context) -> anyhow::Result<Self> {
        let place = arguments.out.with_extension("imported.mcap");
        context.claim(&place, &[&arguments.walk])?;
        let config = ImportConfig {
            rig: arguments.rig.as_deref().map(Rig::read).transpose()?,
            ..ImportConfig::default()
        };
        let report = import(&arguments.walk, &place, &config, &|p| context.show(p))?;
        let imported = Self(place);
        for trajectory in &report.trajectories {
            // They are others' results, and still stand in the source.
            std::fs::remove_file(trajectory)?;
        }
        if report.unreadable() > 0 {
            context.lose_data();
            let count = report.unreadable();
            context.say(&format!(
                "warning: {}: {count} records cannot be read; `lsfb import` lists them",
                arguments.walk.display()
            ));
        }
        Ok(imported)
    }
}

impl Drop for Imported {
    fn drop(&mut self) {
        // It may be gone already; there is nobody to tell.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Follows, solves, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: MotionConfig = super::config_or_default(arguments.config.as_deref())?;
    files::expect_file(&arguments.walk, "record one with `lsfb scan`")?;
    let is_recording = arguments.walk.extension().is_some_and(|e| e == "mcap");
    let imported = match is_recording {
        true => None,
        false => Some(Imported::new(arguments, context)?),
    };
    let place = imported.as_ref().map_or(&arguments.walk, |i| &i.0);
    let recording = context.open(place)?;
    let mut provenance = Provenance::new(&config);
    // Of a folder the recording that was made of it: it holds all that was read.
    provenance.add_input(place)?;
    if let Some(codebook) = &config.revisits.codebook {
        provenance.add_input(codebook)?;
    }
    anyhow::ensure!(
        imported.is_none() || recording.rig().is_ok(),
        "{}: the camera poses on the IMU are unknown; give the rig with --rig",
        arguments.walk.display()
    );
    let rig = super::about(
        place,
        super::rig_for(&recording, arguments.rig.as_deref(), &mut provenance),
    )?;
    let rig = super::with_cameras(rig, &arguments.cameras)?;
    provenance.add_rig(&rig);
    let covariances = files::beside(&arguments.out, "covariance");
    let report = match context.standing(&[&arguments.out], &provenance) {
        Some(report) => report,
        None => {
            let mut read: Vec<&Path> = vec![&arguments.walk];
            read.extend(arguments.rig.as_deref());
            context.claim(&arguments.out, &read)?;
            context.claim(&covariances, &read)?;
            let stages = context.kept_stages(&arguments.out, &provenance)?;
            let show = |p| context.show(p);
            let found = motion_of_recording_in_stages(&recording, &rig, &config, &stages, &show);
            let found = super::about(&arguments.walk, stages.kept_if_stopped(found))?;
            write(arguments, &covariances, &found, &provenance)?;
            stages.remove()?;
            found.report
        }
    };
    print(arguments, &report, context)
}

fn write(
    arguments: &Arguments,
    covariances: &Path,
    found: &RecordedMotion,
    provenance: &Provenance,
) -> anyhow::Result<()> {
    standing::forget(&[&arguments.out])?;
    write_tum(&arguments.out, &found.trajectory)?;
    let poses = found.trajectory.poses().iter().zip(&found.covariances);
    files::write(covariances, covariance_file::text(WHAT_IS_IN_IT, poses))?;
    provenance.write(&arguments.out)?;
    let beside = [covariances.to_owned()];
    standing::finish(&[&arguments.out], &beside, provenance, &found.report)
}

fn print(
    arguments: &Arguments,
    report: &MotionReport,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let judgement = Judgement::new(report.findings());
    context.print(&Judged::new(&judgement, "the motion", report), || {
        let begun = match report.beginning {
            Beginning::Given => "from given states",
            Beginning::Standing => "at rest",
            Beginning::Moving => "in motion",
        };
        format!(
            "{}: {} poses, initialized {begun}, path {:.2} m, {} points, reprojection {:.3} px rms\n{}",
            arguments.out.display(),
            report.poses,
            report.path_length_m,
            report.points,
            report.errors.rms_px,
            problem_lines(&judgement)
        )
    })?;
    Ok(match (judgement.verdict(), report.is_whole()) {
        (Verdict::Fail, _) => Outcome::JudgementFailed,
        (_, false) => Outcome::DataLost,
        _ => Outcome::Done,
    })
}
