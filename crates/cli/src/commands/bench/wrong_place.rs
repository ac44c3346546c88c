//! `lsfb bench wrong-place`: every walk of a trial in every map of it.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lsfb_geometry::{Se3, UnitQuaternion, Vector3};
use lsfb_pipeline::ground_truth::GroundTruthConfig;
use lsfb_pipeline::hd_map::HdMap;
use lsfb_sim::Place;
use lsfb_types::{Finding, Judgement, Limit, Verdict};
use serde::Serialize;

use super::twin::{OTHER_FLOOR, WRONG_M, refusal};
use crate::commands::groundtruth::WalkJob;
use crate::commands::models::ModelFolder;
use crate::context::Context;
use crate::files;
use crate::judged::{self, Judged};
use crate::outcome::Outcome;
use crate::twin_truth::{judge_scan, judge_walk};

/// Localize every walk of a trial in every map; any pose in another place's map is an error.
///
/// The trial is a folder of `lsfb bench twin --keep-recordings`. In the map of its own place and seed,
/// or of the large office that contains that place, a walk is judged by its truth: a pose more than 10
/// cm off is wrong. For a walk on another floor (--condition other-floor), or in the map of another
/// place or seed, every pose is wrong. Exit code 4: wrong poses were given. Finished parts are not run
/// again. Writes wrong-place.json.
///
/// Examples:
///   lsfb bench twin --out trial --try-out --true-rigs --seeds 2 --condition as-scanned,six-months,other-floor --keep-recordings
///   lsfb bench wrong-place trial --out wrong
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder of the trial.
    #[arg(value_name = "TRIAL")]
    trial: PathBuf,
    /// Folder for trajectories and the result.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Localize walks only in maps of other places, not in their own.
    #[arg(long)]
    only_others: bool,
}

const RESULT: &str = "wrong-place.json";

/// A walk in a map.
#[derive(Serialize)]
struct Placed {
    walk: String,
    map: String,
    /// Whether the map is of the place where the walk was.
    is_own: bool,
    /// Whether it may be in the map: that is of the place, or of one that holds it or lies in it.
    is_one_world: bool,
    frames: u64,
    exported: u64,
    exported_wrong: u64,
    /// What the trajectory comes with.
    warnings: Vec<String>,
    refused: Option<String>,
}

impl Placed {
    fn name(&self) -> String {
        format!("{} in {}", self.walk, self.map)
    }

    fn finding(&self) -> Finding {
        let verdict = match (self.exported_wrong, self.is_own && self.exported == 0) {
            (0, false) => Verdict::Pass,
            (0, true) => Verdict::Warn,
            _ => Verdict::Fail,
        };
        let what = format!(
            "{} poses given, {} wrong",
            self.exported, self.exported_wrong
        );
        Finding::new("exported-wrong", verdict, self.name(), what)
            .value(self.exported_wrong as f64, "")
            .limit(Limit::AtMost(0.0))
    }
}

#[derive(Serialize)]
struct Printed<'a> {
    runs: &'a [Placed],
}

