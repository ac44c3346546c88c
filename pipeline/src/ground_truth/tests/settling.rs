//! Rounds of choosing observations and solving.

use super::*;

/// A walk of which half of the map points that it recognised is not used yet, solved; `rounds` times what is used is chosen anew.
fn unrest_after(rounds: usize) -> Option<GroundTruthWarning> {
    let MadeUp { mut walk, .. } = make_walk(120, 0, |_| true);
    walk.frames.truncate(40);
    let config = GroundTruthConfig::default();
    let start = started(&walk, &config);
    for frame in &mut walk.frames {
        let used = frame.recognised.iter().step_by(2);
        frame.fixed = used.copied().collect();
    }
    let begin = Estimate::of_states(&walk, start.states.clone());
    let first = optimize(&walk, &begin, &[], None, &config, &no_progress).expect("solves");
    let settled = settle(&mut walk, first, &config, rounds, &no_progress).expect("solves");
    let used: usize = walk.frames.iter().map(|f| f.fixed.len()).sum();
    assert_eq!(settled.last.estimate.states.len(), walk.frames.len());
    assert!(used > 0);
    settled.unrest
}

/// Rounds ended without a word while observations still changed.
#[test]
fn what_has_not_settled_is_said_and_what_has_is_not() {
    let unrest = unrest_after(0).expect("half of the points are still to come");
    let GroundTruthWarning::NotAtRest { changing, .. } = unrest else {
        panic!("{unrest:?}");
    };
    assert!(changing > 500, "{changing}");
    let finding = unrest.finding();
    assert_eq!(
        (finding.code.as_ref(), finding.verdict),
        ("not-at-rest", lsfb_types::Verdict::Warn)
    );
    assert!(finding.what.contains(&changing.to_string()), "{finding:?}");
    assert_eq!(unrest_after(ROUNDS), None);
}
