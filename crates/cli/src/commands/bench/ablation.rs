//! `lsfb bench ablation`: one walk with less and less of the map, judged by a ground truth that is given.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lsfb_eval::alignment::AlignmentMode;
use lsfb_eval::{EvalConfig, ReadOptions, TrajectoryFile, evaluate, read_trajectory};
use lsfb_geometry::Trajectory;
use lsfb_pipeline::descriptor_index::IndexConfig;
use lsfb_pipeline::ground_truth::{
    GroundTruthConfig, MotionConfig, RecordedWalk, ground_truth_of, motion_of_recording,
};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, Recording, write_tum};
use serde::Serialize;

use super::twin::refusal;
use crate::commands::models::ModelFolder;
use crate::context::Context;
use crate::files;
use crate::judged::printable;
use crate::outcome::Outcome;

/// Compute one walk with less and less of the map, as in the paper's Table IV, and judge each by a ground truth of your own.
///
/// The map is cut into quadrants around the medians of its points' x and y. For 75 % each of the four is withheld in turn, for 50 % each
/// pair of neighbours, for 25 % all but each; 100 % is the whole map. 0 % is the motion without a map (`lsfb vio`). Every trajectory is
/// aligned to the ground truth (SE(3)) before it is judged; the same for all shares, since that of 0 % lies nowhere else.
///
/// Each row has the mean over the choices of quadrants with its 95 % interval (Student's t), the worst choice, and the share of the walk's
/// frames that have a pose; choices with which the walk is refused are counted and said. What is wrong and what is left out trade against
/// each other: look at both. Writes ablation.json and every trajectory.
///
/// Examples:
///   lsfb bench ablation walk.mcap --map map --truth truth_walk.tum --out ablation
///   lsfb bench ablation walk.mcap --map map --truth truth_walk.tum --map-percent 50,0 --out ablation --json
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The recording of a walk with a phone or glasses.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// The map, a folder.
    #[arg(long, value_name = "FOLDER")]
    map: PathBuf,
    /// The ground truth of the walk, in any format that `lsfb eval` reads.
    #[arg(long, value_name = "TRAJECTORY")]
    truth: PathBuf,
    /// Folder for the trajectories and the result.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Shares of the map that are left, in percent: 100, 75, 50, 25 or 0.
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = percent, default_value = "100,75,50,25,0")]
    map_percent: Vec<u32>,
    /// Settings of the ground truth instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    #[command(flatten)]
    models: ModelFolder,
}

const RESULT: &str = "ablation.json";
const QUADRANTS: usize = 4;
/// What the motion without a map is compared after, and all others with it.
const ALIGNMENT: AlignmentMode = AlignmentMode::Se3;

fn percent(text: &str) -> Result<u32, String> {
    let share = text.parse().ok().filter(|p| *p <= 100 && p % 25 == 0);
    share.ok_or_else(|| "expected 100, 75, 50, 25 or 0".to_owned())
}

/// One choice of quadrants.
#[derive(Serialize)]
struct Run {
    /// Those that were withheld.
    withheld_quadrants: Vec<usize>,
    /// Share of the map's points that was left, percent.
    points_percent: f64,
    /// Share of the walk's frames that have a pose, percent.
    poses_percent: f64,
    /// After alignment; absent where the walk was refused.
    ate_rms_m: Option<f64>,
    /// The largest error of a position after alignment.
    ate_max_m: Option<f64>,
    /// Why the walk was refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    refused: Option<String>,
}

/// All choices of one share.
#[derive(Serialize)]
struct Row {
    map_percent: u32,
    method: &'static str,
    alignment: &'static str,
    /// Choices that gave a trajectory.
    given: usize,
    refused: usize,
    ate_rms_m: Option<f64>,
    /// Half of the 95 % interval of that mean; absent for fewer than two choices.
    ate_rms_interval_m: Option<f64>,
    /// The worst choice's.
    worst_ate_rms_m: Option<f64>,
    poses_percent: f64,
    runs: Vec<Run>,
}

#[derive(Serialize)]
struct Table {
    walk: String,
    truth: String,
    rows: Vec<Row>,
}

