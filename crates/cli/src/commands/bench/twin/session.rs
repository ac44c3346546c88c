//! The stages of a trial: scan → map, walk → ground truth, from recordings only. The truth is opened to judge, by `eval`.

use std::path::PathBuf;
use std::sync::Arc;

use lsfb_eval::{Smoothness, read_poses};
use lsfb_geometry::{StampedPose, Trajectory, Vector3};
use lsfb_pipeline::ground_truth::GroundTruthConfig;
use lsfb_pipeline::mapping::MappingConfig;
use lsfb_sim::Simulation;
use lsfb_types::{Stopped, median, quantile};

use super::cost::Costs;
use super::judging::{self, Localized};
use super::result::{Run, WRONG_M};
use super::rigs::Calibrated;
use super::trial::{Condition, Light, Scanned, Walked};
use crate::commands::groundtruth::WalkJob;
use crate::commands::map::MapJob;
use crate::commands::models::ModelFolder;
use crate::context::{Context, sentence};
use crate::files;
use crate::simulated::Layout;
use crate::twin_session::Wanted;
use crate::twin_truth::{JudgedScan, consistency_in_map, judge_scan, judge_walk};

/// What a stage gave, or why it refused: part of the result of a trial, where a full disk and Ctrl-C are not.
pub type Refusable<T> = Result<T, String>;

const SCAN: &str = "scan";
const MAP: &str = "map";
const WALK: &str = "walk";
const TRUTH: &str = "ground truth";

/// Stages in the order in which they run; first the calibrations.
pub const STAGES: [&str; 6] = [
    "calibration of the backpack",
    "calibration of the device",
    SCAN,
    MAP,
    WALK,
    TRUTH,
];

/// Tells what an estimator refused from what stops the trial.
pub fn refusal<T>(result: anyhow::Result<T>, stage: &str) -> anyhow::Result<Refusable<T>> {
    match result {
        Ok(value) => Ok(Ok(value)),
        Err(error) => {
            let stops = |cause: &(dyn std::error::Error + 'static)| {
                cause.is::<Stopped>() || cause.is::<std::io::Error>()
            };
            if error.chain().any(stops) {
                return Err(error);
            }
            Ok(Err(format!("{stage}: {}", sentence(&error))))
        }
    }
}

/// A scan with its map.
pub struct Mapped {
    map: PathBuf,
    reprojection_px: f64,
    judged: JudgedScan,
}

/// Where the files of one place and seed lie.
pub struct Session<'a> {
    pub folder: PathBuf,
    pub scanned: Scanned,
    pub light: Light,
    pub context: &'a Context,
}

