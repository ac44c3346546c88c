//! `lsfb eval`: a trajectory and its truth → errors.

use std::path::PathBuf;

use lsfb_eval::alignment::AlignmentMode;
use lsfb_eval::pairs::PairSelection;
use lsfb_eval::relation::DeltaUnit;
use lsfb_eval::report::Report;
use lsfb_eval::{EvalConfig, Evaluation, RpeConfig, evaluate, read_kitti_poses, read_poses};
use lsfb_geometry::Trajectory;

use crate::context::Context;
use crate::outcome::Outcome;

/// Evaluate a trajectory against ground truth: absolute and relative errors.
///
/// Reads TUM, EuRoC and KITTI files. KITTI files have no time: row n is at n seconds unless --truth-times is given.
///
/// Examples:
///   lsfb eval walk.tum --truth truth_walk.tum
///   lsfb eval walk.tum --truth truth_walk.tum --out report.html
///   lsfb eval orb.tum --truth gt.tum --align sim3 --rpe-delta 100 --rpe-unit frames --json
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The trajectory to evaluate.
    #[arg(value_name = "TUM")]
    estimate: PathBuf,
    /// The ground truth.
    #[arg(long, value_name = "TUM")]
    truth: PathBuf,
    /// Stamps of a ground truth in KITTI's format, one per line, in seconds.
    #[arg(long, value_name = "FILE")]
    truth_times: Option<PathBuf>,
    /// How the estimate is aligned to the ground truth before errors are computed.
    #[arg(long, value_name = "MODE", value_enum, default_value_t = Align::Se3)]
    align: Align,
    /// Largest difference between the stamps of matched poses.
    #[arg(long, default_value_t = 0.01, value_name = "SECS")]
    max_difference_secs: f64,
    /// Distance between the two poses of a relative error, in the unit of --rpe-unit.
    #[arg(long, default_value_t = 1.0, value_name = "NUMBER")]
    rpe_delta: f64,
    /// Unit of --rpe-delta.
    #[arg(long, value_name = "UNIT", value_enum, default_value_t = RpeUnit::Metres)]
    rpe_unit: RpeUnit,
    /// Use all pairs of poses, not only consecutive ones.
    #[arg(long)]
    rpe_all_pairs: bool,
    /// Also write a page with plots and a 3D view.
    #[arg(long, value_name = "HTML")]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Align {
    None,
    Se3,
    Sim3,
    Origin,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum RpeUnit {
    Frames,
    Metres,
    Seconds,
    Degrees,
}

/// Evaluates, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config = EvalConfig {
        max_difference_secs: arguments.max_difference_secs,
        alignment: match arguments.align {
            Align::None => AlignmentMode::None,
            Align::Se3 => AlignmentMode::Se3,
            Align::Sim3 => AlignmentMode::Sim3,
            Align::Origin => AlignmentMode::Origin,
        },
        rpe: vec![RpeConfig {
            delta: arguments.rpe_delta,
            unit: match arguments.rpe_unit {
                RpeUnit::Frames => DeltaUnit::Frames,
                RpeUnit::Metres => DeltaUnit::Metres,
                RpeUnit::Seconds => DeltaUnit::Seconds,
                RpeUnit::Degrees => DeltaUnit::Degrees,
            },
            selection: if arguments.rpe_all_pairs {
                PairSelection::All
            } else {
                PairSelection::Consecutive
            },
        }],
        ..EvalConfig::default()
    };
    if let Some(page) = &arguments.out {
        context.claim(page)?;
    }
    let truth = match &arguments.truth_times {
        Some(times) => read_kitti_poses(&arguments.truth, times)?,
        None => read_poses(&arguments.truth)?,
    };
    let evaluation = super::about(
        &arguments.estimate,
        evaluate(&truth, &read_poses(&arguments.estimate)?, &config),
    )?;
    if let Some(page) = &arguments.out {
        let name = arguments
            .estimate
            .file_name()
            .unwrap_or_default()
            .to_string_lossy();
        Report::of_evaluation(&name, &evaluation, &Trajectory::new(truth)).write(page)?;
    }
    context.print(&evaluation, || text(&evaluation))?;
    Ok(Outcome::Done)
}

fn text(e: &Evaluation) -> String {
    let mut out = format!(
        "{} of {} poses matched, {:.1} % of the ground truth covered, aligned by {}\n\
         ATE  rmse {:.6} m  mean {:.6}  median {:.6}  max {:.6};  rotation rmse {:.4}°",
        e.matched_poses,
        e.estimate_poses,
        e.coverage.fraction * 100.0,
        e.alignment,
        e.ate_translation_m.rmse,
        e.ate_translation_m.mean,
        e.ate_translation_m.median,
        e.ate_translation_m.max,
        e.ate_rotation_deg.rmse,
    );
    for rpe in &e.rpe {
        out += &format!(
            "\nRPE  per {} {:?}: rmse {:.6} m  max {:.6};  rotation rmse {:.6}°",
            rpe.delta,
            rpe.delta_unit,
            rpe.translation_m.rmse,
            rpe.translation_m.max,
            rpe.rotation_deg.rmse
        );
    }
    if let Some(scale) = e.scale_error_percent {
        out += &format!("\nscale {scale:+.3} %");
    }
    out
}