/// Runs all of them.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let mut config: GroundTruthConfig =
        crate::commands::config_or_default(arguments.config.as_deref())?;
    let recording = context.open(&arguments.recording)?;
    let map = crate::commands::open_map(&arguments.map)?;
    let truth = read_trajectory(&arguments.truth, &ReadOptions::default())?;
    if let Some(learned) = arguments.models.learned(map.feature())? {
        config.learned = Some(learned);
    }
    let result = arguments.out.join(RESULT);
    context.claim(&result, &[&arguments.recording, &arguments.truth])?;
    let mut provenance = Provenance::new(&config);
    for input in [
        &arguments.recording,
        &arguments.truth,
        &arguments.map.join(HdMap::HEADER),
    ] {
        provenance.add_input(input)?;
    }
    let needs_map = arguments.map_percent.iter().any(|percent| *percent > 0);
    let bench = Bench {
        recording: &recording,
        walk: match needs_map {
            true => Some(RecordedWalk::read(&recording, &config, &|p| {
                context.show(p)
            })?),
            false => None,
        },
        map: &map,
        truth: &truth,
        config: &config,
        out: &arguments.out,
        context,
    };
    let mut rows = Vec::new();
    for percent in &arguments.map_percent {
        rows.push(bench.row(*percent)?);
    }
    let table = Table {
        walk: files::name_of(&arguments.recording),
        truth: files::name_of(&arguments.truth),
        rows,
    };
    files::write(&result, serde_json::to_vec_pretty(&table)?)?;
    provenance.write(&result)?;
    context.print(&table, || printable(&text(&table)))?;
    Ok(Outcome::Done)
}

/// What all runs share.
struct Bench<'a> {
    recording: &'a Recording,
    /// Read where a map is asked for it.
    walk: Option<RecordedWalk>,
    map: &'a HdMap,
    truth: &'a TrajectoryFile,
    config: &'a GroundTruthConfig,
    out: &'a Path,
    context: &'a Context,
}

/// A trajectory and how many frames might have had a pose.
struct Found {
    trajectory: Trajectory,
    frames: u64,
}

impl Bench<'_> {
    fn row(&self, percent: u32) -> anyhow::Result<Row> {
        let mut runs = Vec::new();
        for (k, withheld) in choices(percent).into_iter().enumerate() {
            let part = match (percent, withheld.is_empty()) {
                (0, _) => None,
                (_, true) => Some(None),
                _ => Some(Some(self.map.without_quadrants(
                    &withheld,
                    &IndexConfig::default(),
                    &|p| self.context.show(p),
                ))),
            };
            let (points, found) = match (part, &self.walk) {
                (Some(None), Some(walk)) => (self.map.point_count(), self.in_map(walk, self.map)),
                (Some(Some(Ok(part))), Some(walk)) => {
                    (part.point_count(), self.in_map(walk, &part))
                }
                // A part of the map without points, say.
                (Some(Some(Err(error))), _) => (0, Err(error.into())),
                _ => (0, self.without_map()),
            };
            let place = self.out.join(format!("map{percent}_{k}.tum"));
            let mut run = self.judged(refusal(found, "ground truth")?, &place)?;
            run.points_percent = 100.0 * points as f64 / self.map.point_count().max(1) as f64;
            run.withheld_quadrants = withheld;
            runs.push(run);
        }
        Ok(summary(percent, runs))
    }

    fn in_map(&self, walk: &RecordedWalk, map: &HdMap) -> anyhow::Result<Found> {
        let found = ground_truth_of(walk, map, self.config, &|p| self.context.show(p))?;
        Ok(Found {
            frames: found.report.frames,
            trajectory: found.trajectory,
        })
    }

    fn without_map(&self) -> anyhow::Result<Found> {
        let config = MotionConfig {
            adjustment: self.config.clone(),
            ..MotionConfig::default()
        };
        let rig = self.recording.rig()?;
        let found = motion_of_recording(self.recording, &rig, &config, &|p| self.context.show(p))?;
        Ok(Found {
            frames: found.report.frames,
            trajectory: found.trajectory,
        })
    }

    fn judged(&self, found: Result<Found, String>, place: &Path) -> anyhow::Result<Run> {
        let mut run = Run {
            withheld_quadrants: Vec::new(),
            points_percent: 0.0,
            poses_percent: 0.0,
            ate_rms_m: None,
            ate_max_m: None,
            refused: None,
        };
        let found = match found {
            Ok(found) => found,
            Err(why) => {
                run.refused = Some(why);
                return Ok(run);
            }
        };
        self.context.claim(place, &[])?;
        write_tum(place, &found.trajectory)?;
        run.poses_percent = 100.0 * found.trajectory.len() as f64 / found.frames.max(1) as f64;
        let config = EvalConfig {
            alignment: ALIGNMENT,
            ..EvalConfig::default()
        };
        match evaluate(&self.truth.poses, found.trajectory.poses(), &config) {
            Ok(judged) => {
                run.ate_rms_m = Some(judged.ate_translation_m.rmse);
                run.ate_max_m = Some(judged.ate_translation_m.max);
            }
            // Too few of its poses meet the truth.
            Err(why) => run.refused = Some(format!("evaluation: {why}")),
        }
        Ok(run)
    }
}

