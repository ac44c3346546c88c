use super::*;
use crate::Threshold;
use crate::pairs::{PairSelection, RpeConfig};
use crate::relation::DeltaUnit;
use lsfb_geometry::{Se3, UnitQuaternion, Vector3, Vector6};
use lsfb_types::{Timestamp, Verdict};

const STEP_NANOS: i64 = 100_000_000;

/// A rising curl, ten poses per second.
pub(super) fn curl(count: i64) -> Vec<StampedPose> {
    (0..count)
        .map(|i| {
            let t = i as f64 * 0.1;
            StampedPose {
                time: Timestamp::from_nanos(i * STEP_NANOS),
                world_from_rig: Se3::exp(&Vector6::new(0.1 * t, 0.05, 0.3 * t, 0.0, 0.0, 0.0))
                    * Se3::new(
                        Default::default(),
                        Vector3::new(2.0 + 0.3 * t, 0.1 * t, t.sin()),
                    ),
            }
        })
        .collect()
}

pub(super) fn changed(
    poses: &[StampedPose],
    change: impl Fn(usize, &mut StampedPose),
) -> Vec<StampedPose> {
    let mut poses = poses.to_vec();
    for (i, pose) in poses.iter_mut().enumerate() {
        change(i, pose);
    }
    poses
}

#[test]
fn alignment_takes_away_what_it_says() {
    let truth = curl(100);
    let shift = Se3::exp(&Vector6::new(0.3, -0.2, 0.9, 4.0, -7.0, 2.0));
    let estimate = changed(&truth, |_, p| {
        p.world_from_rig = shift * p.world_from_rig;
        p.world_from_rig.translation *= 0.8;
    });
    let rmse = |alignment| {
        let config = EvalConfig {
            alignment,
            ..EvalConfig::default()
        };
        evaluate(&truth, &estimate, &config).expect("valid")
    };
    let sim3 = rmse(AlignmentMode::Sim3);
    assert!(sim3.ate_translation_m.max < 1e-9 && sim3.ate_rotation_deg.expect("known").max < 1e-6);
    assert!((sim3.alignment_scale - 1.25).abs() < 1e-12);
    assert!((sim3.scale_error_percent.expect("curved") + 20.0).abs() < 1e-9);
    assert!(
        sim3.rpe[0].translation_m.expect("known").max < 1e-9
            && sim3.rpe[0].rotation_deg.expect("known").max < 1e-6
    );
    assert!(rmse(AlignmentMode::Se3).ate_translation_m.rmse > 0.1);
    assert!(rmse(AlignmentMode::None).ate_translation_m.rmse > 3.0);
    let origin = rmse(AlignmentMode::Origin);
    assert!(
        origin.errors[0].translation_m < 1e-12
            && origin.ate_rotation_deg.expect("known").max < 1e-6
    );

    let unscaled = changed(&truth, |_, p| p.world_from_rig = shift * p.world_from_rig);
    let config = EvalConfig {
        alignment: AlignmentMode::Given(shift.inverse()),
        ..EvalConfig::default()
    };
    let given = evaluate(&truth, &unscaled, &config).expect("valid");
    assert!(
        given.ate_translation_m.max < 1e-12,
        "{:?}",
        given.ate_translation_m
    );
    let end = given
        .aligned_estimate
        .poses()
        .last()
        .expect("poses")
        .world_from_rig
        .translation;
    assert!((end - truth[99].world_from_rig.translation).norm() < 1e-12);
}

#[test]
fn another_unit_of_length_is_noticed() {
    let truth = curl(100);
    for (times, unit) in [
        (1000.0, Some("millimetres")),
        (0.001, Some("kilometres")),
        (1.1, None),
    ] {
        let estimate = changed(&truth, |_, p| p.world_from_rig.translation *= times);
        let config = EvalConfig {
            rpe: Vec::new(),
            ..EvalConfig::default()
        };
        let found = evaluate(&truth, &estimate, &config).expect("valid");
        let said = found.findings.iter().find(|f| f.code == "unit");
        assert_eq!(said.is_some(), unit.is_some(), "{said:?}");
        if let (Some(said), Some(unit)) = (said, unit) {
            assert!(said.what.contains(unit), "{said:?}");
        }
    }
}

