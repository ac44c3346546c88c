//! `lsfb demo`: the main job from nothing, in one folder.

mod figures;
mod page;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use lsfb_eval::Evaluation;
use lsfb_geometry::{Se3, Trajectory};
use lsfb_pipeline::ground_truth::GroundTruthConfig;
use lsfb_pipeline::mapping::MappingConfig;
use lsfb_recording::Provenance;
use lsfb_sim::SimConfig;
use lsfb_types::Verdict;
use serde::Serialize;

use super::groundtruth::WalkJob;
use super::map::MapJob;
use super::models::ModelFolder;
use crate::context::Context;
use crate::existing::expect_free;
use crate::judged::{Judged, problem_lines};
use crate::memory::peak_rss_mb;
use crate::outcome::Outcome;
use crate::simulated::{self, Layout};
use crate::standing;
use crate::twin_truth::{judge_scan, judge_walk};

/// Simulate, record, map, localize and evaluate: the whole pipeline in a few minutes.
///
/// A simulated backpack scans a furnished room and a corridor; simulated glasses walk through them
/// later. The devices send real bytes to the recorder, and every later stage reads only the recordings.
/// The same seed gives the same trajectories and map. An interrupted demo resumes after its last
/// finished stage. Exit code 4: `lsfb map` or `lsfb groundtruth` would advise against using the result.
///
/// The demo is easy: the walk follows the scan through the same small place, and the rig is known
/// exactly. To measure accuracy, run the standard trial, `lsfb bench twin`.
///
/// Examples:
///   lsfb demo --out demo-out --seed 7
///   lsfb demo --config sim.toml --out demo-out
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder for recordings, map, trajectories and report.
    #[arg(long, value_name = "FOLDER", default_value = "demo-out")]
    out: PathBuf,
    /// Seed of the building, the walks and the noise; by default that of --config, otherwise 1.
    #[arg(long, value_name = "N", value_parser = super::seed, allow_hyphen_values = true)]
    seed: Option<u64>,
    /// Settings of the simulation instead of the defaults; --seed overrides its seed.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

/// The figures of a run and where its files are.
#[derive(Serialize)]
struct Summary {
    seed: u64,
    ate_glasses_rms_m: f64,
    ate_glasses_max_m: f64,
    /// Without an alignment of their own: placed by the map alone, the map placed by the scanner.
    ate_glasses_in_map_rms_m: f64,
    ate_scanner_rms_m: f64,
    ate_scanner_max_m: f64,
    map_reprojection_px: f64,
    map_points: u64,
    glasses_localized: f64,
    lost: u64,
    /// Parts of the walk that have no poses.
    left_out: u64,
    wall_s: f64,
    peak_rss_mb: f64,
    stages_s: Vec<(String, f64)>,
    outputs: Outputs,
}

#[derive(Serialize)]
struct Outputs {
    scan: PathBuf,
    walk: PathBuf,
    rig_backpack: PathBuf,
    rig_glasses: PathBuf,
    map: PathBuf,
    scan_trajectory: PathBuf,
    walk_trajectory: PathBuf,
    truth: PathBuf,
    report: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    rrd: Option<PathBuf>,
}

/// Parts that the ground truth leaves out end the demo as they end `lsfb groundtruth`.
fn outcome(lost: u64, left_out: u64) -> Outcome {
    match (lost, left_out) {
        (0, 0) => Outcome::Done,
        _ => Outcome::DataLost,
    }
}

struct Stopwatch {
    stages: Vec<(String, f64)>,
    last: Instant,
}

impl Stopwatch {
    fn lap(&mut self, name: &str) {
        self.stages
            .push((name.to_owned(), self.last.elapsed().as_secs_f64()));
        self.last = Instant::now();
    }
}

