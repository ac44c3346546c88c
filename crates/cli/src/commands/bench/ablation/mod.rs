//! `lsfb bench ablation`: one walk with less and less of the map, judged by a ground truth that is given.

mod table;

use std::path::{Path, PathBuf};

use lsfb_eval::{EvalConfig, ReadOptions, TrajectoryFile, evaluate, read_trajectory};
use lsfb_geometry::Trajectory;
use lsfb_pipeline::descriptor_index::IndexConfig;
use lsfb_pipeline::ground_truth::{
    GroundTruthConfig, MotionConfig, RecordedWalk, ground_truth_of, motion_of_recording,
};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, Recording, write_tum};
use lsfb_types::{Finding, Verdict};

use super::twin::refusal;
use crate::commands::models::ModelFolder;
use crate::context::Context;
use crate::files;
use crate::judged::printable;
use crate::outcome::Outcome;
use table::{ALIGNMENT, QUADRANTS, Row, Run, Table, summary, text};

/// Compute one walk with less and less of the map, as in the paper's Table IV.
///
/// Each trajectory is evaluated against your ground truth. The map is cut into quadrants around the
/// medians of its points' x and y. 75 % withholds each of the four in turn, 50 % each pair of
/// neighbours, 25 % all but one; 100 % is the whole map, and 0 % is motion without a map (`lsfb vio`).
/// Every trajectory is aligned to the ground truth by SE(3) before evaluation, also those in the map,
/// since motion without a map has no absolute position.
///
/// Each row gives the mean over the choices of quadrants with its 95 % interval (Student's t), the
/// worst choice, the share of ground-truth poses evaluated, and the share of the walk's frames with a
/// pose; choices for which the walk is refused are counted. Look at errors and completeness together:
/// one trades against the other. Writes ablation.json and every trajectory.
///
/// Examples:
///   lsfb bench ablation walk.mcap --map map --truth truth_walk.tum --out ablation
///   lsfb bench ablation walk.mcap --map map --truth truth_walk.tum --map-percent 50,0 --out ablation --json
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recording of a walk with a phone or glasses.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// HD map (folder).
    #[arg(long, value_name = "FOLDER")]
    map: PathBuf,
    /// Ground truth of the walk, in any format that `lsfb eval` reads.
    #[arg(long, value_name = "TRAJECTORY")]
    truth: PathBuf,
    /// Folder for the trajectories and the result.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Shares of the map to keep, in percent: 100, 75, 50, 25 or 0.
    #[arg(long, value_name = "PERCENT", value_delimiter = ',', value_parser = percent, default_value = "100,75,50,25,0")]
    map_percent: Vec<u32>,
    /// Settings of the ground truth instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    #[command(flatten)]
    models: ModelFolder,
}

const RESULT: &str = "ablation.json";

fn percent(text: &str) -> Result<u32, String> {
    let share = text.parse().ok().filter(|p| *p <= 100 && p % 25 == 0);
    share.ok_or_else(|| "expected 100, 75, 50, 25 or 0".to_owned())
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
            let (points, found) = match &self.walk {
                Some(walk) if percent > 0 => self.in_part(walk, &withheld),
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

    /// In the map without some quadrants; how many points that has.
    fn in_part(&self, walk: &RecordedWalk, withheld: &[usize]) -> (usize, anyhow::Result<Found>) {
        if withheld.is_empty() {
            return (self.map.point_count(), self.in_map(walk, self.map));
        }
        let show = |p| self.context.show(p);
        let index = IndexConfig::default();
        match self.map.without_quadrants(withheld, &index, &show) {
            Ok(part) => (part.point_count(), self.in_map(walk, &part)),
            Err(error) => (0, Err(error.into())),
        }
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
            judged_percent: 0.0,
            ate_max_m: None,
            findings: Vec::new(),
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
                run.judged_percent =
                    100.0 * judged.matched_poses as f64 / found.trajectory.len().max(1) as f64;
                run.ate_max_m = Some(judged.ate_translation_m.max);
                let is_problem = |f: &Finding| f.verdict != Verdict::Pass;
                run.findings = judged.findings.into_iter().filter(is_problem).collect();
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
}
