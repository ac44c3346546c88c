//! `lsfb convert`: a trajectory in the files of another program.

use std::path::PathBuf;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use lsfb_eval::{
    Columns, ReadOptions, TrajectoryFormat, Written, read_trajectory, write_trajectory,
};
use lsfb_types::{Finding, Judgement, StampUnit, Verdict};

use crate::context::Context;
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;

/// Convert a trajectory of any program: TUM, EuRoC, KITTI, csv, kapture, MCAP.
///
/// Reads the same formats as `lsfb eval`, and says what had to be sorted, guessed or left out. Numbers
/// and stamps are kept to the last digit and nanosecond; nothing is interpolated. Poses are of the body
/// in the world; kapture's inverse is read and written as such. KITTI rows have no stamps: they are
/// written to NAME_times.txt, and read from --times. EuRoC's velocities and biases are not written.
/// kapture is a folder; MCAP is a ROS 2 bag with PoseStamped (PoseWithCovarianceStamped if every pose
/// has a covariance).
///
/// Examples:
///   lsfb convert walk.tum --format kitti --out poses.txt            # and poses_times.txt
///   lsfb convert poses.txt --times poses_times.txt --format mcap --out walk.mcap
///   lsfb convert robot.mcap --stream /odometry --format tum --out robot.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trajectory: a file, or a folder of kapture, COLMAP or EuRoC.
    #[arg(value_name = "TRAJECTORY")]
    trajectory: PathBuf,
    /// Format of the result.
    #[arg(long, value_name = "FORMAT", value_parser = formats())]
    format: TrajectoryFormat,
    /// File, or for kapture the folder.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Stamps of a trajectory in KITTI's format, one per line.
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
    /// Unit of the stamps, if the file does not tell: s, ms, us or ns.
    #[arg(long, value_name = "UNIT")]
    stamp_unit: Option<StampUnit>,
    /// Columns of the file, if it does not name them, as t,x,y,z,qw,qx,qy,qz; - for any other.
    #[arg(long, value_name = "NAMES")]
    columns: Option<Columns>,
    /// Topic of a recording (for transforms with the frames: /tf:odom.rig), or device of a kapture file.
    #[arg(long, value_name = "NAME")]
    stream: Option<String>,
}

/// Names of the formats, as the help lists them.
fn formats() -> impl TypedValueParser<Value = TrajectoryFormat> {
    let named = TrajectoryFormat::NAMED;
    PossibleValuesParser::new(named.map(|(name, _)| name)).try_map(move |asked| {
        let found = named.into_iter().find(|(name, _)| *name == asked);
        found.map(|(_, format)| format).ok_or("no such format")
    })
}

/// Reads, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let format = arguments.format;
    let options = ReadOptions {
        stamp_unit: arguments.stamp_unit,
        columns: arguments.columns,
        stream: arguments.stream.clone(),
        times: arguments.times.clone(),
    };
    let trajectory = read_trajectory(&arguments.trajectory, &options)?;
    let times = arguments.times.iter().map(PathBuf::as_path);
    let read: Vec<_> = times.chain([arguments.trajectory.as_path()]).collect();
    for file in format.files(&arguments.out) {
        context.claim(&file, &read)?;
    }
    context.check_stop()?;
    let written = super::about(
        &arguments.trajectory,
        write_trajectory(&trajectory, format, &arguments.out),
    )?;
    let what = format!("{} poses with their stamps", written.poses);
    let findings = [Finding::new("written", Verdict::Pass, "poses", what)].into_iter();
    let findings = findings
        .chain(trajectory.findings)
        .chain(left_out(&written));
    let judgement = Judgement::new(findings.collect());
    let files: Vec<String> = written
        .files
        .iter()
        .map(|f| f.display().to_string())
        .collect();
    let files = files.join(" and ");
    let what = format!("{} poses to {files}", written.poses);
    context.print(&Judged::new(&judgement, &what, &written), || {
        format!("{what}\n{}", problem_lines(&judgement))
            .trim_end()
            .to_owned()
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

/// What the format has no place for.
fn left_out(written: &Written) -> Option<Finding> {
    let count = written.covariances_left_out;
    (count > 0).then(|| {
        let what = format!("the format cannot hold covariances: {count} were left out");
        Finding::new("covariance", Verdict::Warn, "covariance", what)
            .value(count as f64, "")
            .remedy("use mcap, or keep the original file")
    })
}