/// Runs what does not stand.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let places = subfolders(&arguments.trial)?;
    let places: Vec<PathBuf> = places
        .into_iter()
        .filter(|p| p.join("map").join(HdMap::HEADER).exists())
        .collect();
    let mut walks = Vec::new();
    for place in &places {
        let of_place = subfolders(place)?.into_iter();
        walks.extend(of_place.filter(|walk| walk.join("walk.mcap").exists()));
    }
    anyhow::ensure!(
        !walks.is_empty(),
        "{}: has no maps and walks: make them with lsfb bench twin --keep-recordings",
        arguments.trial.display()
    );
    context.will_write(&arguments.out);
    std::fs::create_dir_all(&arguments.out)?;
    let result = arguments.out.join(RESULT);
    let mut runs = Vec::new();
    for walk in &walks {
        for place in &places {
            if !arguments.only_others || walk.parent() != Some(place) {
                runs.push(placed(walk, place, &arguments.out, context)?);
                context.note(&line(runs.last()));
            }
        }
    }
    let judgement = Judgement::new(runs.iter().map(Placed::finding).collect());
    let judged_as = format!("{} walks in maps", runs.len());
    let printed = Printed { runs: &runs };
    let judged = Judged::new(&judgement, &judged_as, &printed);
    files::write(&result, serde_json::to_vec_pretty(&judged)?)?;
    context.print(&judged, || {
        let mut text = format!("{}\n", judged.summary);
        for run in &runs {
            let _ = writeln!(text, "{}", line(Some(run)));
        }
        judged::printable(&text)
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

fn line(run: Option<&Placed>) -> String {
    run.map_or(String::new(), |run| {
        let said = match &run.refused {
            Some(why) => format!("refused: {why}"),
            None => run.warnings.join(", "),
        };
        let (exported, wrong) = (run.exported, run.exported_wrong);
        format!("{:<60} {exported:>5} {wrong:>5}  {said}", run.name())
    })
}

/// A walk's folder in the map of a place's folder.
fn placed(walk: &Path, place: &Path, out: &Path, context: &Context) -> anyhow::Result<Placed> {
    let is_own = walk.parent() == Some(place);
    let walk_name = [walk.parent(), Some(walk)].into_iter().flatten();
    let walk_name: Vec<String> = walk_name.map(files::name_of).collect();
    let folder = out.join(files::name_of(place)).join(&walk_name[0]);
    std::fs::create_dir_all(&folder)?;
    let estimate = folder.join(format!("{}.tum", files::name_of(walk)));
    let job = WalkJob {
        recording: &walk.join("walk.mcap"),
        others: &[],
        map: &place.join("map"),
        out: &estimate,
        out_report: None,
        config: &GroundTruthConfig::default(),
        radio: None,
        models: &ModelFolder::new(None),
    };
    let walk_from_map = walk_from_map(&walk_name[0], &files::name_of(place));
    let mut run = Placed {
        walk: walk_name.join("/"),
        map: files::name_of(place),
        is_own,
        is_one_world: is_own || walk_from_map.is_some(),
        frames: 0,
        exported: 0,
        exported_wrong: 0,
        warnings: Vec::new(),
        refused: None,
    };
    match refusal(job.compute(context, |_| Ok(())), "ground truth")? {
        Err(why) => run.refused = Some(why),
        Ok(found) => {
            let report = &found.said.report;
            (run.frames, run.exported) = (report.frames, report.poses);
            run.warnings = found.said.problem_codes();
            run.exported_wrong = match walk_from_map {
                Some(walk_from_map) if !run.walk.ends_with(OTHER_FLOOR) => {
                    wrong_poses(walk, place, &estimate, &walk_from_map)?
                }
                _ => run.exported,
            };
        }
    }
    Ok(run)
}

/// From the world of a map to that of a walk, both folders of a trial, PLACE-SEED, if the two are parts of one world.
fn walk_from_map(walk: &str, map: &str) -> Option<Se3> {
    let named = |name: &str| {
        let (place, seed) = name.rsplit_once('-')?;
        Some((Place::named(place)?, seed.to_owned()))
    };
    let ((walk, of_walk), (map, of_map)) = (named(walk)?, named(map)?);
    let [x, y] = map.origin_in(walk).filter(|_| of_walk == of_map)?;
    Some(Se3::new(
        UnitQuaternion::identity(),
        Vector3::new(x, y, 0.0),
    ))
}

/// Poses of a walk in the map of its own world that are not where the truth has them.
fn wrong_poses(
    walk: &Path,
    place: &Path,
    estimate: &Path,
    walk_from_map: &Se3,
) -> anyhow::Result<u64> {
    let truth = |folder: &Path, name: &str| folder.join("truth").join(name);
    let scan = judge_scan(&truth(place, "truth_scan.tum"), &place.join("scan.tum"))?;
    let judged = judge_walk(
        &truth(walk, "truth_walk.tum"),
        estimate,
        *walk_from_map * scan.truth_from_map,
    )?;
    let errors = judged.in_map.errors.iter();
    Ok(errors.filter(|e| e.translation_m > WRONG_M).count() as u64)
}

/// In order of their names.
fn subfolders(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    use anyhow::Context as _;
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry?.path();
        if path.is_dir() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walks through a part of the large office, in the map of either, counted as wrong though they were centimetres off.
    #[test]
    fn the_parts_of_the_large_office_of_a_seed_lie_in_it() {
        let x_m = |walk, map| walk_from_map(walk, map).map(|from| from.translation.x);
        assert_eq!(x_m("exhibition-hall-21", "large-office-21"), Some(0.0));
        assert_eq!(x_m("exhibition-hall-21", "exhibition-hall-21"), Some(0.0));
        let atrium_m = x_m("large-office-48", "atrium-48").expect("a part");
        assert!((atrium_m - 20.3).abs() < 1e-6, "{atrium_m}");
        assert_eq!(x_m("atrium-48", "large-office-48"), Some(-atrium_m));
        assert_eq!(x_m("exhibition-hall-21", "large-office-22"), None);
        assert_eq!(x_m("exhibition-hall-21", "stairs-21"), None);
        assert_eq!(x_m("medium-office-21", "large-office-21"), None);
        assert_eq!(x_m("kitchen", "large-office-21"), None);
    }
}