/// Runs everything that does not stand from a run that was interrupted.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let mut watch = Stopwatch {
        stages: Vec::new(),
        last: began,
    };
    let mut sim_config: SimConfig = super::config_or_default(arguments.config.as_deref())?;
    sim_config.seed = arguments.seed.unwrap_or(sim_config.seed);
    context.will_write(&arguments.out);
    begin(&arguments.out, &sim_config, context)?;
    let layout = Layout::create(&arguments.out)?;
    let files = outputs(&layout);
    let lost = record(&layout, &files, &sim_config, &mut watch, context)?;
    // The folder is this demo's own: what does not stand in it is half a result.
    let replace = |_: &Path| Ok(());
    let map_job = MapJob {
        recording: &files.scan,
        out: &files.map,
        out_trajectory: Some(&files.scan_trajectory),
        out_report: None,
        start: None,
        clouds: None,
        marks: None,
        config: &MappingConfig::default(),
    };
    let map = map_job.build(context, replace)?;
    watch.lap("mapping");
    let walk_job = WalkJob {
        recording: &files.walk,
        others: &[],
        map: &files.map,
        out: &files.walk_trajectory,
        out_report: None,
        config: &GroundTruthConfig::default(),
        radio: None,
        models: &ModelFolder::new(None),
    };
    let walk = walk_job.compute(context, replace)?;
    watch.lap("ground truth");
    let judged = judge(&layout, &files)?;
    watch.lap("judging");
    #[cfg(feature = "view")]
    if let Some(rrd) = files.rrd.as_deref() {
        let recordings = [files.scan.clone(), files.walk.clone()];
        let trajectories = [files.scan_trajectory.clone(), files.walk_trajectory.clone()];
        super::view::write(&recordings, &trajectories, Some(&files.map), rrd, context)?;
        watch.lap("viewer file");
    }
    let localized = &walk.said.report;
    let summary = Summary {
        seed: sim_config.seed,
        ate_glasses_rms_m: judged.glasses.ate_translation_m.rmse,
        ate_glasses_max_m: judged.glasses.ate_translation_m.max,
        ate_glasses_in_map_rms_m: judged.glasses_in_map.ate_translation_m.rmse,
        ate_scanner_rms_m: judged.scanner.ate_translation_m.rmse,
        ate_scanner_max_m: judged.scanner.ate_translation_m.max,
        map_reprojection_px: map.report.reprojection_rms_px,
        map_points: map.report.points,
        glasses_localized: localized.localized as f64 / localized.looked_up.max(1) as f64,
        lost,
        left_out: localized.left_out.len() as u64,
        wall_s: began.elapsed().as_secs_f64(),
        peak_rss_mb: peak_rss_mb(),
        stages_s: watch.stages,
        outputs: files,
    };
    let mut findings = map.judgement().findings().to_vec();
    findings.extend(walk.said.findings());
    let figures = figures::figures(&summary, &map.report, localized);
    let shown = (figures, findings);
    let page = page::report(&summary, &judged, &map, &walk, shown, &sim_config)?;
    // Of the figures with limits and of the stages: the page, the terminal and the exit code say the same.
    let judgement = page.judgement();
    page.write(&summary.outputs.report)?;
    // Last of all: a folder that has it is finished.
    super::write(&layout.file(FINISHED), serde_json::to_vec_pretty(&summary)?)?;
    context.print(&Judged::new(&judgement, "the demo", &summary), || {
        format!("{}\n{}", text(&summary), problem_lines(&judgement))
    })?;
    Ok(match judgement.verdict() {
        Verdict::Fail => Outcome::JudgementFailed,
        _ => outcome(summary.lost, summary.left_out),
    })
}

/// Settings of the demo that a folder belongs to.
const BEGUN: &str = "demo.toml";
/// Figures of a demo that is finished.
const FINISHED: &str = "demo.json";

/// Takes the folder for this demo: an empty one, or one where it was interrupted. What is finished, or not its own, stays
/// unless it may be replaced.
fn begin(out: &Path, sim_config: &SimConfig, context: &Context) -> anyhow::Result<()> {
    let settings = toml::to_string(sim_config)?;
    let (begun, finished) = (out.join(BEGUN), out.join(FINISHED));
    let folder = out.display();
    if !context.force() {
        match std::fs::read_to_string(&begun) {
            Ok(_) if finished.exists() => anyhow::bail!(
                "{folder}: this demo is finished, see report.html there: choose another --out, or run it again with --force"
            ),
            Ok(before) => anyhow::ensure!(
                before == settings,
                "{folder}: a demo with another seed or other settings was started here: choose another --out, or replace it with --force"
            ),
            Err(_) => {
                for name in [
                    "scan.mcap",
                    "walk.mcap",
                    "map",
                    "scan.tum",
                    "walk.tum",
                    FINISHED,
                ] {
                    expect_free(&out.join(name), &[], false)?;
                }
            }
        }
    }
    std::fs::create_dir_all(out).with_context(|| folder.to_string())?;
    if finished.exists() {
        std::fs::remove_file(&finished).with_context(|| finished.display().to_string())?;
    }
    super::write(&begun, settings)
}

