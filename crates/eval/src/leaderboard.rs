//! Scores of uploaded trajectories against a truth that their authors do not see.

use std::cmp::Ordering;
use std::path::Path;

use lsfb_geometry::{StampedPose, Trajectory};
use lsfb_types::{Finding, Verdict};
use serde::{Deserialize, Serialize};

use crate::alignment::AlignmentMode;
use crate::pairs::PairSelection;
use crate::relation::DeltaUnit;
use crate::{
    Error, EvalConfig, Evaluation, ReadOptions, RpeConfig, TrajectoryFile, evaluate_files,
    read_trajectory,
};

/// Share of the truth that a trajectory must cover to be ranked: errors of the easy part alone compare with nothing.
pub const RANKED_COVERAGE: f64 = 0.9;
/// Poses that are judged at most.
const MAX_POSES: usize = 300_000;
/// Poses at true stamps with which an upload is judged there.
const LEAST_POSES: usize = 3;
/// Figures are given to the millimetre: finer ones would tell the truth bit by bit to who asks often enough.
const STEP_M: f64 = 1e-3;

/// What is said of one upload.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Score {
    /// Error after SE(3) alignment, rms, metres.
    pub ate_se3_m: f64,
    /// Error after Sim(3) alignment, rms, metres; absent where there is none.
    pub ate_sim3_m: Option<f64>,
    /// |1 − s| of the latter, percent.
    pub scale_error_percent: Option<f64>,
    /// Relative error over a metre, rms, metres; absent where none is that long.
    pub rpe_1m_m: Option<f64>,
    /// Share of the truth covered, percent.
    pub covered_percent: f64,
}

/// An upload, as it is kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Submission {
    /// When it came, seconds since 1970.
    pub unix_s: u64,
    /// Who says to have sent it.
    pub team: String,
    /// The sequence.
    pub sequence: String,
    /// What it got.
    pub score: Score,
}

/// Scores a file against the truth, for somebody who must not see the truth: errors say what is wrong with the file alone. It is judged at
/// the true stamps, between its own.
pub fn score(upload: &Path, truth: &TrajectoryFile) -> Result<Score, Error> {
    let estimate = read_trajectory(upload, &ReadOptions::default())?;
    let refuse = |what: String| Error::NotATrajectory {
        path: upload.to_owned(),
        what,
    };
    if estimate.poses.len() > MAX_POSES {
        return Err(refuse(format!(
            "{} poses, but at most {MAX_POSES} are allowed",
            estimate.poses.len()
        )));
    }
    let config = EvalConfig {
        alignment: AlignmentMode::Se3,
        rpe: Vec::new(),
        rpe_where_possible: vec![RpeConfig {
            delta: 1.0,
            unit: DeltaUnit::Metres,
            selection: PairSelection::Consecutive,
        }],
        ..EvalConfig::default()
    };
    let at_truth = at_true_stamps(&truth.poses, &estimate, config.coverage_gap_secs);
    let evaluation = match at_truth.len() {
        // Its own stamps say what is wrong with it.
        ..LEAST_POSES => evaluate_files(truth, &estimate, &config)?,
        _ => {
            let poses = at_truth;
            let judged = TrajectoryFile { poses, ..estimate };
            evaluate_files(truth, &judged, &config)?
        }
    };
    // Who has the truth, or a part of it, needs no leaderboard.
    let is_refused = |f: &&Finding| f.verdict == Verdict::Fail || f.code == "same";
    let failed = evaluation.findings.iter().find(is_refused);
    match failed {
        Some(finding) => Err(refuse(format!("no result: {}", finding.what))),
        None => Ok(of(&evaluation)),
    }
}