/// Which quadrants are withheld so that so many percent of them are left.
fn choices(percent: u32) -> Vec<Vec<usize>> {
    let withheld = QUADRANTS - percent as usize * QUADRANTS / 100;
    match withheld {
        0 | QUADRANTS => vec![(0..withheld).collect()],
        _ => {
            let from = 0..QUADRANTS;
            from.map(|first| (first..first + withheld).map(|k| k % QUADRANTS).collect())
                .collect()
        }
    }
}

fn summary(percent: u32, runs: Vec<Run>) -> Row {
    let rms: Vec<f64> = runs.iter().filter_map(|run| run.ate_rms_m).collect();
    let shares = runs.iter().map(|run| run.poses_percent);
    Row {
        map_percent: percent,
        method: match percent {
            0 => "motion without a map",
            _ => "ground truth",
        },
        alignment: ALIGNMENT.label(),
        given: rms.len(),
        refused: runs.len() - rms.len(),
        ate_rms_m: mean(&rms),
        ate_rms_interval_m: interval(&rms),
        worst_ate_rms_m: rms.iter().copied().reduce(f64::max),
        poses_percent: shares.sum::<f64>() / runs.len().max(1) as f64,
        runs,
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Student's t for 95 % on both sides, with one, two and three degrees of freedom.
const STUDENT_95: [f64; QUADRANTS - 1] = [12.706, 4.303, 3.182];

/// Half of the 95 % interval of the mean.
fn interval(values: &[f64]) -> Option<f64> {
    let freedom = values.len().checked_sub(1)?;
    let student = STUDENT_95.get(freedom.checked_sub(1)?)?;
    let middle = mean(values)?;
    let variance = values.iter().map(|v| (v - middle).powi(2)).sum::<f64>() / freedom as f64;
    Some(student * (variance / values.len() as f64).sqrt())
}

fn text(table: &Table) -> String {
    let mut text = format!(
        "{} against {}, ATE rms in cm after alignment by {}\n  map  runs  refused      ATE   ± 95 %    worst   frames with a pose\n",
        table.walk,
        table.truth,
        ALIGNMENT.label()
    );
    let cm = |value: Option<f64>| value.map_or("–".to_owned(), |m| format!("{:.2}", 100.0 * m));
    for row in &table.rows {
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{:>4}%  {:>4}  {:>7}  {:>7}  {:>7}  {:>7}   {:.1} %{}",
            row.map_percent,
            row.runs.len(),
            row.refused,
            cm(row.ate_rms_m),
            cm(row.ate_rms_interval_m),
            cm(row.worst_ate_rms_m),
            row.poses_percent,
            match row.map_percent {
                0 => " (motion without a map)",
                _ => "",
            }
        );
        for run in &row.runs {
            if let Some(why) = &run.refused {
                let _ = writeln!(text, "       without {:?}: {why}", run.withheld_quadrants);
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_quadrant_is_withheld_equally_often() {
        for (percent, runs, each) in [(100, 1, 0), (75, 4, 1), (50, 4, 2), (25, 4, 3), (0, 1, 1)] {
            let choices = choices(percent);
            assert_eq!(choices.len(), runs, "{percent}");
            for quadrant in 0..QUADRANTS {
                let often = choices.iter().filter(|c| c.contains(&quadrant)).count();
                assert_eq!(often, each, "{percent} %, quadrant {quadrant}");
            }
        }
    }

    /// By hand: mean 4.31, s = 1.3776, t = 3.182, n = 4.
    #[test]
    fn interval_is_students() {
        let values = [3.0, 5.5, 5.5, 3.24];
        let half = interval(&values).expect("four values");
        assert!((half - 2.1917).abs() < 1e-3, "{half}");
        assert_eq!(interval(&values[..1]), None);
    }
}
