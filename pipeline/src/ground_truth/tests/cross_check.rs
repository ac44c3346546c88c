//! Parts of the map that lie wrongly together.

use super::super::cross_check::{HalvesCheck, check_halves};
use super::*;

struct Checked {
    walk: Walk,
    states: Vec<FrameState>,
    covariances: Vec<Option<Matrix6<f64>>>,
    halves: Vec<HalvesCheck>,
}

impl Checked {
    fn disagreements_m(&self) -> Vec<f64> {
        self.halves.iter().map(|h| h.disagreement_m).collect()
    }
}

/// A walk in a map whose points beyond the middle of the room are all off by as much, along the wall.
fn checked(off_m: f64) -> Checked {
    let MadeUp { mut walk, features } = make_walk(220, 220, |_| true);
    for frame in &mut walk.frames {
        for seen in &mut frame.recognised {
            if seen.point_in_world.x > 0.0 {
                seen.point_in_world.y += off_m;
            }
        }
    }
    let config = GroundTruthConfig::default();
    let start = started(&walk, &config);
    let solved = solve_walk(&mut walk, &start, &features, &config, &no_progress).expect("solves");
    let (estimate, points) = (&solved.last.estimate, &solved.last.points);
    let uncertainty = uncertainty(&walk, estimate, points, &config, &no_progress);
    let halves = check_halves(&walk, estimate, points, &config, &no_progress);
    Checked {
        states: estimate.states.clone(),
        covariances: uncertainty.expect("covariances").poses,
        halves: halves.expect("checks"),
        walk,
    }
}

#[test]
fn halves_of_a_good_map_agree() {
    let good = checked(0.0);
    let worst = good.disagreements_m().into_iter().fold(0.0, f64::max);
    assert!(worst < 0.01, "{worst} m");
    assert!(errors(&good.walk, &good.states).worst_m < 0.006);
}

/// The residuals are small and so is the standard deviation that follows from them: each point is taken to err on its own.
#[test]
fn half_a_map_that_lies_wrongly_is_noticed() {
    let bent = checked(0.1);
    let worst = errors(&bent.walk, &bent.states).worst_m;
    assert!(worst > 0.03, "{worst} m");
    let config = GroundTruthConfig {
        max_disagreement_m: 0.05,
        ..GroundTruthConfig::default()
    };
    let left_out = |disagreements_m: &[f64]| {
        let found = Solution {
            states: &bent.states,
            accepted: &[true; FRAMES],
            covariances: &bent.covariances,
            disagreements_m,
            in_view: &[],
        };
        trusted(&bent.walk, &found, &config).left_out
    };
    assert_eq!(left_out(&[0.0; FRAMES]), [], "σ alone sees nothing");
    let spans = left_out(&bent.disagreements_m());
    let reasons: Vec<LeftOutReason> = spans.iter().map(|span| span.reason).collect();
    assert!(
        reasons.contains(&LeftOutReason::MapPartsDisagree),
        "{:?}",
        bent.disagreements_m()
    );
}
