//! `lsfb report`: a dataset on one page.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_eval::dataset::{
    DatasetFolder, DatasetViews, Description, EnvironmentView, EstimateView, judge_measured,
    measure,
};
use lsfb_eval::{
    DuplicateStamps, EvalConfig, ReadOptions, TrajectoryFile, evaluate_files, read_poses,
    read_trajectory,
};
use lsfb_geometry::{Trajectory, Vector3};
use lsfb_recording::Provenance;
use lsfb_types::{Finding, Judgement, Verdict};
use serde::Serialize;

use crate::commands::dataset;
use crate::context::Context;
use crate::files::write;
use crate::judged::{Judged, printable, problem_lines};
use crate::outcome::Outcome;
use crate::pages;

/// Scans of a place that are drawn, and every how many of their points.
const SCANS: usize = 40;
const EVERY_POINT: usize = 23;

/// Draw a dataset on one page: maps with all walks, estimates against the truth, tables.
///
/// Maps are the scans, placed by the truth; walks are coloured by device. Where most walks pass, or at
/// --inset-m, squares are drawn again, enlarged (the paper's Fig. 1). If the truth is held back, only
/// the tables are shown. --estimates draws every SEQUENCE.tum of a folder and evaluates it against the
/// truth. --out-svg also writes the drawings for papers; print the page from a browser to get a PDF.
///
/// Other figures of the paper: Fig. 4 by `lsfb bench ba`, Fig. 5 (several systems on one walk) by `lsfb
/// bench slam`, Fig. 6 (floor marks) by `lsfb survey check --out`, Fig. 7 (a walk against GNSS/INS) by
/// `lsfb align` and `lsfb eval --out`.
///
/// Examples:
///   lsfb report dataset --out report.html
///   lsfb report dataset --out report.html --estimates found --out-svg figures
///   lsfb report dataset --out report.html --inset-m narrow-corridor=12.5,-3,4 --inset-m narrow-corridor=2,0,4
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The dataset.
    #[arg(value_name = "FOLDER")]
    dataset: PathBuf,
    /// The page.
    #[arg(long, value_name = "HTML")]
    out: PathBuf,
    /// Folder of estimated trajectories, SEQUENCE.tum.
    #[arg(long, value_name = "FOLDER")]
    estimates: Option<PathBuf>,
    /// Also write the drawings as SVG files.
    #[arg(long, value_name = "FOLDER")]
    out_svg: Option<PathBuf>,
    /// A square of an environment to draw enlarged: centre and side in metres; may be repeated.
    #[arg(long, value_name = "ENVIRONMENT=X,Y,SIDE", value_parser = inset, allow_hyphen_values = true)]
    inset_m: Vec<(String, [f64; 3])>,
}

/// `narrow-corridor=12.5,-3,4`.
fn inset(text: &str) -> Result<(String, [f64; 3]), String> {
    let problem = || {
        "expected an environment, the centre of a square and its side: hall=12.5,-3,4".to_owned()
    };
    let (name, numbers) = text.split_once('=').ok_or_else(problem)?;
    let numbers: Result<Vec<f64>, _> = numbers.split(',').map(str::parse).collect();
    let numbers: [f64; 3] = numbers
        .ok()
        .and_then(|n| n.try_into().ok())
        .ok_or_else(problem)?;
    let is_square = numbers.iter().all(|v| v.is_finite()) && numbers[2] > 0.0;
    is_square
        .then(|| (name.to_owned(), numbers))
        .ok_or_else(problem)
}

#[derive(Serialize)]
struct Drawn<'a> {
    page: &'a Path,
    drawings: Vec<PathBuf>,
}

