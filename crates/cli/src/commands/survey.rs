//! `lsfb survey`: floor marks measured with a tape or a laser, and what is checked by them.

use std::path::{Path, PathBuf};

use lsfb_eval::survey::{
    DistanceReport, MarkReport, Rest, RestConfig, Survey, SurveySolution, SurveyView, check_marks,
    compare_distances, find_rests, inertial_rests, read_survey, solve_survey,
};
use lsfb_eval::{ReadOptions, read_trajectory};
use lsfb_geometry::StampedPose;
use lsfb_recording::Provenance;
use lsfb_report::Page;
use lsfb_types::{Bounds, Finding, Judgement, OutOfBounds, Verdict};
use serde::Serialize;

use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::files::name_of;
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;
use crate::pages;

/// Compute floor marks from measured distances, and check a trajectory or a map against them.
///
/// A survey is a text file with one statement per line, in metres: horizontal|vertical|distance A B
/// LENGTH, followed by σ if known; sigma distance|line σ; visit A B … (the order in which the device
/// rested on the marks); point A x y z (a point of a map).
///
/// Examples:
///   lsfb survey solve floor.survey
///   lsfb survey check floor.survey --trajectory walk.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    step: Step,
}

#[derive(clap::Subcommand)]
enum Step {
    Solve(SolveArguments),
    Check(CheckArguments),
}

/// Compute the marks by least squares, with the redundancy of each measurement, and name blunders.
///
/// Examples:
///   lsfb survey solve floor.survey
///   lsfb survey solve floor.survey --out floor.html
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
struct SolveArguments {
    /// The survey.
    #[arg(value_name = "SURVEY")]
    survey: PathBuf,
    /// Also draw the marks on a page.
    #[arg(long, value_name = "HTML")]
    out: Option<PathBuf>,
}

/// Check a trajectory at the marks on which the device rested, or distances between points of a map.
///
/// A rest further than --reach-m from its mark is not counted in the errors, and the check fails (exit
/// code 4). It also fails with fewer than half of the marks, or fewer than four: errors at the marks
/// that happen to fit prove nothing.
///
/// Examples:
///   lsfb survey check floor.survey --trajectory walk.tum
///   lsfb survey check floor.survey --trajectory walk.tum --recording walk.mcap --out floor.html
///   lsfb survey check hall.survey
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
struct CheckArguments {
    /// Survey; without --trajectory its points are checked against its distances.
    #[arg(value_name = "SURVEY")]
    survey: PathBuf,
    /// Trajectory of any program; its z axis must point up.
    #[arg(long, value_name = "TUM")]
    trajectory: Option<PathBuf>,
    /// Recording of that walk, to find the rests with its IMU instead of the poses alone.
    #[arg(long, value_name = "MCAP", requires = "trajectory")]
    recording: Option<PathBuf>,
    /// Largest spread of the positions during a rest.
    #[arg(long, default_value_t = 0.01, value_name = "M")]
    rest_spread_m: f64,
    /// Shortest rest.
    #[arg(long, default_value_t = 1.0, value_name = "SECS")]
    rest_secs: f64,
    /// Largest distance of a rest from its mark.
    #[arg(long, default_value_t = 0.3, value_name = "M")]
    reach_m: f64,
    /// Also draw marks, trajectory and errors on a page.
    #[arg(long, value_name = "HTML")]
    out: Option<PathBuf>,
}

/// Runs the step.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    match &arguments.step {
        Step::Solve(a) => run_solve(a, context),
        Step::Check(a) => run_check(a, context),
    }
}