impl Session<'_> {
    /// Records the scan with a backpack that states `rig`, unless it stands. `last` is as [`Wanted::record`] has it.
    pub fn record_scan(
        &self,
        rig: &Calibrated,
        costs: &mut Costs,
        last: &mut Option<Arc<Simulation>>,
    ) -> anyhow::Result<()> {
        let config = self.light.on(self.scanned.config());
        let wanted = Wanted {
            rig: Some(&rig.rig),
            ..Wanted::scan(&config)
        };
        let layout = Layout::create(&self.folder)?;
        costs.of(SCAN, |made| {
            wanted.record(&layout, self.context, last, || made.set(true))
        })?;
        Ok(())
    }

    /// Records a walk with a device that states `rig`, as [`Session::record_scan`] does.
    pub fn record_walk(
        &self,
        walked: &Walked,
        rig: &Calibrated,
        costs: &mut Costs,
        last: &mut Option<Arc<Simulation>>,
    ) -> anyhow::Result<()> {
        let config = self.light.on(walked.config());
        let wanted = Wanted {
            rig: Some(&rig.rig),
            ..Wanted::walk(&config)
        };
        let layout = Layout::create(&self.walk_folder(walked))?;
        costs.of(WALK, |made| {
            wanted.record(&layout, self.context, last, || made.set(true))
        })?;
        Ok(())
    }

    /// Maps the recorded scan.
    pub fn map(&self, costs: &mut Costs) -> anyhow::Result<Refusable<Mapped>> {
        let layout = Layout::create(&self.folder)?;
        let [recording, _, truth] = Wanted::scan(&self.scanned.config()).files(&layout);
        let (map, trajectory) = (layout.file("map"), layout.file("scan.tum"));
        let job = MapJob {
            recording: &recording,
            out: &map,
            out_trajectory: Some(&trajectory),
            out_report: None,
            start: None,
            clouds: None,
            marks: None,
            config: &MappingConfig::default(),
        };
        let built = costs.of(MAP, |made| {
            job.build(self.context, |_| {
                made.set(true);
                Ok(())
            })
        });
        Ok(match refusal(built, MAP)? {
            Ok(built) => Ok(Mapped {
                map,
                reprojection_px: built.report.reprojection_rms_px,
                judged: judge_scan(&truth, &trajectory)?,
            }),
            Err(why) => Err(why),
        })
    }

    /// Places a recorded walk in the map, and judges it into `run`.
    pub fn walk(
        &self,
        walked: &Walked,
        mapped: &Mapped,
        costs: &mut Costs,
        run: &mut Run,
    ) -> anyhow::Result<()> {
        let layout = Layout::create(&self.walk_folder(walked))?;
        let [recording, _, truth] = Wanted::walk(&walked.config()).files(&layout);
        let estimate = layout.file("walk.tum");
        let job = WalkJob {
            recording: &recording,
            others: &[],
            map: &mapped.map,
            out: &estimate,
            out_report: None,
            config: &GroundTruthConfig::default(),
            radio: None,
            models: &ModelFolder::new(None),
        };
        let found = costs.of(TRUTH, |made| {
            job.compute(self.context, |_| {
                made.set(true);
                Ok(())
            })
        });
        let true_poses = read_poses(&truth)?;
        let scan = &mapped.judged;
        let off_path_m = off_path_m(&scan.truth, &true_poses);
        run.off_path_p10_m = quantile(off_path_m.clone(), 0.1);
        run.off_path_m = median(off_path_m.clone());
        run.off_path_p90_m = quantile(off_path_m, 0.9);
        run.scanner_ate_rms_m = Some(scan.evaluation.ate_translation_m.rmse);
        run.drift_percent = scan.evaluation.rpe.first().and_then(|over| {
            let mean_m = over.translation_m.as_ref()?.mean;
            Some(100.0 * mean_m / over.delta)
        });
        run.reprojection_px = Some(mapped.reprojection_px);
        let whole_s = match (true_poses.first(), true_poses.last()) {
            (Some(first), Some(last)) => last.time.secs_since(first.time),
            _ => 0.0,
        };
        let map = crate::commands::open_map(&mapped.map)?;
        let (walk, true_path) = (self.context.open(&recording)?, Trajectory::new(true_poses));
        let from_map = &scan.truth_from_map;
        let alone = judging::localize(&walk, &map, &true_path, from_map, self.context)?
            .under(walked.condition);
        let Localized { claimed, right, .. } = alone;
        (run.localized, run.localized_right) = (Some(claimed), Some(right));
        run.localized_ate_rms_m = alone.ate_rms_m;
        // Nothing of another floor is in the map.
        let has_map = walked.condition != Condition::OtherFloor;
        let in_view_s = has_map.then_some(whole_s * alone.map_in_view);
        run.map_in_view_s = in_view_s;
        let found = refusal(found, TRUTH)?;
        match found {
            Err(why) => {
                (run.refused, run.dropped_s) = (Some(why), whole_s);
                run.answered_in_view_s = in_view_s.map(|_| 0.0);
            }
            Ok(found) => {
                let solved = &found.trajectory;
                let jitter =
                    judging::jitter(&walk, &map, &true_path, from_map, solved, self.context)?;
                run.jitter_localized_m = jitter.localized_m;
                run.jitter_solved_m = jitter.solved_m;
                let both = jitter.localized_m.zip(jitter.solved_m);
                run.jitter_ratio = both
                    .filter(|(_, solved_m)| *solved_m > 0.0)
                    .map(|(localized_m, solved_m)| localized_m / solved_m);
                let between = judging::between_frames(solved, &true_path);
                run.between_frames_m = between.map(|b| b.translation_m);
                run.between_frames_deg = between.map(|b| b.rotation_deg);
                let answered = judging::answered(solved, &alone.in_view);
                run.answered_in_view_s = in_view_s.map(|secs| secs * answered);
                let report = &found.said.report;
                (run.problem_codes, run.failed) =
                    (found.said.problem_codes(), found.said.is_failed());
                let judged = judge_walk(&truth, &estimate, scan.truth_from_map)?;
                run.ate_rms_m = Some(judged.own.ate_translation_m.rmse);
                run.ate_max_m = Some(judged.own.ate_translation_m.max);
                run.in_map_rms_m = Some(judged.in_map.ate_translation_m.rmse);
                let covariances = files::beside(&estimate, "covariance");
                let honest = consistency_in_map(&truth, &covariances, scan.truth_from_map)?;
                run.within_95 = honest.map(|found| found.within_95);
                let shaking = |s: &Option<Smoothness>| s.as_ref().and_then(|s| s.above_5_hz_rms_m);
                let smoothness = &judged.own.smoothness;
                let both = shaking(&smoothness.estimate).zip(shaking(&smoothness.truth));
                run.jitter_m = both.map(|(own, real)| (own * own - real * real).max(0.0).sqrt());
                // What is no number is no right pose.
                let wrong = |e: &&lsfb_eval::PoseError| !(e.translation_m <= WRONG_M);
                run.exported = judged.in_map.errors.len() as u64;
                run.exported_wrong = match walked.condition {
                    // Wherever it is on the mapped floor, it is not there.
                    Condition::OtherFloor => run.exported,
                    _ => judged.in_map.errors.iter().filter(wrong).count() as u64,
                };
                let left_out = report.frames.saturating_sub(report.poses);
                run.dropped_s = whole_s * left_out as f64 / report.frames.max(1) as f64;
            }
        }
        Ok(())
    }

    /// The folder of a walk.
    pub fn walk_folder(&self, walked: &Walked) -> PathBuf {
        let (device, condition) = (walked.device.name(), walked.condition.name());
        self.folder.join(format!("{device}-{condition}"))
    }
}