/// Poses of an upload at those true stamps that lie between two of its own which are at most `gap_secs` apart. So every true pose counts
/// once: nobody gains by poses that come a hundred times as often where they are good, or with stamps that match nothing where they are not.
fn at_true_stamps(
    truth: &[StampedPose],
    estimate: &TrajectoryFile,
    gap_secs: f64,
) -> Vec<StampedPose> {
    let upload = Trajectory::new(estimate.poses.clone());
    let own = upload.poses();
    let is_between = |truth: &&StampedPose| {
        let next = own.partition_point(|p| p.time < truth.time);
        match (next.checked_sub(1).and_then(|i| own.get(i)), own.get(next)) {
            (_, Some(after)) if after.time == truth.time => true,
            (Some(before), Some(after)) => after.time.secs_since(before.time) <= gap_secs,
            _ => false,
        }
    };
    let at = |truth: &StampedPose| {
        upload.at(truth.time).map(|world_from_rig| StampedPose {
            time: truth.time,
            world_from_rig,
        })
    };
    truth.iter().filter(is_between).filter_map(at).collect()
}

fn of(evaluation: &Evaluation) -> Score {
    let coarse = |value: f64, step: f64| (value / step).round() * step;
    let aligned = |mode: AlignmentMode| {
        let mut all = evaluation.ate_by_alignment.iter();
        let found = all.find(|a| a.alignment == mode.label())?;
        found.rmse_m.map(|rmse_m| coarse(rmse_m, STEP_M))
    };
    let over_a_metre = evaluation
        .rpe
        .first()
        .and_then(|rpe| rpe.translation_m.as_ref());
    Score {
        ate_se3_m: coarse(evaluation.ate_translation_m.rmse, STEP_M),
        ate_sim3_m: aligned(AlignmentMode::Sim3),
        scale_error_percent: evaluation.scale_error_abs_percent.map(|p| coarse(p, 0.01)),
        rpe_1m_m: over_a_metre.map(|rpe| coarse(rpe.rmse, STEP_M)),
        covered_percent: coarse(100.0 * evaluation.coverage.fraction, 0.1),
    }
}

/// A line of the leaderboard: a team's best result on a sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ranked {
    /// From one; absent where too little is covered.
    pub rank: Option<usize>,
    /// The result.
    #[serde(flatten)]
    pub submission: Submission,
}

/// Each team's best result on a sequence, the best first; those that cover too little stand below, without a rank.
pub fn ranking(submissions: &[Submission], sequence: &str) -> Vec<Ranked> {
    let mut best: Vec<&Submission> = Vec::new();
    for submission in submissions.iter().filter(|s| s.sequence == sequence) {
        match best.iter_mut().find(|b| b.team == submission.team) {
            Some(own) if better(submission, own) == Ordering::Less => *own = submission,
            Some(_) => {}
            None => best.push(submission),
        }
    }
    best.sort_by(|a, b| better(a, b));
    let mut rank = 0;
    best.into_iter()
        .map(|submission| {
            rank += 1;
            Ranked {
                rank: is_ranked(submission).then_some(rank),
                submission: submission.clone(),
            }
        })
        .collect()
}

fn is_ranked(submission: &Submission) -> bool {
    submission.score.covered_percent >= 100.0 * RANKED_COVERAGE
}