#[test]
fn seconds_equal_frames_where_poses_are_evenly_timed() {
    let truth = curl(300);
    let estimate = changed(&truth, |i, p| {
        p.world_from_rig.translation.x += 0.01 * (i as f64).sin()
    });
    let figures = |delta, unit, selection| {
        let rpe = vec![RpeConfig {
            delta,
            unit,
            selection,
        }];
        evaluate(
            &truth,
            &estimate,
            &EvalConfig {
                rpe,
                ..EvalConfig::default()
            },
        )
        .expect("valid")
        .rpe[0]
    };
    for selection in [PairSelection::Consecutive, PairSelection::All] {
        let frames = figures(7.0, DeltaUnit::Frames, selection);
        let seconds = figures(0.7, DeltaUnit::Seconds, selection);
        assert_eq!(
            frames.distance_m.count,
            if selection == PairSelection::All {
                293
            } else {
                42
            }
        );
        // All pairs at the very end reach for the last pose, which is at most a tenth too near.
        assert_eq!(frames.translation_m, seconds.translation_m);
        assert_eq!(frames.rotation_deg, seconds.rotation_deg);
    }
}

#[test]
fn what_is_judged_nowhere_is_not_covered() {
    let truth = curl(100);
    // Lost from the sixth second on, with stamps between those of the truth.
    let lost = changed(&truth, |i, p| {
        if i >= 50 {
            p.time = p.time.plus_secs(0.05);
            p.world_from_rig.translation.x += 3.0 * (i as f64).sin();
        }
    });
    let found = evaluate(&truth, &lost, &EvalConfig::default()).expect("valid");
    assert_eq!(found.matched_poses, 50);
    // Up to a second behind the last that is judged.
    assert_eq!(found.coverage.fraction, 0.6);
    assert!(found.recall[0].of_truth <= 0.6);
}

#[test]
fn coverage_knows_gaps_and_ends() {
    let truth = curl(100);
    let mut estimate = truth.clone();
    estimate.drain(40..60);
    estimate.truncate(60);
    let found = evaluate(&truth, &estimate, &EvalConfig::default()).expect("valid");
    assert_eq!((found.matched_poses, found.coverage.fraction), (60, 0.6));
    assert!((found.coverage.longest_gap_secs - 2.1).abs() < 1e-12);
    let wide = EvalConfig {
        coverage_gap_secs: 3.0,
        ..EvalConfig::default()
    };
    assert_eq!(
        evaluate(&truth, &estimate, &wide)
            .expect("valid")
            .coverage
            .fraction,
        0.8
    );
}

#[test]
fn refuses_bad_input_and_says_why() {
    let truth = curl(50);
    let refused = |truth: &[StampedPose], estimate: &[StampedPose], config: &EvalConfig| {
        evaluate(truth, estimate, config)
            .expect_err("bad input")
            .to_string()
    };
    let default = EvalConfig::default();
    assert_eq!(
        refused(&[], &truth, &default),
        "truth trajectory: it has no pose: check the program that wrote it"
    );
    assert_eq!(
        refused(&truth, &[], &default),
        "estimate trajectory: it has no pose: check the program that wrote it"
    );

    let nan = changed(&truth, |i, p| {
        if i == 3 {
            p.world_from_rig.translation.z = f64::NAN
        }
    });
    assert_eq!(
        refused(&truth, &nan, &default),
        "estimate trajectory: pose 3 (t = 0.300000000 s) is not finite: leave it out"
    );

    let mut reordered = truth.clone();
    reordered.swap(7, 8);
    assert!(refused(&truth, &reordered, &default).contains("pose 8 (t = 0.700000000 s) is older"));

    let late = changed(&truth, |_, p| p.time = p.time.plus_secs(100.0));
    assert!(refused(&truth, &late, &default).contains("no pose of the estimate is within 0.01 s"));

    assert_eq!(
        refused(&truth, &truth[..2], &default),
        "only 2 poses match, too few for alignment and statistics (at least 3): give trajectories of the same walk that overlap more"
    );

    let line = changed(&truth, |i, p| {
        p.world_from_rig.translation = Vector3::new(i as f64, 0.0, 0.0)
    });
    assert!(refused(&line, &line, &default).contains("on one line"));

    let still = EvalConfig {
        alignment: AlignmentMode::None,
        ..EvalConfig::default()
    };
    assert!(
        refused(&truth, &truth[..3], &still).contains("no two of 3 matched poses are 1 m apart")
    );
}

