//! `lsfb eval`: a trajectory and its truth → errors.

use std::path::PathBuf;

use lsfb_eval::alignment::AlignmentMode;
use lsfb_eval::pairs::PairSelection;
use lsfb_eval::relation::DeltaUnit;
use lsfb_eval::report::Report;
use lsfb_eval::{
    Columns, EvalConfig, Evaluation, ReadOptions, RpeConfig, evaluate_files, read_trajectory,
};
use lsfb_geometry::Trajectory;
use lsfb_recording::Provenance;
use lsfb_types::{Judgement, StampUnit};

use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::judged::{Judged, printable, problem_lines};
use crate::one_of::one_of;
use crate::outcome::Outcome;
use crate::pages;

/// Evaluate a trajectory against ground truth: absolute and relative errors, recall, smoothness.
///
/// Reads the trajectories of any program: TUM text, positions (t x y z), EuRoC csv, KITTI poses, any
/// table with column names, kapture, COLMAP models, and poses in MCAP recordings. Unsorted stamps are
/// sorted, repeated ones counted; they may be in any unit. KITTI files have no stamps: row n is at n
/// seconds unless --estimate-times and --truth-times are given.
///
/// Relative errors per distance and angle use the pairs of evo (pairs_from_delta): each pair ends at
/// the first pose that is at least --rpe-delta away, so that pairs are longer where poses are sparse or
/// missing (with a warning). Pairs per second may be up to a fifth longer; pairs across gaps are left
/// out and counted. --rpe-all-pairs uses only pairs within a tenth of the delta.
///
/// Examples:
///   lsfb eval walk.tum --truth truth_walk.tum
///   lsfb eval walk.tum --truth truth_walk.tum --out report.html
///   lsfb eval orb.tum --truth gt.tum --align sim3 --rpe-delta 100 --rpe-unit frames --json
///   lsfb eval robot.mcap --estimate-stream /odometry --truth state_groundtruth_estimate0/data.csv --align yaw
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trajectory to evaluate.
    #[arg(value_name = "TRAJECTORY")]
    estimate: PathBuf,
    /// Ground truth.
    #[arg(long, value_name = "TRAJECTORY")]
    truth: PathBuf,
    /// Stamps of an estimate in KITTI's format, one per line.
    #[arg(long, value_name = "FILE")]
    estimate_times: Option<PathBuf>,
    /// Stamps of a ground truth in KITTI's format, one per line.
    #[arg(long, value_name = "FILE")]
    truth_times: Option<PathBuf>,
    /// How the estimate is aligned to the ground truth before errors are computed; yaw rotates about the
    /// vertical z axis only.
    #[arg(long, value_name = "MODE", default_value = AlignmentMode::Se3.key(), value_parser = one_of(&AlignmentMode::NAMED, AlignmentMode::key))]
    align: AlignmentMode,
    /// Largest difference between the stamps of matched poses.
    #[arg(long, default_value_t = 0.01, value_name = "SECS")]
    max_difference_secs: f64,
    /// Distance between the two poses of a relative error, in the unit of --rpe-unit; by default both 1 m
    /// and 1 s.
    #[arg(long, value_name = "NUMBER")]
    rpe_delta: Option<f64>,
    /// Unit of --rpe-delta.
    #[arg(long, value_name = "UNIT", default_value = DeltaUnit::Metres.key(), value_parser = one_of(&DeltaUnit::ALL, DeltaUnit::key))]
    rpe_unit: DeltaUnit,
    /// Use all pairs of poses, not only consecutive ones.
    #[arg(long)]
    rpe_all_pairs: bool,
    /// Also write a page with plots and a 3D view.
    #[arg(long, value_name = "HTML")]
    out: Option<PathBuf>,
    /// Unit of the estimate's stamps, if the file does not tell: s, ms, us or ns.
    #[arg(long, value_name = "UNIT")]
    estimate_stamp_unit: Option<StampUnit>,
    /// Unit of the ground truth's stamps: s, ms, us or ns.
    #[arg(long, value_name = "UNIT")]
    truth_stamp_unit: Option<StampUnit>,
    /// Columns of the estimate, if the file does not name them, as t,x,y,z,qw,qx,qy,qz; - for any other.
    #[arg(long, value_name = "NAMES")]
    estimate_columns: Option<Columns>,
    /// Columns of the ground truth, as for --estimate-columns.
    #[arg(long, value_name = "NAMES")]
    truth_columns: Option<Columns>,
    /// Topic of a recording (for transforms with the frames: /tf:odom.rig), or device of a kapture file,
    /// with the estimate.
    #[arg(long, value_name = "NAME")]
    estimate_stream: Option<String>,
    /// Topic or device with the ground truth.
    #[arg(long, value_name = "NAME")]
    truth_stream: Option<String>,
}