/// What is ranked before what is not, smaller errors first, earlier ones where they are equal.
fn better(a: &Submission, b: &Submission) -> Ordering {
    let by_rank = is_ranked(b).cmp(&is_ranked(a));
    let by_error = a.score.ate_se3_m.total_cmp(&b.score.ate_se3_m);
    by_rank.then(by_error).then(a.unix_s.cmp(&b.unix_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn submission(team: &str, ate_se3_m: f64, covered_percent: f64, unix_s: u64) -> Submission {
        Submission {
            unix_s,
            team: team.to_owned(),
            sequence: "C3-android".to_owned(),
            score: Score {
                ate_se3_m,
                ate_sim3_m: None,
                scale_error_percent: None,
                rpe_1m_m: None,
                covered_percent,
            },
        }
    }

    /// A truth of a walk in curls, ten poses a second for a minute, and an upload of the times at which `keep` says how far it is off.
    fn scored(keep: impl Fn(f64) -> Option<f64>) -> Result<Score, Error> {
        use std::fmt::Write as _;
        let row = |t: f64, off_m: f64| {
            let (x, y) = ((0.5 * t).sin() * 4.0, (0.31 * t).cos() * 3.0);
            format!("{t:.4} {} {y} {} 0 0 0 1\n", x + off_m, 0.2 * t)
        };
        let folder = tempfile::tempdir().expect("folder");
        let [truth, upload] = ["truth.tum", "upload.tum"].map(|name| folder.path().join(name));
        let true_rows: String = (0..600).map(|i| row(0.1 * f64::from(i), 0.0)).collect();
        std::fs::write(&truth, true_rows).expect("truth");
        let mut rows = String::new();
        for i in 0..600_000 {
            let t = 1e-4 * f64::from(i);
            if let Some(off_m) = keep(t) {
                let _ = write!(rows, "{}", row(t, off_m));
            }
        }
        std::fs::write(&upload, rows).expect("upload");
        let truth = read_trajectory(&truth, &ReadOptions::default()).expect("truth");
        score(&upload, &truth)
    }

    /// A truth that somebody had was the best of all uploads.
    #[test]
    fn the_truth_gets_no_score() {
        let every = |n: f64| move |t: f64| ((t / n) - (t / n).round()).abs() < 1e-6;
        for secs in [0.1, 0.3] {
            let refused = scored(|t| every(secs)(t).then_some(0.0)).expect_err("the truth");
            assert!(refused.to_string().contains("ground truth"), "{refused}");
        }
    }

    /// Lost in the second half, which an upload can hide in two ways: stamps between those of the truth, which match none, and a hundred
    /// times as many poses in the first half.
    #[test]
    fn nobody_hides_where_he_was_lost() {
        let small_m = |t: f64| 0.01 * (5.0 * t).sin();
        let off_m = |t: f64| {
            if t < 30.0 {
                small_m(t)
            } else {
                3.0 * (7.0 * t).sin()
            }
        };
        let each = |t: f64, secs: f64, first: f64| {
            let steps = (t - first) / secs;
            (steps - steps.round()).abs() < 1e-6
        };
        let scored = |keep: &dyn Fn(f64) -> Option<f64>| scored(keep).expect("scored");
        let plain = scored(&|t| each(t, 0.1, 0.0).then(|| off_m(t)));
        assert!(plain.ate_se3_m > 0.5, "{plain:?}");
        let aside = scored(&|t| match t < 30.0 {
            true => each(t, 0.1, 0.0).then(|| small_m(t)),
            false => each(t, 0.1, 0.05).then(|| off_m(t)),
        });
        assert!(aside.ate_se3_m > 0.5 * plain.ate_se3_m, "{aside:?}");
        let is_near = |t: f64| (t - (10.0 * t).round() / 10.0).abs() < 0.0101;
        let weighted = scored(&|t| match t < 2.0 {
            true => (is_near(t) && each(t, 0.001, 0.0)).then(|| small_m(t)),
            false => each(t, 1.0, 0.0).then(|| off_m(t)),
        });
        assert!(weighted.ate_se3_m > 0.5 * plain.ate_se3_m, "{weighted:?}");
        assert!(weighted.covered_percent > 98.0, "{weighted:?}");
    }

    /// Who tracks the first seconds alone has the smallest error of all.
    #[test]
    fn the_easy_part_alone_is_not_ranked() {
        let all = [
            submission("short", 0.001, 20.0, 1),
            submission("whole", 0.05, 99.0, 2),
            submission("whole", 0.03, 99.0, 3),
            submission("later", 0.03, 99.0, 4),
            submission("short", 0.2, 95.0, 5),
        ];
        let board = ranking(&all, "C3-android");
        let seen: Vec<_> = board
            .iter()
            .map(|r| {
                (
                    r.rank,
                    r.submission.team.as_str(),
                    r.submission.score.ate_se3_m,
                )
            })
            .collect();
        assert_eq!(
            seen,
            [
                (Some(1), "whole", 0.03),
                (Some(2), "later", 0.03),
                (Some(3), "short", 0.2),
            ]
        );
        let board = ranking(&all[..2], "C3-android");
        assert_eq!(
            (board[1].rank, board[1].submission.team.as_str()),
            (None, "short")
        );
        assert!(ranking(&all, "C0-android").is_empty());
    }
}