#[test]
fn duplicates_count_or_are_refused() {
    let truth = curl(50);
    let mut estimate = truth.clone();
    estimate.insert(10, estimate[10]);
    estimate.insert(30, estimate[30]);
    let found = evaluate(&truth, &estimate, &EvalConfig::default()).expect("kept");
    assert_eq!(found.duplicate_stamps, 2);
    let config = EvalConfig {
        duplicates: DuplicateStamps::Refuse,
        ..EvalConfig::default()
    };
    let error = evaluate(&truth, &estimate, &config)
        .expect_err("refused")
        .to_string();
    assert!(
        error.contains("2 stamps occur twice, first at t = 1.000000000 s"),
        "{error}"
    );
}

#[test]
fn json_has_every_figure_and_no_lists() {
    let truth = curl(100);
    let estimate = changed(&truth, |i, p| {
        p.world_from_rig.translation.x += 0.01 * (i as f64).sin();
    });
    let found = evaluate(&truth, &estimate, &EvalConfig::default()).expect("valid");
    let json = serde_json::to_value(&found).expect("serializable");
    assert_eq!(json["matched_poses"], 100);
    assert_eq!(json["alignment"], "SE(3)");
    assert_eq!(
        json["ate_translation_m"]["rmse"],
        found.ate_translation_m.rmse
    );
    assert_eq!(json["rpe"][0]["delta_unit"], "metres");
    assert_eq!(json["rpe"][0]["selection"], "consecutive");
    assert!(json["scale_error_percent"].is_f64() && json["coverage"]["fraction"] == 1.0);
    assert!(json.get("errors").is_none() && json.get("aligned_estimate").is_none());
    let text = serde_json::to_string(&found).expect("serializable");
    assert!(!text.contains("null"), "{text}");
}

/// Both worlds know gravity: what is left after yaw is what a wrong tilt is hidden by in SE(3).
#[test]
fn yaw_takes_away_heading_alone() {
    let truth = curl(100);
    let by = |turn: Vector3<f64>| {
        let shift = Se3::exp(&Vector6::new(turn.x, turn.y, turn.z, 4.0, -7.0, 2.0));
        let estimate = changed(&truth, |_, p| p.world_from_rig = shift * p.world_from_rig);
        let config = EvalConfig {
            alignment: AlignmentMode::Yaw,
            ..EvalConfig::default()
        };
        evaluate(&truth, &estimate, &config).expect("valid")
    };
    for heading_rad in [0.0, 0.9, -2.5, 3.1] {
        let found = by(Vector3::new(0.0, 0.0, heading_rad));
        assert!(found.ate_translation_m.max < 1e-12, "{heading_rad}");
        assert!(found.ate_rotation_deg.expect("known").max < 1e-6);
    }
    let tilted = by(Vector3::new(0.05, 0.0, 0.4));
    assert!(tilted.ate_translation_m.rmse > 0.01);
    let of = |name| tilted.ate_by_alignment.iter().find(|a| a.alignment == name);
    assert!(of("SE(3)").and_then(|a| a.rmse_m).expect("exists") < 1e-9);
    assert_eq!(
        of("yaw").and_then(|a| a.rmse_m),
        Some(tilted.ate_translation_m.rmse)
    );
    let rising = changed(&truth, |i, p| {
        p.world_from_rig.translation = Vector3::new(0.0, 0.0, i as f64);
    });
    let config = EvalConfig {
        alignment: AlignmentMode::Yaw,
        ..EvalConfig::default()
    };
    let refused = evaluate(&rising, &rising, &config).expect_err("not determine a heading");
    assert!(refused.to_string().contains("do not move horizontally"));
}

/// A file of positions has the identity for rotations: naive figures of rotations would look like an estimate's.
#[test]
fn positions_are_judged_without_rotations() {
    let truth = curl(100);
    let file = |poses: &[StampedPose], orientations| TrajectoryFile {
        poses: poses.to_vec(),
        orientations,
        ..TrajectoryFile::of_poses(Vec::new())
    };
    let estimate = changed(&truth, |_, p| {
        p.world_from_rig.rotation = Default::default()
    });
    let (known, missing) = (Orientations::Known, Orientations::Missing);
    for pair in [[known, missing], [missing, known], [missing, missing]] {
        let files = (file(&truth, pair[0]), file(&estimate, pair[1]));
        let found = evaluate_files(&files.0, &files.1, &EvalConfig::default()).expect("valid");
        assert!(found.ate_translation_m.max < 1e-9);
        assert!(found.ate_rotation_deg.is_none() && found.recall.is_empty());
        assert!(found.rpe[0].rotation_deg.is_none() && found.rpe[0].translation_m.is_none());
        assert!(found.rpe[0].distance_m.max < 1e-9);
        let text = serde_json::to_string(&found).expect("serializable");
        assert!(
            !text.contains("null") && !text.contains("rotation_deg"),
            "{text}"
        );
        for refused in [
            EvalConfig {
                alignment: AlignmentMode::Origin,
                ..EvalConfig::default()
            },
            EvalConfig {
                rpe: vec![RpeConfig {
                    delta: 5.0,
                    unit: DeltaUnit::Degrees,
                    selection: PairSelection::Consecutive,
                }],
                ..EvalConfig::default()
            },
        ] {
            let why = evaluate_files(&files.0, &files.1, &refused).expect_err("positions only");
            assert!(matches!(why, Error::NeedsOrientation { .. }));
        }
    }
}