/// Simulates and records scan and walk, each unless it stands; how many messages were lost.
fn record(
    layout: &Layout,
    files: &Outputs,
    sim_config: &SimConfig,
    watch: &mut Stopwatch,
    context: &Context,
) -> anyhow::Result<u64> {
    let made_from = Provenance::new(sim_config);
    let truth = ["truth_scan.tum", "truth_walk.tum"].map(|name| layout.truth().join(name));
    let [truth_scan, truth_walk] = &truth;
    let scan: &[&Path] = &[&files.scan, &files.rig_backpack, truth_scan];
    let walk: &[&Path] = &[&files.walk, &files.rig_glasses, truth_walk];
    let stand: [Option<u64>; 2] = [scan, walk].map(|outputs| context.standing(outputs, &made_from));
    if let [Some(scan), Some(walk)] = stand {
        return Ok(scan + walk);
    }
    let simulation = simulated::prepare(layout, sim_config, [None, None], None, context)?;
    watch.lap("building the world");
    if !sim_config.clocks.is_ideal() {
        // Clocks that drift are told from arrivals: those of sockets read as fast as they go tell nothing.
        [scan, walk].into_iter().try_for_each(standing::forget)?;
        let reports = simulated::record_with_simulated_arrivals(layout, &simulation, context)?;
        for (outputs, report) in [scan, walk].into_iter().zip(&reports) {
            standing::finish(outputs, &[], &made_from, &report.lost)?;
        }
        watch.lap("recording scan and walk");
        return Ok(reports.iter().map(|r| r.lost).sum());
    }
    let mut lost = 0;
    if let Some(before) = stand[0] {
        lost += before;
    } else {
        standing::forget(scan)?;
        let report = simulated::record_backpack(layout, &simulation, context)?;
        standing::finish(scan, &[], &made_from, &report.lost)?;
        lost += report.lost;
        watch.lap("recording the scan");
    }
    if let Some(before) = stand[1] {
        lost += before;
    } else {
        standing::forget(walk)?;
        let report = simulated::record_glasses(layout, &simulation, context)?;
        standing::finish(walk, &[], &made_from, &report.lost)?;
        lost += report.lost;
        watch.lap("recording the walk");
    }
    Ok(lost)
}

fn outputs(layout: &Layout) -> Outputs {
    Outputs {
        scan: layout.file("scan.mcap"),
        walk: layout.file("walk.mcap"),
        rig_backpack: layout.file("backpack.toml"),
        rig_glasses: layout.file("glasses.toml"),
        map: layout.file("map"),
        scan_trajectory: layout.file("scan.tum"),
        walk_trajectory: layout.file("walk.tum"),
        truth: layout.truth(),
        report: layout.file("report.html"),
        rrd: cfg!(feature = "view").then(|| layout.file("demo.rrd")),
    }
}

struct Errors {
    scanner: Evaluation,
    glasses: Evaluation,
    glasses_in_map: Evaluation,
    truth_scanner: Trajectory,
    truth_glasses: Trajectory,
    /// Truth's world from the map's, by the scanner's trajectory.
    truth_from_map: Se3,
}

fn judge(layout: &Layout, files: &Outputs) -> anyhow::Result<Errors> {
    let truth = |name: &str| layout.truth().join(name);
    let scan = judge_scan(&truth("truth_scan.tum"), &files.scan_trajectory)?;
    let walk = judge_walk(
        &truth("truth_walk.tum"),
        &files.walk_trajectory,
        scan.truth_from_map,
    )?;
    Ok(Errors {
        scanner: scan.evaluation,
        glasses: walk.own,
        glasses_in_map: walk.in_map,
        truth_scanner: Trajectory::new(scan.truth),
        truth_glasses: Trajectory::new(walk.truth),
        truth_from_map: scan.truth_from_map,
    })
}

fn text(s: &Summary) -> String {
    let viewer = s
        .outputs
        .rrd
        .as_ref()
        .map(|p| format!(", {}", p.display()))
        .unwrap_or_default();
    format!(
        "glasses  ATE {:.2} cm rms, {:.2} cm max ({:.2} cm rms in the map); {:.1} % \
         localized\nscanner  ATE {:.2} cm rms, {:.2} cm max\nmap      {} points, reprojection {:.3} \
         px rms\nrun      {:.0} s, {:.0} MB at most, {} messages lost, {} parts of the walk left \
         out\nopen     {}{viewer}",
        s.ate_glasses_rms_m * 100.0,
        s.ate_glasses_max_m * 100.0,
        s.ate_glasses_in_map_rms_m * 100.0,
        s.glasses_localized * 100.0,
        s.ate_scanner_rms_m * 100.0,
        s.ate_scanner_max_m * 100.0,
        s.map_points,
        s.map_reprojection_px,
        s.wall_s,
        s.peak_rss_mb,
        s.lost,
        s.left_out,
        s.outputs.report.display(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_with_parts_left_out_is_no_whole_one() {
        assert_eq!(outcome(0, 0), Outcome::Done);
        assert_eq!(outcome(0, 1), Outcome::DataLost);
        assert_eq!(outcome(1, 0), Outcome::DataLost);
    }
}