fn run_solve(arguments: &SolveArguments, context: &Context) -> anyhow::Result<Outcome> {
    let survey = read_survey(&arguments.survey)?;
    let solution = solve_survey(&survey)?;
    let judgement = Judgement::new(solution.findings.clone());
    let view = SurveyView {
        solution: Some(&solution),
        ..SurveyView::default()
    };
    if let Some(out) = &arguments.out {
        let page = view.page(&name_of(&arguments.survey), &judgement);
        draw(
            out,
            page,
            Provenance::new(&()),
            &[&arguments.survey],
            context,
        )?;
    }
    let judged = Judged::new(&judgement, &name_of(&arguments.survey), &solution);
    context.print(&judged, || {
        format!(
            "{}{}{}",
            judgement.headline(&name_of(&arguments.survey)),
            solution_text(&solution),
            tail(&judgement)
        )
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

#[derive(Serialize)]
struct Checked {
    #[serde(skip_serializing_if = "Option::is_none")]
    at_marks: Option<MarkReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    distances: Option<DistanceReport>,
}

fn run_check(arguments: &CheckArguments, context: &Context) -> anyhow::Result<Outcome> {
    let config = RestConfig {
        spread_m: arguments.rest_spread_m,
        least_secs: arguments.rest_secs,
        ..RestConfig::default()
    };
    let reach_m = arguments.reach_m;
    let reach = match Bounds::POSITIVE.hold(reach_m) {
        true => Ok(()),
        false => Err(OutOfBounds::new("", "reach_m", &reach_m, &Bounds::POSITIVE)),
    };
    let named = [
        ("spread_m", "--rest-spread-m"),
        ("least_secs", "--rest-secs"),
    ];
    BadArgument::check(config.check_bounds("").and(reach), &named)?;
    let survey = read_survey(&arguments.survey)?;
    let mut findings = Vec::new();
    let mut solved = None;
    let at_marks = arguments.trajectory.as_ref().map(|path| {
        let file = read_trajectory(path, &ReadOptions::default())?;
        let solution = solve_survey(&survey)?;
        findings.extend(file.findings.iter().chain(&solution.findings).cloned());
        let recording = arguments.recording.as_deref();
        let rests = rests(&file.poses, &config, recording, context, &mut findings)?;
        let checked = check_marks(&survey, &solution, &file.poses, &rests, reach_m);
        solved = Some(solution);
        super::about(path, checked)
    });
    let checked = Checked {
        at_marks: at_marks.transpose()?,
        distances: distances(&survey, arguments)?,
    };
    findings.extend(checked.at_marks.iter().flat_map(MarkReport::findings));
    findings.extend(checked.distances.as_ref().map(DistanceReport::finding));
    let judgement = Judgement::new(findings);
    let view = SurveyView {
        solution: solved.as_ref(),
        at_marks: checked.at_marks.as_ref(),
        distances: checked.distances.as_ref(),
    };
    if let Some(out) = &arguments.out {
        let mut read: Vec<&Path> = vec![&arguments.survey];
        read.extend(arguments.trajectory.as_deref());
        read.extend(arguments.recording.as_deref());
        let made_from = Provenance::new(&serde_json::json!({
            "rest_spread_m": arguments.rest_spread_m,
            "rest_secs": arguments.rest_secs,
            "reach_m": reach_m,
        }));
        let page = view.page(&name_of(&arguments.survey), &judgement);
        draw(out, page, made_from, &read, context)?;
    }
    let judged = Judged::new(&judgement, &name_of(&arguments.survey), &checked);
    context.print(&judged, || {
        format!("{}{}", checked_text(&checked), tail(&judgement))
            .trim_start()
            .to_owned()
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

/// Writes the page, and on it what it was made of.
fn draw(
    out: &Path,
    page: Page,
    mut made_from: Provenance,
    read: &[&Path],
    context: &Context,
) -> anyhow::Result<()> {
    context.claim(out, read)?;
    context.check_stop()?;
    read.iter().try_for_each(|path| made_from.add_input(path))?;
    pages::write(out, page, &made_from)
}

fn rests(
    poses: &[StampedPose],
    config: &RestConfig,
    recording: Option<&Path>,
    context: &Context,
    findings: &mut Vec<Finding>,
) -> anyhow::Result<Vec<Rest>> {
    let Some(path) = recording else {
        let what =
            "rests are found by the poses alone: a trajectory that froze looks like a rest as well";
        findings.push(
            Finding::new("rests", Verdict::Unknown, "trajectory", what)
                .remedy("give the recording (--recording)"),
        );
        return Ok(find_rests(poses, config));
    };
    let mut samples = super::inertial::inertial_samples(path, context, findings)?;
    samples.sort_by_key(|s| s.time);
    let found = super::about(path, inertial_rests(poses, &samples, config))?;
    findings.extend(found.findings);
    Ok(found.rests)
}

/// An error where nothing else was asked for.
fn distances(
    survey: &Survey,
    arguments: &CheckArguments,
) -> anyhow::Result<Option<DistanceReport>> {
    match compare_distances(survey) {
        Ok(report) => Ok(Some(report)),
        Err(lsfb_eval::Error::NoMapDistance) if arguments.trajectory.is_some() => Ok(None),
        Err(error) => Err(error.into()),
    }
}

fn solution_text(solution: &SurveySolution) -> String {
    let mut out = format!(
        "\n\n{:<12} {:>10} {:>10} {:>8} {:>8}\n",
        "mark", "x (m)", "y (m)", "σx (mm)", "σy (mm)"
    );
    for mark in &solution.marks {
        out += &format!(
            "{:<12} {:>10.4} {:>10.4} {:>8.2} {:>8.2}\n",
            mark.name,
            mark.x_m,
            mark.y_m,
            1000.0 * mark.sigma_x_m,
            1000.0 * mark.sigma_y_m
        );
    }
    out += &format!(
        "\n{:<20} {:>12} {:>13} {:>10} {:>7} {:>15}\n",
        "measurement", "measured (m)", "residual (mm)", "redundancy", "w", "detectable (mm)"
    );
    for o in &solution.observations {
        let or_dash = |value: Option<f64>, digits: usize| {
            value.map_or("–".to_owned(), |v| format!("{v:.digits$}"))
        };
        out += &format!(
            "{:<20} {:>12} {:>13.2} {:>10.2} {:>7} {:>15}{}\n",
            o.what,
            or_dash(o.measured_m, 4),
            1000.0 * o.residual_m,
            o.redundancy,
            or_dash(o.w, 2),
            or_dash(o.smallest_blunder_m.map(|m| 1000.0 * m), 1),
            if o.left_out { "  left out" } else { "" }
        );
    }
    let rms = solution.rms;
    for (term, rms_m) in [
        ("distances", rms.distance_m),
        ("horizontal lines", rms.horizontal_m),
        ("vertical lines", rms.vertical_m),
    ] {
        if let Some(rms_m) = rms_m {
            out += &format!("rms of {term}: {:.2} mm\n", 1000.0 * rms_m);
        }
    }
    out
}

fn checked_text(checked: &Checked) -> String {
    let mut out = String::new();
    if let Some(report) = &checked.at_marks {
        out += &format!(
            "{:<12} {:>8} {:>8} {:>11} {:>24}\n",
            "mark", "at (s)", "for (s)", "error (cm)", "x y z (cm)"
        );
        for mark in &report.marks {
            let [x, y, z] = mark.error_m.map(|v| 100.0 * v);
            out += &format!(
                "{:<12} {:>8.1} {:>8.1} {:>11.2} {:>8.2}{:>8.2}{:>8.2}\n",
                mark.mark,
                mark.start_secs,
                mark.duration_secs,
                100.0 * mark.distance_m,
                x,
                y,
                z
            );
        }
        out += &format!(
            "ATE at {} marks: rmse {:.2} cm  max {:.2} cm; {} other rests\n",
            report.marks.len(),
            100.0 * report.ate_m.rmse,
            100.0 * report.ate_m.max,
            report.other_rests
        );
    }
    if let Some(report) = &checked.distances {
        out += &format!(
            "\n{:<20} {:>12} {:>10} {:>10}\n",
            "distance", "measured (m)", "map (m)", "error (cm)"
        );
        for d in &report.distances {
            let name = d.ends.join("–");
            out += &format!(
                "{name:<20} {:>12.4} {:>10.4} {:>10.2}\n",
                d.measured_m,
                d.map_m,
                100.0 * d.error_m
            );
        }
        out += &format!(
            "average {:.2} cm, largest {:.2} cm\n",
            100.0 * report.error_m.mean,
            100.0 * report.error_m.max
        );
    }
    out
}

/// What somebody should look at, below the tables.
fn tail(judgement: &Judgement) -> String {
    match problem_lines(judgement) {
        lines if lines.is_empty() => String::new(),
        lines => format!("\n{}", lines.trim_end()),
    }
}