#[test]
fn what_nobody_asked_for_is_left_out() {
    let truth = curl(100);
    let config = EvalConfig {
        rpe: Vec::new(),
        rpe_where_possible: [1.0, 1000.0]
            .map(|delta| RpeConfig {
                delta,
                unit: DeltaUnit::Seconds,
                selection: PairSelection::Consecutive,
            })
            .to_vec(),
        ..EvalConfig::default()
    };
    let found = evaluate(&truth, &truth, &config).expect("valid");
    assert_eq!(found.rpe.len(), 1);
    let left_out = found
        .findings
        .iter()
        .find(|f| f.code == "rpe")
        .expect("said");
    assert!(left_out.what.contains("1000 s apart"));
}

/// A truth that is constant (a topic that froze, a column that is none) with an estimate that walks: metres of error, and nothing was said.
#[test]
fn a_truth_that_does_not_move_is_told() {
    let walk = curl(100);
    let still = changed(&walk, |_, p| p.world_from_rig = walk[7].world_from_rig);
    let config = EvalConfig {
        alignment: AlignmentMode::None,
        rpe: Vec::new(),
        ..EvalConfig::default()
    };
    let told = |truth: &[StampedPose], estimate: &[StampedPose]| {
        let found = evaluate(truth, estimate, &config).expect("valid");
        let follows = found.findings.into_iter().find(|f| f.code == "follows");
        follows.map(|f| f.verdict)
    };
    for estimate in [&walk, &still] {
        assert_eq!(told(&still, estimate), Some(Verdict::Warn));
    }
    assert_eq!(told(&walk, &walk), Some(Verdict::Pass));
}

/// A run that was lost for 20 s, and keyframes: pairs across gaps counted as "per 1 s" and "per 1 m", and nothing said so.
#[test]
fn relative_errors_across_gaps_are_left_out_or_told() {
    let truth = curl(600);
    let all = changed(&truth, |i, p| {
        p.world_from_rig.translation.x += 0.01 * (i as f64).sin()
    });
    let config = EvalConfig {
        rpe: Vec::new(),
        rpe_where_possible: [DeltaUnit::Metres, DeltaUnit::Seconds]
            .map(|unit| RpeConfig {
                delta: 1.0,
                unit,
                selection: PairSelection::Consecutive,
            })
            .to_vec(),
        ..EvalConfig::default()
    };
    let judged = |estimate: &[StampedPose]| evaluate(&truth, estimate, &config).expect("valid");
    let told = |found: &Evaluation| -> Vec<String> {
        let pairs = found.findings.iter().filter(|f| f.code == "rpe-pairs");
        pairs.map(|f| f.subject.clone()).collect()
    };
    let per = |unit: &str| format!("relative error per 1 {unit}");
    // The walk is slow enough for pairs of a metre at first, and poses of 10 Hz are seconds.
    let whole = judged(&all[..100]);
    assert_eq!(
        (whole.rpe[1].left_out_pairs, whole.rpe[1].long_pairs),
        (0, 0)
    );
    assert!(!told(&whole).contains(&per("s")), "{:?}", told(&whole));
    let mut lost = all.clone();
    lost.drain(200..400);
    let lost = judged(&lost);
    let seconds = lost.rpe[1];
    assert_eq!((seconds.left_out_pairs, seconds.long_pairs), (1, 0));
    assert!((seconds.longest_delta - 1.0).abs() < 1e-9, "{seconds:?}");
    assert!(lost.rpe[0].longest_delta > 5.0, "{:?}", lost.rpe[0]);
    assert_eq!(told(&lost), [per("m"), per("s")]);
    // Every three seconds: none is a second long, and those per metre are longer.
    let keyframes: Vec<StampedPose> = all.iter().step_by(30).copied().collect();
    let keyframes = judged(&keyframes);
    assert_eq!(keyframes.rpe.len(), 1);
    assert_eq!(told(&keyframes), [per("m")]);
    assert!(keyframes.findings.iter().any(|f| f.code == "rpe"));
}