/// Horizontal distances of a walk from the scanner's path on the same storey, metres.
fn off_path_m(scan: &[StampedPose], walk: &[StampedPose]) -> Vec<f64> {
    /// Of two hundred poses a second, ten are enough.
    const EVERY: usize = 20;
    /// Whoever is on another storey is further up or down than this, however high devices are held, metres.
    const STOREY_M: f64 = 1.5;
    let place = |pose: &StampedPose| pose.world_from_rig.translation;
    let scanned: Vec<_> = scan.iter().step_by(EVERY).map(place).collect();
    let of = |at: Vector3<f64>| {
        let beside = scanned
            .iter()
            .filter(|other| (other.z - at.z).abs() < STOREY_M);
        let apart = beside.map(|other| (other.x - at.x).hypot(other.y - at.y));
        apart.fold(f64::INFINITY, f64::min)
    };
    let distances = walk.iter().step_by(EVERY).map(place).map(of);
    distances.filter(|off_m| off_m.is_finite()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disk that is full says nothing about an estimator.
    #[test]
    fn what_stops_a_trial_is_no_refusal() {
        let few = lsfb_pipeline::Refusal::TooFewScans { scans: 1 };
        let few = anyhow::Error::new(lsfb_pipeline::Error::from(few)).context("scan.mcap");
        let refused = refusal::<()>(Err(few), MAP).expect("goes on");
        let why = refused.expect_err("refused");
        assert!(
            why.starts_with("map: scan.mcap: 1 scans are too few"),
            "{why}"
        );
        for cause in [
            anyhow::Error::new(Stopped).context("mapping"),
            anyhow::Error::new(std::io::Error::other("disk full")).context("mapping"),
        ] {
            assert!(refusal::<()>(Err(cause), MAP).is_err());
        }
    }
}