/// Evaluates, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config = config(arguments);
    BadArgument::check(config.check_bounds(""), &[])?;
    if let Some(page) = &arguments.out {
        context.claim(page, &[&arguments.estimate, &arguments.truth])?;
    }
    let truth = read_trajectory(
        &arguments.truth,
        &ReadOptions {
            stamp_unit: arguments.truth_stamp_unit,
            columns: arguments.truth_columns,
            stream: arguments.truth_stream.clone(),
            times: arguments.truth_times.clone(),
        },
    )?;
    context.check_stop()?;
    let estimate = read_trajectory(
        &arguments.estimate,
        &ReadOptions {
            stamp_unit: arguments.estimate_stamp_unit,
            columns: arguments.estimate_columns,
            stream: arguments.estimate_stream.clone(),
            times: arguments.estimate_times.clone(),
        },
    )?;
    context.check_stop()?;
    let evaluation = super::about(
        &arguments.estimate,
        evaluate_files(&truth, &estimate, &config),
    )?;
    let name = arguments.estimate.file_name().unwrap_or_default();
    let name = printable(&name.to_string_lossy());
    context.check_stop()?;
    if let Some(page) = &arguments.out {
        let report = Report::of_evaluation(&name, &evaluation, &Trajectory::new(truth.poses));
        let made_from = made_from(arguments, &config)?;
        let provenance = pages::settings(&made_from);
        Report {
            provenance,
            ..report
        }
        .write(page)?;
    }
    let judgement = Judgement::new(evaluation.findings.clone());
    let judged = Judged::new(&judgement, &name, &evaluation);
    context.print(&judged, || {
        format!("{}\n{}", text(&evaluation), problem_lines(&judgement))
            .trim_end()
            .to_owned()
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

/// Settings and files of the page.
fn made_from(arguments: &Arguments, config: &EvalConfig) -> anyhow::Result<Provenance> {
    let rpe = |all: &[RpeConfig]| -> Vec<String> {
        let pairs = match arguments.rpe_all_pairs {
            true => "all pairs",
            false => "consecutive pairs",
        };
        let said = |one: &RpeConfig| format!("{} {}, {pairs}", one.delta, one.unit.key());
        all.iter().map(said).collect()
    };
    let unit = |unit: Option<StampUnit>| unit.map(|unit| unit.to_string());
    let columns = |columns: &Option<Columns>| columns.map(|columns| format!("{columns:?}"));
    let stamp_units = [arguments.estimate_stamp_unit, arguments.truth_stamp_unit].map(unit);
    let columns = [&arguments.estimate_columns, &arguments.truth_columns].map(columns);
    let mut made_from = Provenance::new(&serde_json::json!({
        "align": config.alignment.key(),
        "max_difference_secs": config.max_difference_secs,
        "rpe": rpe(&config.rpe),
        "rpe_where_possible": rpe(&config.rpe_where_possible),
        "stamp_units": stamp_units,
        "columns": columns,
        "streams": [&arguments.estimate_stream, &arguments.truth_stream],
    }));
    let times = [&arguments.estimate_times, &arguments.truth_times];
    let files = [&arguments.estimate, &arguments.truth];
    for path in files.into_iter().chain(times.into_iter().flatten()) {
        made_from.add_input(path)?;
    }
    Ok(made_from)
}

fn config(arguments: &Arguments) -> EvalConfig {
    let rpe = |delta, unit| RpeConfig {
        delta,
        unit,
        selection: match arguments.rpe_all_pairs {
            true => PairSelection::All,
            false => PairSelection::Consecutive,
        },
    };
    let unit = arguments.rpe_unit;
    let usual = [rpe(1.0, DeltaUnit::Metres), rpe(1.0, DeltaUnit::Seconds)];
    let (required, possible) = match (arguments.rpe_delta, unit) {
        (Some(delta), _) => (vec![rpe(delta, unit)], Vec::new()),
        (None, DeltaUnit::Metres) => (Vec::new(), usual.to_vec()),
        (None, _) => (vec![rpe(1.0, unit)], Vec::new()),
    };
    EvalConfig {
        max_difference_secs: arguments.max_difference_secs,
        alignment: arguments.align,
        rpe: required,
        rpe_where_possible: possible,
        ..EvalConfig::default()
    }
}

fn text(e: &Evaluation) -> String {
    let mut out = format!(
        "{} of {} poses matched, {:.1} % of the ground truth covered, aligned by {}\n\
         ATE  rmse {:.6} m  mean {:.6}  median {:.6}  max {:.6}",
        e.matched_poses,
        e.estimate_poses,
        e.coverage.fraction * 100.0,
        e.alignment,
        e.ate_translation_m.rmse,
        e.ate_translation_m.mean,
        e.ate_translation_m.median,
        e.ate_translation_m.max,
    );
    match e.ate_rotation_deg {
        Some(rotation) => out += &format!(";  rotation rmse {:.4}°", rotation.rmse),
        None => out += ";  positions only",
    }
    out += "\n     rmse by alignment:";
    for other in &e.ate_by_alignment {
        match other.rmse_m {
            Some(rmse_m) => out += &format!("  {} {rmse_m:.6} m", other.alignment),
            None => out += &format!("  {} –", other.alignment),
        }
    }
    for rpe in &e.rpe {
        let delta = format!("\nRPE  per {} {}:", rpe.delta, rpe.delta_unit);
        out += &match (rpe.translation_m, rpe.rotation_deg) {
            (Some(t), Some(r)) => format!(
                "{delta} rmse {:.6} m  max {:.6};  rotation rmse {:.6}°",
                t.rmse, t.max, r.rmse
            ),
            _ => format!(
                "{delta} distance rmse {:.6} m  max {:.6}",
                rpe.distance_m.rmse, rpe.distance_m.max
            ),
        };
        out += &format!(";  {} pairs", rpe.pairs);
    }
    if let (Some(signed), Some(absolute)) = (e.scale_error_percent, e.scale_error_abs_percent) {
        // Without a minus where it rounds to zero.
        let signed = if signed.abs() < 5e-4 { 0.0 } else { signed };
        out += &format!("\nscale {signed:+.3} %  |1 − s| {absolute:.3} %");
    }
    if let Some(success) = e.success {
        out += &format!(
            "\nmore than 30 matches: {} of {} frames ({:.1} %); {} localized",
            success.succeeded,
            success.frames,
            100.0 * success.rate(),
            success.localized
        );
    }
    for found in &e.recall {
        let threshold = found.threshold;
        out += &format!(
            "\nrecall within {}°, {} m: {:.1} % of the ground truth, {:.1} % of matched poses",
            threshold.rotation_deg,
            threshold.translation_m,
            100.0 * found.of_truth,
            100.0 * found.of_matched
        );
    }
    out + &shaking(e)
}

fn shaking(e: &Evaluation) -> String {
    let mut out = String::new();
    for (whose, of) in [
        ("estimate", e.smoothness.estimate),
        ("truth", e.smoothness.truth),
    ] {
        let Some(of) = of else { continue };
        out += &format!(
            "\nsmoothness of the {whose}: jerk rms {:.2} m/s³, second difference rms {:.3} mm",
            of.jerk_rms_m_s3,
            1000.0 * of.second_difference_rms_m
        );
        if let Some(fast_m) = of.above_5_hz_rms_m {
            out += &format!(", above 5 Hz rms {:.3} mm", 1000.0 * fast_m);
        }
    }
    if let Some(c) = e.consistency {
        out += &format!(
            "\nNEES mean {:.2} of 6, {:.1} % within 95 %",
            c.nees_mean,
            100.0 * c.within_95
        );
    }
    if !e.relocalizations.is_empty() {
        let longest = e.relocalizations.iter().map(|r| r.gap_secs);
        let worst = e.relocalizations.iter().filter_map(|r| r.error_change_m);
        out += &format!(
            "\nrelocalized {} after gaps of up to {:.2} s; the error grew by up to {:.3} m",
            match e.relocalizations.len() {
                1 => "once".to_owned(),
                n => format!("{n} times"),
            },
            longest.fold(0.0, f64::max),
            worst.fold(0.0, f64::max)
        );
    }
    out + &format!(
        "\nlongest gap {:.2} s, starts {:.2} s after the truth, ends {:.2} s before it",
        e.coverage.longest_gap_secs, e.coverage.initialisation_secs, e.coverage.missing_end_secs
    )
}