#[test]
fn degenerate_walks_are_refused_or_remarked() {
    let truth = curl(50);
    let none = EvalConfig {
        alignment: AlignmentMode::None,
        rpe: Vec::new(),
        ..EvalConfig::default()
    };
    let two = evaluate(&truth, &truth[..2], &none).expect_err("two poses");
    assert!(two.to_string().contains("only 2 poses match"));
    let moment = vec![truth[3]; 5];
    let refused = evaluate(&moment, &moment, &none).expect_err("the same time");
    assert!(
        refused
            .to_string()
            .contains("all matched poses have the same time")
    );
    let still = changed(&truth, |_, p| p.world_from_rig = Se3::identity());
    let config = EvalConfig {
        rpe: Vec::new(),
        ..EvalConfig::default()
    };
    let refused = evaluate(&still, &still, &config).expect_err("no extent");
    assert!(matches!(refused, Error::Degenerate));
    // Nearly on a line: an answer there is, and a warning.
    let corridor = changed(&truth, |i, p| {
        p.world_from_rig.translation =
            Vector3::new(i as f64, 0.001 * (i % 3) as f64, 0.001 * (i % 5) as f64);
    });
    let found = evaluate(&corridor, &corridor, &config).expect("valid");
    assert!(found.findings.iter().any(|f| f.code == "line"));
    let text = serde_json::to_string(&found).expect("serializable");
    assert!(!text.contains("null"), "{text}");
}

#[test]
fn recall_counts_what_is_missing() {
    let truth = curl(100);
    let estimate = changed(&truth[..50], |i, p| {
        if i >= 25 {
            p.world_from_rig.translation.x += 0.5;
        }
    });
    let config = EvalConfig {
        alignment: AlignmentMode::None,
        ..EvalConfig::default()
    };
    let found = evaluate(&truth, &estimate, &config).expect("valid");
    let fine = found.recall[0];
    assert_eq!(fine.threshold, Threshold::USUAL[0]);
    assert_eq!((fine.of_matched, fine.of_truth), (0.5, 0.25));
    assert_eq!(found.recall[1].of_truth, 0.5);
    assert_eq!(found.coverage.missing_end_secs, 5.0);
}

/// Sums of twelve even numbers are normal enough.
fn standard_normal(i: usize) -> f64 {
    let even = |k: usize| ((12 * i + k) as f64 * 12.9898).sin() * 43_758.545;
    (0..12).map(|k| even(k).rem_euclid(1.0)).sum::<f64>() - 6.0
}

/// A nearly straight metre with errors of a millimetre and a fiftieth of a degree: positions leave the turn about it open, orientations do not.
#[test]
fn orientations_of_a_short_walk_are_not_judged_by_an_alignment_of_positions() {
    let truth: Vec<StampedPose> = (0..1000)
        .map(|i| StampedPose {
            time: Timestamp::from_nanos(i * 100_000_000),
            world_from_rig: Se3::new(
                UnitQuaternion::identity(),
                Vector3::new(
                    0.001 * i as f64,
                    0.002 * (0.3 * i as f64).sin(),
                    0.002 * (0.2 * i as f64).cos(),
                ),
            ),
        })
        .collect();
    let sigma = [3e-4, 3e-4, 3e-4, 1e-3, 1e-3, 1e-3];
    let estimate = changed(&truth, |i, p| {
        let delta = Vector6::from_fn(|k, _| sigma[k] * standard_normal(6 * i + k));
        p.world_from_rig = p.world_from_rig.retract(&delta);
    });
    let covariance = Matrix6::from_diagonal(&Vector6::from(sigma.map(|s| s * s)));
    let nees = |alignment, factor: f64| {
        let estimate = TrajectoryFile {
            covariances: vec![covariance * factor; 1000],
            ..TrajectoryFile::of_poses(estimate.clone())
        };
        let config = EvalConfig {
            alignment,
            ..EvalConfig::default()
        };
        let truth = TrajectoryFile::of_poses(truth.clone());
        let found = evaluate_files(&truth, &estimate, &config).expect("valid");
        found.consistency.expect("tried").nees_mean
    };
    for alignment in [AlignmentMode::Se3, AlignmentMode::Sim3] {
        let right = nees(alignment, 1.0);
        assert!((right - 6.0).abs() < 0.5, "{right}");
        assert!(nees(alignment, 0.1) > 50.0);
    }
}