/// Measures, draws, judges, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let (folder, description) = dataset::open(&arguments.dataset)?;
    for (name, _) in &arguments.inset_m {
        anyhow::ensure!(
            description.environments.iter().any(|e| e.name == *name),
            "the dataset has no environment {name:?}: it has {}",
            description
                .environments
                .iter()
                .map(|e| e.name.as_str())
                .collect::<Vec<_>>()
                .join(", ")
        );
    }
    context.claim(&arguments.out, &[&folder.description()])?;
    let (mut findings, mut measured) = (Vec::new(), Vec::new());
    for planned in &description.queries {
        let recording = context.open(&folder.walk(&planned.name))?;
        let own = measure(&folder, planned, &recording, &|p| context.show(p))?;
        findings.extend(judge_measured(&own, description.rate_hz));
        measured.push(own);
    }
    let mut views = DatasetViews {
        environments: environments(&folder, &description, &arguments.inset_m, context)?,
        estimates: Vec::new(),
    };
    if let Some(estimates) = &arguments.estimates {
        views.estimates = judged(estimates, &folder, &description, &mut findings)?;
    }
    let judgement = Judgement::new(findings);
    let mut made_from = Provenance::new(&serde_json::json!({
        "estimates": arguments.estimates,
        "inset_m": arguments.inset_m,
    }));
    // The description has the hashes of the dataset's other files.
    made_from.add_input(&folder.description())?;
    let page = views.page(&description, &measured, &judgement);
    pages::write(&arguments.out, page, &made_from)?;
    let mut drawn = Drawn {
        page: &arguments.out,
        drawings: Vec::new(),
    };
    if let Some(out) = &arguments.out_svg {
        std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
        for (name, svg) in views.drawings() {
            let path = out.join(format!("{}.svg", file_name(&name)));
            context.claim(&path, &[])?;
            write(&path, svg)?;
            drawn.drawings.push(path);
        }
    }
    let what = format!("{} sequences", measured.len());
    let judged = Judged::new(&judgement, &what, &drawn);
    context.print(&judged, || {
        let (summary, problems) = (&judged.summary, problem_lines(&judgement));
        printable(&format!(
            "{summary}\n{problems}See {}",
            arguments.out.display()
        ))
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

/// Letters and digits of a title: `Corridor (wide)` → `corridor-wide`.
fn file_name(title: &str) -> String {
    let words = title.split(|c: char| !c.is_alphanumeric());
    let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
    words.join("-").to_lowercase()
}

/// Maps and walks, where their truth is there.
fn environments(
    folder: &DatasetFolder,
    description: &Description,
    insets: &[(String, [f64; 3])],
    context: &Context,
) -> anyhow::Result<Vec<EnvironmentView>> {
    let mut views = Vec::new();
    for environment in &description.environments {
        let own = insets.iter().filter(|(name, _)| *name == environment.name);
        let mut view = EnvironmentView {
            title: environment.title.clone(),
            insets: own.map(|(_, [x, y, side])| ([*x, *y], *side)).collect(),
            ..EnvironmentView::default()
        };
        let truth = folder.scan_truth(&environment.name);
        let scan = folder.scan(&environment.name);
        if truth.exists() && scan.exists() {
            view.map_points = map_points(&scan, &truth, context)?;
        }
        let here = description.queries.iter();
        for query in here.filter(|q| q.environment == environment.name) {
            let truth = folder.walk_truth(&query.name);
            if truth.exists() {
                view.walks
                    .push((query.device, query.name.clone(), read_poses(&truth)?));
            }
        }
        if !view.walks.is_empty() {
            views.push(view);
        }
    }
    Ok(views)
}

/// Points of some scans in the world; how the rig moved within a turn is left out, as a drawing shows none of it.
fn map_points(scan: &Path, truth: &Path, context: &Context) -> anyhow::Result<Vec<Vector3<f64>>> {
    let recording = context.open(scan)?;
    let rig = recording.rig()?;
    let Some(lidar) = rig.lidar() else {
        return Ok(Vec::new());
    };
    let truth = Trajectory::new(read_poses(truth)?);
    let main = recording.main_lidar();
    let topics = recording.topics().iter();
    let scans = topics
        .filter(|t| t.topic == main)
        .map(|t| t.messages as usize)
        .sum::<usize>();
    let step = scans.div_ceil(SCANS).max(1);
    let mut points = Vec::new();
    for scan in recording.scans()?.step_by(step) {
        let scan = scan?;
        context.check_stop()?;
        let Some(world_from_rig) = truth.at(scan.time) else {
            continue;
        };
        let world_from_lidar = world_from_rig * lidar.rig_from_lidar;
        let some = scan.sample.points.iter().step_by(EVERY_POINT);
        points.extend(some.map(|p| world_from_lidar * Vector3::from(p.position_m.map(f64::from))));
    }
    Ok(points)
}

/// Estimates that are there, judged; what cannot be judged is a finding.
fn judged(
    estimates: &Path,
    folder: &DatasetFolder,
    description: &Description,
    findings: &mut Vec<Finding>,
) -> anyhow::Result<Vec<EstimateView>> {
    let config = EvalConfig {
        duplicates: DuplicateStamps::Keep,
        rpe: Vec::new(),
        ..EvalConfig::default()
    };
    let mut views = Vec::new();
    for query in &description.queries {
        let name = &query.name;
        let path = estimates.join(format!("{name}.tum"));
        let truth_path = folder.walk_truth(name);
        if !path.exists() || !truth_path.exists() {
            let what = "has no estimate, or no truth to evaluate it against";
            findings.push(Finding::new("estimate", Verdict::Unknown, name, what));
            continue;
        }
        let truth: TrajectoryFile = read_trajectory(&truth_path, &ReadOptions::default())?;
        let estimate = read_trajectory(&path, &ReadOptions::default())?;
        match evaluate_files(&truth, &estimate, &config) {
            Ok(evaluation) => {
                findings.extend(evaluation.findings.iter().map(|found| Finding {
                    subject: format!("{name} {}", found.subject),
                    ..found.clone()
                }));
                views.push(EstimateView {
                    sequence: name.clone(),
                    evaluation,
                    truth: truth.poses,
                });
            }
            Err(error) => {
                findings.push(Finding::new(
                    "estimate",
                    Verdict::Fail,
                    name,
                    error.to_string(),
                ));
            }
        }
    }
    Ok(views)
}
