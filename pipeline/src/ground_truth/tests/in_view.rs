//! A place that is built like the mapped one.

use lsfb_types::Verdict;

use super::super::in_view::InView;
use super::recorded::{Measured, Paint, WALK_FRAMES, map, rig, run};
use super::*;

/// Half of what is on the walls of the other floor is what is on the mapped one's: all images are found there, agree with the IMU, and lie
/// where halves of the map say; its poses came out with 1 mm and no warning.
#[test]
fn another_floor_that_is_built_alike_is_refused() {
    let map = map(1);
    let folder = tempfile::tempdir().expect("folder");
    let walked = |paint: Paint| {
        let path = folder.path().join("walk.mcap");
        Measured::in_room(paint, WALK_FRAMES).record(&path, &rig());
        run(&path, &map)
    };
    let here = walked(Paint::of(1)).expect("the mapped floor").report;
    assert!(here.points_in_view > 200, "{}", here.points_in_view);
    assert!(here.absent_share < 0.01, "{}", here.absent_share);
    assert!(here.place_checked);
    let verdict = |place_checked| {
        let report = GroundTruthReport {
            place_checked,
            absent_share: 0.0,
            ..here.clone()
        };
        let findings = report.findings();
        let found = findings.iter().find(|f| f.code == "points-in-view");
        found.map(|f| f.verdict)
    };
    assert_eq!(verdict(true), Some(Verdict::Pass));
    assert_eq!(verdict(false), Some(Verdict::Unknown), "not conclusive");
    let error = walked(Paint::other_floor(1)).expect_err("another floor");
    assert!(
        matches!(error, Error::Refused(Refusal::PointsAbsent { .. })),
        "{error}"
    );
}

/// Stretches of the made-up walk in which so much says that points are there and absent, of which a cell says 3 at most, and which frames
/// are left out for it.
fn left_out(counts: &[(usize, usize)]) -> Vec<(i64, i64)> {
    let stretches = counts.iter().map(|&(there, absent)| InView {
        points: there + absent,
        there: there as f64,
        absent: absent as f64,
        most_absent: absent.min(3) as f64,
        ..InView::default()
    });
    left_out_of(stretches.collect())
}

/// The same of stretches of equal length.
fn left_out_of(mut in_view: Vec<InView>) -> Vec<(i64, i64)> {
    let MadeUp { mut walk, .. } = make_walk(20, 20, |_| true);
    for frame in &mut walk.frames {
        frame.fixed = frame.recognised.clone();
    }
    let each = FRAMES / in_view.len();
    for (k, stretch) in in_view.iter_mut().enumerate() {
        stretch.frames = k * each..(k + 1) * each;
    }
    let accepted = [true; FRAMES];
    let spans = spans_left_out(&walk, &accepted, &in_view);
    assert!(
        spans
            .iter()
            .all(|s| s.reason == LeftOutReason::PointsAbsent)
    );
    spans.iter().map(|s| (s.from_ns, s.to_ns)).collect()
}

/// The IMU leads from one stretch to the next: where the first is on another floor, so is the second, in which too little was to be seen.
#[test]
fn a_stretch_that_cannot_be_judged_is_where_the_rest_of_the_walk_is() {
    let whole = (0, 9_900_000_000);
    assert_eq!(left_out(&[(100, 5), (10, 0)]), []);
    assert_eq!(left_out(&[(30, 70), (100, 5)]), [(0, 4_900_000_000)]);
    assert_eq!(left_out(&[(30, 70), (10, 0)]), [whole]);
    assert_eq!(left_out(&[(0, 12), (0, 12)]), [whole]);
    assert_eq!(left_out(&[(0, 30)]), [whole], "few, but all of them");
    assert_eq!(left_out(&[(9, 3)]), [], "one cell of points proves nothing");
}

/// In ten seconds of a walk of 574 s through an office two of fifteen cells of points were not found again, in front of surfaces that were.
#[test]
fn two_things_that_have_gone_are_no_other_place_while_the_walk_goes_on() {
    let right = (100, 0);
    assert_eq!(left_out(&[right, (100, 10), right]), []);
    assert_eq!(left_out(&[(100, 10)]), [(0, 9_900_000_000)], "by itself");
    let middle = (3_300_000_000, 6_500_000_000);
    assert_eq!(left_out(&[right, (60, 40), right]), [middle]);
}

/// Ten seconds in which all is seen through are elsewhere; beside enough that is there it was so little that it said nothing.
#[test]
fn a_stretch_that_shows_another_place_is_not_excused_by_those_beside_it() {
    let right = InView {
        there: 120.0,
        ..InView::default()
    };
    let elsewhere = InView {
        seen_through: 60.0,
        ..InView::default()
    };
    let middle = (3_300_000_000, 6_500_000_000);
    assert_eq!(left_out_of(vec![right.clone(), elsewhere, right]), [middle]);
}