/// Errors drawn from the covariance that is stated: the mean of NEES is its six degrees of freedom.
#[test]
fn covariances_are_tried() {
    let truth = curl(4000);
    let sigma = [0.02, 0.01, 0.03, 0.2, 0.1, 0.05];
    let estimate = changed(&truth, |i, p| {
        let delta = Vector6::from_fn(|k, _| sigma[k] * standard_normal(6 * i + k));
        p.world_from_rig = p.world_from_rig.retract(&delta);
    });
    let covariance = Matrix6::from_diagonal(&Vector6::from(sigma.map(|s| s * s)));
    let tried = |covariances: Vec<Matrix6<f64>>| {
        let file = |poses: &[StampedPose], covariances| TrajectoryFile {
            covariances,
            ..TrajectoryFile::of_poses(poses.to_vec())
        };
        let estimate = file(&estimate, covariances);
        let config = EvalConfig {
            alignment: AlignmentMode::None,
            ..EvalConfig::default()
        };
        let found = evaluate_files(&file(&truth, Vec::new()), &estimate, &config).expect("valid");
        let remark = |code: &str| found.findings.iter().find(|f| f.code == code).cloned();
        let remarks = [remark("consistency"), remark("bad-covariances")];
        (found.consistency, remarks)
    };
    let all = |covariance: Matrix6<f64>| {
        let (found, [remark, _]) = tried(vec![covariance; 4000]);
        (found.expect("tried"), remark.expect("said"))
    };
    let judged = |factor: f64| all(covariance * factor);
    let (right, remark) = judged(1.0);
    assert!((right.nees_mean - 6.0).abs() < 0.3, "{right:?}");
    assert!((right.within_95 - 0.95).abs() < 0.02, "{right:?}");
    assert_eq!(remark.verdict, Verdict::Pass);
    let (boastful, remark) = judged(0.1);
    assert!((boastful.nees_mean / right.nees_mean - 10.0).abs() < 1e-9);
    assert_eq!(remark.verdict, Verdict::Warn);
    assert_eq!(right.bad_covariances, 0);
    // One part in another unit: the other alone keeps the whole between 1.5 and 12.
    let parts = |rotation: f64, translation: f64| {
        let scale = [
            rotation,
            rotation,
            rotation,
            translation,
            translation,
            translation,
        ];
        let scale = Matrix6::from_diagonal(&Vector6::from(scale));
        let (found, remark) = all(scale * covariance * scale);
        assert!((2.5..4.0).contains(&found.nees_mean), "{found:?}");
        assert_eq!(remark.verdict, Verdict::Warn);
        remark.what
    };
    let in_degrees = parts(180.0 / std::f64::consts::PI, 1.0);
    assert!(
        in_degrees.contains("for rotation errors it may be in square degrees"),
        "{in_degrees}"
    );
    let in_centimetres = parts(1.0, 100.0);
    assert!(
        in_centimetres.contains("square centimetres"),
        "{in_centimetres}"
    );
    // What is none is said to be none.
    let (found, [_, bad]) = tried((0..4000).map(|i| covariance * f64::from(i % 4)).collect());
    assert_eq!(found.expect("tried").bad_covariances, 1000);
    assert!(
        bad.expect("said")
            .what
            .starts_with("1000 of 4000 covariances are not positive definite")
    );
    let (found, [remark, _]) = tried(vec![Matrix6::zeros(); 4000]);
    assert_eq!(
        (found, remark.expect("said").verdict),
        (None, Verdict::Unknown)
    );
}

