//! `lsfb odometry`: scans → trajectory.

use std::path::PathBuf;

use lsfb_capture::{CloudsConfig, ImportedClouds, import_clouds};
use lsfb_pipeline::odometry::{OdometryConfig, run_odometry};
use lsfb_recording::{Provenance, write_tum};

use crate::context::Context;
use crate::outcome::Outcome;

/// Run LiDAR(-inertial) odometry on a recording, or on a folder of PCD scans.
///
/// Scans that could not be registered have no pose; exit code 3 if the end of the recording was lost.
///
/// Examples:
///   lsfb odometry scan.mcap --out scan.tum
///   lsfb odometry kitti/velodyne_pcd --outdoor --out kitti.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recording (MCAP), or a folder of PCD files, which is first converted to a recording beside the result.
    #[arg(value_name = "MCAP|FOLDER")]
    input: PathBuf,
    /// The trajectory to write.
    #[arg(long, value_name = "TUM")]
    out: PathBuf,
    /// Use settings for streets: long ranges, coarse voxels.
    #[arg(long)]
    outdoor: bool,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML", conflicts_with = "outdoor")]
    config: Option<PathBuf>,
}

/// Runs the odometry, prints its report.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let show = |p| context.show(p);
    let config = match &arguments.config {
        Some(path) => super::read_config(path)?,
        None if arguments.outdoor => OdometryConfig::outdoor(),
        None => OdometryConfig::default(),
    };
    super::expect_file(&arguments.input, "record one with `lsfb scan`")?;
    context.claim(&arguments.out)?;
    let mut times: Option<ImportedClouds> = None;
    let input = if arguments.input.is_dir() {
        let scans = arguments.out.with_extension("scans.mcap");
        context.claim(&scans)?;
        let imported = import_clouds(&arguments.input, &CloudsConfig::default(), &scans, &show)?;
        times = Some(imported);
        scans
    } else {
        arguments.input.clone()
    };
    context.check_stop()?;
    let mut result = super::about(
        &input,
        run_odometry(&context.open(&input)?, &config, &|p| context.show(p)),
    )?;
    let notes = times.iter().map(about_times);
    result.report.warnings.splice(0..0, notes);
    write_tum(&arguments.out, &result.trajectory)?;
    let mut provenance = Provenance::new(&config);
    provenance.add_input(&input)?;
    provenance.write(&arguments.out)?;
    let r = &result.report;
    context.print(r, || {
        let mut text = format!(
            "{}: {} of {} scans registered, {:.2} m of path, {:.1} mm to the map's planes",
            arguments.out.display(),
            r.registered,
            r.scans,
            r.path_length_m,
            r.plane_rms_m * 1e3
        );
        for warning in &r.warnings {
            text += &format!("\n  {warning}");
        }
        text
    })?;
    Ok(match r.lost_at_end {
        0 => Outcome::Done,
        _ => Outcome::DataLost,
    })
}

/// Which times the points of a folder of clouds were given.
fn about_times(imported: &ImportedClouds) -> String {
    match (&imported.time_field, imported.timed) {
        (None, _) => "the clouds have no field of times".to_owned(),
        (Some(field), 0) => format!(
            "the field `{field}` was not used: in no unit are its numbers times within one scan"
        ),
        (Some(field), timed) => format!(
            "times of points from the field `{field}` in {timed} of {} clouds",
            imported.clouds
        ),
    }
}
