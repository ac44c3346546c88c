use std::collections::BTreeMap;

use super::*;
use crate::survey::{RestConfig, Tape, TapeKind, find_rests, solve_survey};
use lsfb_geometry::{Se3, UnitQuaternion};
use lsfb_types::{Timestamp, Verdict};

/// Marks on an uneven grid: no turn of it looks like itself.
const MARKS: [(&str, f64, f64); 6] = [
    ("p1", 0.0, 0.0),
    ("p2", 1.8, 0.0),
    ("p3", 4.2, 0.0),
    ("q1", 0.0, 2.6),
    ("q2", 1.8, 2.6),
    ("q3", 4.2, 2.6),
];

fn survey(visits: &[&str]) -> Survey {
    let tape = |kind, a: &str, b: &str, distance_m| Tape {
        kind,
        ends: [a.to_owned(), b.to_owned()],
        distance_m,
        sigma_m: 0.001,
    };
    Survey {
        tapes: vec![
            tape(TapeKind::Horizontal, "p1", "p2", 1.8),
            tape(TapeKind::Horizontal, "p2", "p3", 2.4),
            tape(TapeKind::Horizontal, "q1", "q2", 1.8),
            tape(TapeKind::Horizontal, "q2", "q3", 2.4),
            tape(TapeKind::Vertical, "p1", "q1", 2.6),
            tape(TapeKind::Vertical, "p3", "q3", 2.6),
        ],
        line_sigma_m: 0.001,
        visits: visits.iter().map(|v| (*v).to_owned()).collect(),
        points: BTreeMap::new(),
    }
}

/// Rests two seconds at each place of a walk, in a world that is turned; the estimate errs by `error_m` at each.
fn walk(places: &[(f64, f64)], error_m: impl Fn(usize) -> Vector3<f64>) -> Vec<StampedPose> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.7);
    let world = Se3::new(turn, Vector3::new(3.0, -1.0, 1.2));
    let mut poses = Vec::new();
    let mut push = |place: Vector3<f64>, rotation_rad: f64| {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), rotation_rad);
        poses.push(StampedPose {
            time: Timestamp::from_nanos(50_000_000 * poses.len() as i64),
            world_from_rig: world * Se3::new(rotation, place),
        });
    };
    for (k, (x, y)) in places.iter().enumerate() {
        let here = Vector3::new(*x, *y, 0.0) + error_m(k);
        (0..40).for_each(|_| push(here, 0.0));
        // Lifted and carried on.
        (1..40).for_each(|i| {
            let lift = 0.8 * (f64::from(i) / 40.0 * std::f64::consts::PI).sin();
            push(here + Vector3::new(0.3 * lift, 0.0, lift), lift);
        });
    }
    poses
}

fn check(survey: &Survey, poses: &[StampedPose]) -> Result<MarkReport, Error> {
    let solution = solve_survey(survey).expect("determined");
    let rests = find_rests(poses, &RestConfig::default());
    check_marks(survey, &solution, poses, &rests, 0.3)
}

#[test]
fn errors_at_marks_are_those_put_in() {
    let path = [0, 1, 2, 5, 4, 3].map(|i| (MARKS[i].1, MARKS[i].2));
    let visits = [0, 1, 2, 5, 4, 3].map(|i| MARKS[i].0);
    let exact = check(&survey(&visits), &walk(&path, |_| Vector3::zeros())).expect("found");
    assert!(
        exact.ate_m.max < 1e-6 && exact.marks.len() == 6,
        "{exact:?}"
    );
    let bumped = |k| {
        if k == 2 {
            Vector3::new(0.0, 0.0, 0.06)
        } else {
            Vector3::zeros()
        }
    };
    let found = check(&survey(&visits), &walk(&path, bumped)).expect("found");
    assert!(
        found.ate_m.max > 0.02 && found.ate_m.max < 0.06,
        "{found:?}"
    );
    assert_eq!(found.marks[2].mark, "p3");
    assert!(found.missing.is_empty() && found.other_rests == 0);
}

/// A rest beside the marks and a visit without rest: lists side by side would shift by one, and nothing would fit.
#[test]
fn other_rests_and_missing_visits_shift_nothing() {
    let place = |i: usize| (MARKS[i].1, MARKS[i].2);
    let path = [
        (-2.0, -3.0),
        place(0),
        place(1),
        place(5),
        (7.0, 6.0),
        place(3),
    ];
    let visits = ["p1", "p2", "p3", "q3", "q1"];
    let found = check(&survey(&visits), &walk(&path, |_| Vector3::zeros())).expect("found");
    let marks: Vec<&str> = found.marks.iter().map(|m| m.mark.as_str()).collect();
    assert_eq!(marks, ["p1", "p2", "q3", "q1"]);
    assert_eq!(
        (found.other_rests, found.missing.as_slice()),
        (2, &["p3".to_owned()][..])
    );
    assert!(found.ate_m.max < 1e-6);
}