#[test]
fn an_estimate_of_another_walk_fails() {
    let truth = curl(100);
    let verdict = |estimate: &[StampedPose]| {
        let found = evaluate(&truth, estimate, &EvalConfig::default()).expect("valid");
        let finding = found.findings.into_iter().find(|f| f.code == "follows");
        finding.expect("judged").verdict
    };
    // Of another size and with errors as large as a poor odometry's it is still an estimate of this walk.
    let small = changed(&truth, |i, p| {
        p.world_from_rig.translation *= 0.1;
        p.world_from_rig.translation.x += 0.02 * (i as f64).sin();
    });
    assert_eq!(verdict(&small), Verdict::Pass);
    // Of a walk in a circle, or of noise, it is none.
    let circle = changed(&truth, |i, p| {
        let (y, x) = (0.4 * i as f64).sin_cos();
        p.world_from_rig.translation = Vector3::new(3.0 * x, 3.0 * y, 0.0);
    });
    assert_eq!(verdict(&circle), Verdict::Fail);
    let noise = changed(&truth, |i, p| {
        let at = |k: f64| (k * i as f64 * i as f64).sin();
        p.world_from_rig.translation = Vector3::new(at(1.3), at(2.7), at(0.9));
    });
    assert_eq!(verdict(&noise), Verdict::Fail);
}

/// An error of zero is no achievement, also where the copy was moved, scaled and rounded.
#[test]
fn the_truth_is_no_estimate() {
    let truth = curl(100);
    let is_named = |estimate: &[StampedPose]| {
        let found = evaluate(&truth, estimate, &EvalConfig::default()).expect("valid");
        found.findings.iter().any(|f| f.code == "same")
    };
    assert!(is_named(&truth));
    let moved = changed(&truth, |_, p| {
        let place = p.world_from_rig.translation * 1.7 + Vector3::new(3.0, -2.0, 1.0);
        p.world_from_rig.translation = place.map(|v| (v * 1e7).round() * 1e-7);
    });
    assert!(is_named(&moved));
    let near = changed(&truth, |i, p| {
        p.world_from_rig.translation.x += 1e-5 * (7.0 * i as f64).sin();
    });
    assert!(!is_named(&near));
    // With three digits its error is half a millimetre: as good as any estimate's.
    let rounded = |size: f64, off_m: f64| {
        changed(&truth, |i, p| {
            let off = Vector3::repeat(off_m * (7.0 * i as f64).sin());
            let place = p.world_from_rig.translation + off;
            p.world_from_rig.translation = place.map(|v| (v * size).round() / size);
        })
    };
    assert!(is_named(&rounded(1e3, 0.0)) && is_named(&rounded(1e2, 0.0)));
    assert!(
        !is_named(&rounded(1e3, 2e-4)),
        "an estimate with few digits"
    );
    // In the coordinates of a map of a country, where a number has no more than nine digits behind the point.
    let far = |p: &mut StampedPose| p.world_from_rig.translation += Vector3::repeat(5e6);
    let far_truth = changed(&truth, |_, p| far(p));
    let far_off = changed(&truth, |i, p| {
        far(p);
        p.world_from_rig.translation.x += 0.02 * (7.0 * i as f64).sin();
    });
    let found = evaluate(&far_truth, &far_off, &EvalConfig::default()).expect("valid");
    assert!(found.findings.iter().all(|f| f.code != "same"));
    // A third of it is the truth's.
    let mixed = changed(&truth, |i, p| {
        p.world_from_rig.translation.y += if i % 3 == 0 { 0.0 } else { 0.02 };
    });
    assert!(is_named(&mixed));
}

/// Seven stamps of two recordings are alike: an alignment brings any two walks so near to each other there.
#[test]
fn few_shared_poses_are_no_result() {
    let truth = curl(500);
    let shifted = changed(&truth, |i, p| {
        p.time = p.time.plus_secs(49.3);
        p.world_from_rig.translation = Vector3::new(0.05 * i as f64, 0.02 * (i as f64).sin(), 0.0);
    });
    let config = EvalConfig {
        rpe: Vec::new(),
        ..EvalConfig::default()
    };
    let judged =
        |estimate: &[StampedPose]| evaluate(&truth, estimate, &config).expect("figures there are");
    let verdict = |found: &Evaluation, code: &str| {
        let finding = found.findings.iter().find(|f| f.code == code);
        finding.map(|f| f.verdict)
    };
    let found = judged(&shifted);
    assert_eq!(found.matched_poses, 7);
    assert_eq!(verdict(&found, "matches"), Some(Verdict::Fail));
    assert_eq!(verdict(&found, "few-poses"), Some(Verdict::Fail));
    assert_eq!(verdict(&found, "follows"), None);
    assert!(found.no_result().is_some());
    // All of seven keyframes match, and are too few all the same.
    let keyframes: Vec<StampedPose> = truth.iter().step_by(80).copied().collect();
    let found = judged(&keyframes);
    assert_eq!(verdict(&found, "matches"), Some(Verdict::Pass));
    assert_eq!(verdict(&found, "few-poses"), Some(Verdict::Fail));
    let twenty: Vec<StampedPose> = truth.iter().step_by(25).copied().collect();
    let found = judged(&twenty);
    assert_eq!(verdict(&found, "few-poses"), None);
    assert!(found.no_result().is_none());
}

