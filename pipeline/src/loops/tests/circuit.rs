//! A walk around an office that comes back to where it began.

use lsfb_types::Verdict;

use super::*;
use crate::odometry::OdometryWarning;

fn drift(_: usize) -> Vector6<f64> {
    // Turns by a quarter of a degree and climbs by 20 cm in 100 m: that is seen where the way ends. Half of what it is long or short by
    // is not, on a way around.
    Vector6::new(0.0, 0.0, 2e-5, 0.000_2, 0.000_1, 0.001)
}

fn sigma() -> Vector6<f64> {
    Vector6::new(3e-5, 3e-5, 1e-4, 0.01, 0.01, 0.01)
}

#[test]
fn what_the_odometry_drifts_on_the_way_around_is_taken_out() {
    let stops = stops(&AROUND, 0.5, 0.0);
    let clouds = seen(&office(), &stops);
    let mut result = walk(&clouds, &stops, drift, &sigma());
    let before_m = worst_m(&result, &stops);
    assert!(before_m > 0.2, "{before_m} m");
    let loops = found(&result);
    let errors = errors_m(&loops, &result, &stops);
    assert!(errors.len() >= 2, "{}", decisions(&loops));
    assert!(errors.iter().all(|e| *e < 0.03), "{errors:?}");
    let sigma_before = result.scan_poses.last().expect("a pose").covariance[(5, 5)];
    let closing = close_loops(&mut result, &loops, &lsfb_types::no_progress).expect("closed");
    assert_eq!(closing.accepted as usize, errors.len());
    // 0.05 % of the path are 5 cm.
    let after_m = worst_m(&result, &stops);
    assert!(after_m < 0.05, "{before_m} m, then {after_m} m");
    // The covariances follow, and hold what is left.
    let last = result.scan_poses.last().expect("a pose");
    assert!(last.covariance[(5, 5)] < 0.2 * sigma_before);
    let truth = stops.last().expect("a stop").world_from_rig;
    let off = last.pose.world_from_rig.local(&truth);
    let squared = off.dot(
        &last
            .covariance
            .cholesky()
            .expect("a covariance")
            .solve(&off),
    );
    assert!(squared < 16.8, "{squared}");
}

/// Loops that the odometry closed itself, by the map that it keeps, change nothing.
#[test]
fn without_drift_nothing_moves() {
    let stops = stops(&AROUND, 0.5, 0.0);
    let clouds = seen(&office(), &stops);
    let mut result = walk(&clouds, &stops, |_| Vector6::zeros(), &sigma());
    let loops = found(&result);
    assert!(loops.accepted().count() >= 2, "{}", decisions(&loops));
    let before = result.clone();
    let closing = close_loops(&mut result, &loops, &lsfb_types::no_progress).expect("closed");
    assert_eq!(closing.moved_m, 0.0);
    assert_eq!(result, before);
}

/// Two of three loops say the same; the third, given by a person's hand in the search's place, would fold the walk.
#[test]
fn one_false_loop_among_true_ones_is_rejected() {
    let stops = stops(&AROUND, 0.5, 0.0);
    let clouds = seen(&office(), &stops);
    let result = walk(&clouds, &stops, drift, &sigma());
    let mut loops = found(&result);
    let first = loops.accepted().next().expect("a loop").clone();
    let time = |k: usize| result.scan_poses[k].pose.time;
    loops.all.push(Loop {
        earlier: time(20),
        later: time(120),
        ..first
    });
    let accepted = loops.accepted().count();
    let keyframes = keyframes::with(&result, &[time(20), time(120)].into());
    closing::reject_disagreeing(&mut loops, &keyframes, &lsfb_types::no_progress).expect("judged");
    let rejected = LoopDecision::Rejected(LoopRejection::ContradictsLoops);
    assert_eq!(loops.all.last().map(|l| l.decision), Some(rejected));
    assert_eq!(loops.accepted().count(), accepted - 1);
}

/// What a person accepts is closed, though it bends the walk; the odometry knew better.
#[test]
fn a_loop_that_contradicts_the_odometry_fails_the_walk() {
    let stops = stops(&AROUND, 0.5, 0.0);
    let clouds = seen(&office(), &stops);
    let mut result = walk(&clouds, &stops, drift, &sigma());
    let mut loops = found(&result);
    let right = {
        let mut closed = result.clone();
        close_loops(&mut closed, &loops, &lsfb_types::no_progress).expect("closed");
        closed.report.warnings
    };
    let is_disagreeing = |w: &&OdometryWarning| matches!(w, OdometryWarning::LoopDisagrees { .. });
    assert_eq!(right.iter().filter(is_disagreeing).count(), 0, "{right:?}");
    let mut first = loops.accepted().next().expect("a loop").clone();
    first.earlier = result.scan_poses[20].pose.time;
    first.later = result.scan_poses[120].pose.time;
    first.scores.odometry_sigmas = Some(60.0);
    loops.all.push(first);
    close_loops(&mut result, &loops, &lsfb_types::no_progress).expect("closed");
    let disagreement = result.report.warnings.iter().find(is_disagreeing);
    let verdict = disagreement.map(|w| w.finding().verdict);
    assert_eq!(verdict, Some(Verdict::Fail));
}