#[test]
fn without_an_order_only_what_is_clear_is_told() {
    let place = |i: usize| (MARKS[i].1, MARKS[i].2);
    let path = [place(4), place(0), place(2), place(1), place(3)];
    let found = check(&survey(&[]), &walk(&path, |_| Vector3::zeros())).expect("clear");
    let marks: Vec<&str> = found.marks.iter().map(|m| m.mark.as_str()).collect();
    assert_eq!(marks, ["q2", "p1", "p3", "p2", "q1"]);
    // The four corners of a rectangle are themselves again after half a turn.
    let corners = [place(0), place(2), place(3), place(5)];
    let unclear = check(&survey(&[]), &walk(&corners, |_| Vector3::zeros())).expect_err("unclear");
    assert!(matches!(unclear, Error::AmbiguousRests { .. }), "{unclear}");
    let none =
        check(&survey(&[]), &walk(&corners[..2], |_| Vector3::zeros())).expect_err("too few");
    assert!(
        matches!(none, Error::TooFewRests { rests: 2, .. }),
        "{none}"
    );
    let mut named = survey(&["p1", "p9", "q1"]);
    named.points.clear();
    let unknown = check(&named, &walk(&corners, |_| Vector3::zeros())).expect_err("no such mark");
    assert!(unknown.to_string().contains("p9"), "{unknown}");
}

/// A dozen marks on an uneven grid; their tapes.
fn hall() -> (Survey, Vec<(String, f64, f64)>) {
    let x = [0.0, 2.1, 5.0, 9.3];
    let y = [0.0, 2.6, 6.1];
    let name = |i: usize, j: usize| format!("m{i}{j}");
    let tape = |kind, a: (usize, usize), b: (usize, usize), distance_m| Tape {
        kind,
        ends: [name(a.0, a.1), name(b.0, b.1)],
        distance_m,
        sigma_m: 0.001,
    };
    let mut tapes = Vec::new();
    for j in 0..3 {
        for i in 1..4 {
            tapes.push(tape(
                TapeKind::Horizontal,
                (i - 1, j),
                (i, j),
                x[i] - x[i - 1],
            ));
        }
    }
    for i in 0..4 {
        for j in 1..3 {
            tapes.push(tape(
                TapeKind::Vertical,
                (i, j - 1),
                (i, j),
                y[j] - y[j - 1],
            ));
        }
    }
    let marks: Vec<_> = (0..12)
        .map(|k| (name(k / 3, k % 3), x[k / 3], y[k % 3]))
        .collect();
    let visits = marks.iter().map(|m| m.0.clone()).collect();
    let survey = Survey {
        tapes,
        line_sigma_m: 0.001,
        visits,
        points: BTreeMap::new(),
    };
    (survey, marks)
}

fn failed(report: &MarkReport) -> Vec<String> {
    let failed = report.findings().into_iter();
    let failed = failed.filter(|f| f.verdict == Verdict::Fail);
    failed.map(|f| f.code.to_string()).collect()
}

/// A trajectory that leaves the floor plan at the far end by more than the reach had the errors of the other marks: 11 of 12, no error,
/// WARN.
#[test]
fn marks_that_the_trajectory_misses_are_no_missing_marks() {
    let (survey, marks) = hall();
    let places: Vec<(f64, f64)> = marks.iter().map(|m| (m.1, m.2)).collect();
    let straight = check(&survey, &walk(&places, |_| Vector3::zeros())).expect("found");
    assert!(failed(&straight).is_empty() && straight.far.is_empty());
    let bent = walk(&places, |k| match k {
        11 => Vector3::new(0.0, 0.6, 0.0),
        _ => Vector3::zeros(),
    });
    for visits in [survey.visits.clone(), Vec::new()] {
        let survey = Survey {
            visits,
            ..survey.clone()
        };
        let found = check(&survey, &bent).expect("found");
        assert_eq!((found.marks.len(), found.far.len()), (11, 1), "{found:?}");
        assert!(found.ate_m.rmse < 0.01);
        let far = &found.far[0];
        assert!(
            far.mark == "m32" && (far.distance_m - 0.6).abs() < 0.01,
            "{far:?}"
        );
        assert_eq!(failed(&found), ["far-marks"]);
    }
    // Marks that were not visited, and a rest elsewhere: nothing is off.
    let mut some = places[..7].to_vec();
    some.push((20.0, 20.0));
    let found = check(&survey, &walk(&some, |_| Vector3::zeros())).expect("found");
    assert!(failed(&found).is_empty() && found.far.is_empty());
    assert_eq!(found.findings()[0].verdict, Verdict::Warn);
}

/// Three marks fit any trajectory to centimetres.
#[test]
fn few_marks_are_no_result() {
    let (survey, marks) = hall();
    let walked = |count: usize| {
        let places: Vec<(f64, f64)> = marks[..count].iter().map(|m| (m.1, m.2)).collect();
        let shaken = |k: usize| Vector3::new(0.05 * (k as f64).sin(), 0.05 * (k as f64).cos(), 0.0);
        check(&survey, &walk(&places, shaken))
    };
    let some = |count: usize| failed(&walked(count).expect("found"));
    walked(3).expect_err("three rests may be any three marks");
    assert_eq!(some(4), ["marks"]);
    assert_eq!(some(5), ["marks"]);
    assert!(some(6).is_empty());
}