/// Two people on two straight ways, each at a speed of its own: after alignment both are one.
#[test]
fn a_straight_walk_is_like_any_other() {
    let sway = |t: f64| Vector3::new(0.05 * (1.1 * t).sin(), 0.03 * (2.3 * t).cos(), 0.0);
    let straight = |place: &dyn Fn(f64) -> Vector3<f64>| -> Vec<StampedPose> {
        changed(&curl(200), |i, p| {
            p.world_from_rig.translation = place(0.1 * i as f64);
        })
    };
    let truth = straight(&|t| Vector3::new(1.2 * t, 0.0, 0.0) + sway(t));
    let config = EvalConfig {
        rpe: Vec::new(),
        ..EvalConfig::default()
    };
    let verdict = |estimate: &[StampedPose]| {
        let found = evaluate(&truth, estimate, &config).expect("valid");
        let finding = found.findings.into_iter().find(|f| f.code == "follows");
        finding.expect("judged").verdict
    };
    let other = straight(&|t| Vector3::new(0.0, 0.9 * t, 0.0) - sway(1.7 * t + 2.0));
    assert_eq!(verdict(&other), Verdict::Warn);
    let same = straight(&|t| Vector3::new(1.2 * t, 0.0, 0.0) + sway(t) * 1.1);
    assert_eq!(verdict(&same), Verdict::Pass);
}

#[test]
fn coming_back_from_a_gap_has_its_cost() {
    let truth = curl(100);
    let mut estimate = changed(&truth, |i, p| {
        if i >= 60 {
            p.world_from_rig.translation.x += 0.25;
        }
    });
    estimate.drain(40..60);
    let config = EvalConfig {
        alignment: AlignmentMode::None,
        ..EvalConfig::default()
    };
    let found = evaluate(&truth, &estimate, &config).expect("valid");
    let [only] = found.relocalizations[..] else {
        panic!("{:?}", found.relocalizations);
    };
    assert!((only.gap_secs - 2.1).abs() < 1e-9);
    assert!((only.back_after_secs - 6.0).abs() < 1e-9);
    assert!((only.error_change_m.expect("matched") - 0.25).abs() < 1e-9);
    // A break that is no loss is none.
    assert!(
        evaluate(&truth, &truth, &config)
            .expect("valid")
            .relocalizations
            .is_empty()
    );
}

/// Squares of 1e200 are infinite, and the table said `inf` with exit code 0.
#[test]
fn positions_that_no_walk_has_are_refused() {
    let truth = curl(100);
    let far = changed(&truth, |_, p| p.world_from_rig.translation *= 1e200);
    let config = EvalConfig {
        alignment: AlignmentMode::None,
        ..EvalConfig::default()
    };
    for (truth, estimate) in [(&truth, &far), (&far, &truth)] {
        let said = evaluate(truth, estimate, &config).expect_err("refused");
        assert!(matches!(said, Error::TooFar { .. }), "{said}");
    }
}

/// KITTI's rows were judged as if they came once a second, and those of other frames beside each other, without a word.
#[test]
fn rows_without_stamps_are_told() {
    let folder = tempfile::tempdir().expect("folder");
    let read = |first: i64| {
        let row = |i: i64| {
            let (y, x) = (0.1 * i as f64).sin_cos();
            format!("1 0 0 {} 0 1 0 {} 0 0 1 {}\n", 3.0 * x, 3.0 * y, 0.02 * x)
        };
        let path = folder.path().join("poses.txt");
        let text: String = (first..100).map(row).collect();
        std::fs::write(&path, text).expect("written");
        crate::read_trajectory(&path, &crate::ReadOptions::default()).expect("poses")
    };
    let verdicts = |estimate: &TrajectoryFile| -> Vec<Verdict> {
        let found = evaluate_files(&read(0), estimate, &EvalConfig::default()).expect("judged");
        let told = found.findings.iter().filter(|f| f.code == "no-stamps");
        told.map(|f| f.verdict).collect()
    };
    assert_eq!(verdicts(&read(0)), [Verdict::Warn; 2]);
    let other_frames = verdicts(&read(5));
    assert_eq!(other_frames, [Verdict::Warn, Verdict::Warn, Verdict::Fail]);
}
