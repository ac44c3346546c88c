//! Walks, each with its map and its ground truth.

use std::path::{Path, PathBuf};

use anyhow::{bail, ensure};
use lsfb_eval::ablation::Walk;
use lsfb_eval::{ReadOptions, TrajectoryFile, read_trajectory};
use lsfb_pipeline::ground_truth::GroundTruthConfig;
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::Recording;

use crate::commands::models::ModelFolder;
use crate::context::Context;
use crate::files;

/// The files of a walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Named<'a> {
    pub recording: &'a Path,
    pub map: &'a Path,
    pub truth: &'a Path,
}

/// Which map and which ground truth belong to each walk.
pub fn cases<'a>(
    recordings: &'a [PathBuf],
    maps: &'a [PathBuf],
    truths: &'a [PathBuf],
) -> anyhow::Result<Vec<Named<'a>>> {
    for (option, given) in [("--map", maps), ("--truth", truths)] {
        ensure!(
            given.len() == 1 || given.len() == recordings.len(),
            "{} walks and {} {option}: give one for each walk, in the same order, or one for all",
            recordings.len(),
            given.len()
        );
    }
    let of_walk = |given: &'a [PathBuf], k: usize| given.get(k).unwrap_or(&given[0]).as_path();
    let walks = recordings.iter().enumerate();
    Ok(walks
        .map(|(k, recording)| Named {
            recording,
            map: of_walk(maps, k),
            truth: of_walk(truths, k),
        })
        .collect())
}

/// A walk with its map and its ground truth.
pub struct Case {
    pub recording: Recording,
    pub map: HdMap,
    map_path: PathBuf,
    pub truth: TrajectoryFile,
    truth_path: PathBuf,
    /// Settings, with the network that finds the features of the map.
    pub config: GroundTruthConfig,
}

impl Case {
    /// Opens all of it. A map of learned features is refused where their weights are not there.
    pub fn open(
        named: &Named<'_>,
        config: &GroundTruthConfig,
        models: &ModelFolder,
        context: &Context,
    ) -> anyhow::Result<Self> {
        let map = crate::commands::open_map(named.map)?;
        let learned = files::about(named.map, models.learned(map.feature()))?;
        Ok(Self {
            recording: context.open(named.recording)?,
            map,
            map_path: named.map.to_owned(),
            truth: read_trajectory(named.truth, &ReadOptions::default())?,
            truth_path: named.truth.to_owned(),
            config: GroundTruthConfig {
                learned: learned.or_else(|| config.learned.clone()),
                ..config.clone()
            },
        })
    }

    /// Whether both are of one recording, or of copies of one.
    pub fn is_walk_of(&self, other: &Self) -> bool {
        let [own, other] = [self, other].map(|case| case.recording.path());
        files::is_same(own, other) || files::is_copy(own, other)
    }

    pub fn names(&self) -> Walk {
        Walk {
            recording: files::name_of(self.recording.path()),
            truth: files::name_of(&self.truth_path),
            map: files::name_of(&self.map_path),
            feature: self.map.feature().to_string(),
        }
    }
}

/// Refuses a walk that is given twice with maps of one feature: intervals would take it for two.
pub fn expect_each_once(cases: &[Case]) -> anyhow::Result<()> {
    for (k, case) in cases.iter().enumerate() {
        let is_again =
            |other: &&Case| other.map.feature() == case.map.feature() && other.is_walk_of(case);
        if let Some(again) = cases[..k].iter().find(is_again) {
            bail!(
                "{}: the same walk as {}, in a map of the same features ({}): intervals over walks would count it twice",
                case.recording.path().display(),
                again.recording.path().display(),
                case.map.feature()
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_and_ground_truths_belong_to_walks_in_their_order() {
        let paths = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        let (walks, maps) = (paths(&["a", "b"]), paths(&["m"]));
        let truths = paths(&["s", "t"]);
        let found = cases(&walks, &maps, &truths).expect("two walks");
        let named = |recording, truth| Named {
            recording: Path::new(recording),
            map: Path::new("m"),
            truth: Path::new(truth),
        };
        assert_eq!(found, [named("a", "s"), named("b", "t")]);
        let three = paths(&["r", "s", "t"]);
        let refused = cases(&walks, &maps, &three).expect_err("one too many");
        assert!(refused.to_string().contains("3 --truth"), "{refused}");
    }
}
