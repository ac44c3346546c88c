//! `lsfb bench ablation`: walks with less and less of their maps, and without loops, judged by ground truths that are given.

mod cases;

use std::path::{Path, PathBuf};

use lsfb_eval::ablation::{ALIGNMENT, Method, QUADRANTS, Run, Runs, Setting, Table};
use lsfb_eval::{EvalConfig, evaluate};
use lsfb_geometry::{StampedPose, Trajectory};
use lsfb_pipeline::descriptor_index::IndexConfig;
use lsfb_pipeline::ground_truth::{
    GroundTruth, GroundTruthConfig, MotionConfig, RecordedWalk, ground_truth_of,
    motion_of_recording,
};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, write_tum};
use lsfb_types::{Finding, Verdict};

use super::twin::refusal;
use crate::commands::models::ModelFolder;
use crate::context::Context;
use crate::files;
use crate::judged::{Judged, printable};
use crate::outcome::Outcome;
use cases::{Case, Named, cases};

/// Compute walks with less and less of their maps, and without loops, as in the paper's Tables IV and V.
///
/// Each trajectory is evaluated against your ground truth. A map is cut into quadrants around the
/// medians of its points' x and y. 75 % withholds each of the four in turn, 50 % each pair of
/// neighbours, 25 % all but one; 100 % is the whole map, and 0 % is motion without a map (`lsfb vio`),
/// with --loops-off also without closing loops; in a map none are closed. With 100 % there is also a
/// row of the images that were localized one by one, of all that were looked up.
/// Every trajectory is aligned to the ground truth by SE(3) before evaluation, also those in the map,
/// since motion without a map has no absolute position.
///
/// Each row gives the mean with its 95 % interval (Student's t) and the worst. Of one walk that is over
/// the choices of quadrants; of several (of several seeds, say) it is over the walks, each the mean of its
/// choices. Maps of different features (`lsfb map --feature`) have rows of their own: give a walk once for
/// each. Rows also give the share of ground-truth poses evaluated, and the share of the walk's frames with
/// a pose; choices for which the walk is refused are counted. Look at errors and completeness together:
/// one trades against the other. Writes ablation.json and every trajectory. Exit code 4: a trajectory does
/// not follow the ground truth it was held against (another walk's, say), or every walk was refused.
///
/// Examples:
///   lsfb bench ablation walk.mcap --map map --truth truth_walk.tum --out ablation
///   lsfb bench ablation walk.mcap --map map --truth truth_walk.tum --map-percent 50,0 --out ablation --json
///   lsfb bench ablation walk1.mcap walk2.mcap --map map1 --map map2 --truth truth1.tum --truth truth2.tum --loops-off --out seeds
///   lsfb bench ablation walk.mcap walk.mcap --map sift --map aliked --truth truth_walk.tum --out features
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recordings of walks with a phone or glasses.
    #[arg(value_name = "MCAP", required = true)]
    recordings: Vec<PathBuf>,
    /// HD map (folder); may be repeated: one for each walk, in the same order, or one for all.
    #[arg(long = "map", value_name = "FOLDER", required = true)]
    maps: Vec<PathBuf>,
    /// Ground truth of the walk, in any format that `lsfb eval` reads; may be repeated, as --map.
    #[arg(long = "truth", value_name = "TRAJECTORY", required = true)]
    truths: Vec<PathBuf>,
    /// Folder for the trajectories and the result.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Shares of the map to keep, in percent: 100, 75, 50, 25 or 0.
    #[arg(long, value_name = "PERCENT", value_delimiter = ',', value_parser = percent, default_value = "100,75,50,25,0")]
    map_percent: Vec<u32>,
    /// Compute motion without a map (0 %) also without closing loops.
    #[arg(long)]
    loops_off: bool,
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
    let config: GroundTruthConfig =
        crate::commands::config_or_default(arguments.config.as_deref())?;
    let named = cases(&arguments.recordings, &arguments.maps, &arguments.truths)?;
    let open = |named: &Named<'_>| Case::open(named, &config, &arguments.models, context);
    let cases: Vec<Case> = named.iter().map(open).collect::<anyhow::Result<_>>()?;
    cases::expect_each_once(&cases)?;
    let result = arguments.out.join(RESULT);
    let read: Vec<&Path> = named.iter().flat_map(|n| [n.recording, n.truth]).collect();
    context.claim(&result, &read)?;
    let mut provenance = Provenance::new(&config);
    for named in &named {
        provenance.add_input(named.recording)?;
        provenance.add_input(named.truth)?;
        provenance.add_input(&named.map.join(HdMap::HEADER))?;
    }
    let mut runs = Runs::default();
    for (number, case) in cases.iter().enumerate() {
        let ablation = Ablation {
            case,
            number: number + 1,
            name: match cases.len() {
                1 => String::new(),
                _ => format!("walk{}_", number + 1),
            },
            out: &arguments.out,
            context,
        };
        ablation.in_maps(&arguments.map_percent, &mut runs)?;
        let is_known = cases[..number].iter().any(|other| other.is_walk_of(case));
        if arguments.map_percent.contains(&0) && !is_known {
            ablation.without_maps(&config, arguments.loops_off, &mut runs)?;
        }
    }
    let table = Table {
        walks: cases.iter().map(Case::names).collect(),
        rows: runs.rows(),
    };
    files::write(&result, serde_json::to_vec_pretty(&table)?)?;
    provenance.write(&result)?;
    let judgement = table.judgement();
    let judged = Judged::new(&judgement, "ablation", &table);
    context.print(&judged, || {
        let headline = judgement.headline("ablation");
        printable(&format!("{headline}\n\n{}", table.to_text()))
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

/// What all runs of a walk share.
struct Ablation<'a> {
    case: &'a Case,
    /// Of the walk.
    number: usize,
    /// What the names of its trajectories begin with.
    name: String,
    out: &'a Path,
    context: &'a Context,
}

/// A trajectory and how many frames might have had a pose.
struct Found {
    trajectory: Trajectory,
    frames: u64,
}

impl Ablation<'_> {
    /// In the map and in parts of it.
    fn in_maps(&self, percents: &[u32], runs: &mut Runs) -> anyhow::Result<()> {
        let percents: Vec<u32> = percents.iter().copied().filter(|p| *p > 0).collect();
        if percents.is_empty() {
            return Ok(());
        }
        let case = self.case;
        let show = |p| self.context.show(p);
        let walk = RecordedWalk::read(&case.recording, &case.config, &show)?;
        let setting = |method, map_percent| Setting {
            method,
            map_percent,
            feature: Some(case.map.feature().to_string()),
            loops: None,
        };
        for percent in percents {
            for (k, withheld) in choices(percent).into_iter().enumerate() {
                let (points, found) = self.in_part(&walk, &withheld);
                let found = refusal(found, "ground truth")?;
                let points_percent = 100.0 * points as f64 / case.map.point_count().max(1) as f64;
                if withheld.is_empty() {
                    let alone = found.as_ref().map(one_by_one).map_err(String::clone);
                    let run = Run {
                        points_percent,
                        ..self.judged(alone, "localized")?
                    };
                    runs.add(setting(Method::Localization, percent), run);
                }
                let found = found.map(|found| Found {
                    frames: found.report.frames,
                    trajectory: found.trajectory,
                });
                let run = Run {
                    points_percent,
                    withheld_quadrants: withheld,
                    ..self.judged(found, &format!("map{percent}_{k}"))?
                };
                runs.add(setting(Method::GroundTruth, percent), run);
            }
        }
        Ok(())
    }

    /// In the map without some quadrants; how many points that has.
    fn in_part(
        &self,
        walk: &RecordedWalk,
        withheld: &[usize],
    ) -> (usize, anyhow::Result<GroundTruth>) {
        let show = |p| self.context.show(p);
        let in_map = |map: &HdMap| ground_truth_of(walk, map, &self.case.config, &show);
        let map = &self.case.map;
        if withheld.is_empty() {
            return (map.point_count(), in_map(map).map_err(Into::into));
        }
        match map.without_quadrants(withheld, &IndexConfig::default(), &show) {
            Ok(part) => (part.point_count(), in_map(&part).map_err(Into::into)),
            Err(error) => (0, Err(error.into())),
        }
    }

    /// Without a map, and where asked for without loops.
    fn without_maps(
        &self,
        config: &GroundTruthConfig,
        loops_off: bool,
        runs: &mut Runs,
    ) -> anyhow::Result<()> {
        for loops in [true, false] {
            if !loops && !loops_off {
                continue;
            }
            let found = refusal(self.without_map(config, loops), "ground truth")?;
            let name = match loops {
                true => "map0_0",
                false => "map0_0_no_loops",
            };
            let run = Run {
                withheld_quadrants: (0..QUADRANTS).collect(),
                ..self.judged(found, name)?
            };
            let setting = Setting {
                method: Method::Motion,
                map_percent: 0,
                feature: None,
                loops: Some(loops),
            };
            runs.add(setting, run);
        }
        Ok(())
    }

    fn without_map(&self, config: &GroundTruthConfig, loops: bool) -> anyhow::Result<Found> {
        let mut config = MotionConfig {
            adjustment: config.clone(),
            ..MotionConfig::default()
        };
        if !loops {
            config.revisits.view_secs = 0.0;
        }
        let recording = &self.case.recording;
        let rig = recording.rig()?;
        let found = motion_of_recording(recording, &rig, &config, &|p| self.context.show(p))?;
        Ok(Found {
            frames: found.report.frames,
            trajectory: found.trajectory,
        })
    }

    /// Writes a trajectory and judges it.
    fn judged(&self, found: Result<Found, String>, name: &str) -> anyhow::Result<Run> {
        let place = &self.out.join(format!("{}{name}.tum", self.name));
        let mut run = Run {
            walk: self.number,
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
        match evaluate(&self.case.truth.poses, found.trajectory.poses(), &config) {
            Ok(judged) => {
                run.ate_rms_m = Some(judged.ate_translation_m.rmse);
                run.judged_percent =
                    100.0 * judged.matched_poses as f64 / found.trajectory.len().max(1) as f64;
                run.ate_max_m = Some(judged.ate_translation_m.max);
                let is_problem = |f: &Finding| f.verdict != Verdict::Pass;
                run.findings = judged.findings.into_iter().filter(is_problem).collect();
            }
            // Too few of its poses meet the truth.
            Err(why) if why.finding().is_some() => {
                run.refused = Some(format!("evaluation: {why}"));
            }
            Err(why) => return Err(why.into()),
        }
        Ok(run)
    }
}

/// What the images that were localized each by itself say, right or wrong, of those that were looked up.
fn one_by_one(found: &GroundTruth) -> Found {
    let poses = found.localizations.iter().map(|alone| StampedPose {
        time: alone.time,
        world_from_rig: alone.world_from_rig,
    });
    Found {
        trajectory: Trajectory::new(poses.collect()),
        frames: found.report.looked_up,
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
