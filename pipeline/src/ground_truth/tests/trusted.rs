//! Which poses are given.

use super::super::report::LeftOutReason;
use super::*;

/// Frames left out of ten seconds in which the map is not seen from the third to the seventh, but in some frames.
fn left_out(seen_in: std::ops::Range<usize>, localized: bool) -> Vec<(i64, i64)> {
    let MadeUp { mut walk, .. } = make_walk(20, 20, |_| true);
    let points = walk.frames[0].recognised.clone();
    let mut accepted = vec![true; FRAMES];
    for (k, frame) in walk.frames.iter_mut().enumerate() {
        let is_seen = !(30..70).contains(&k) || seen_in.contains(&k);
        if is_seen {
            frame.fixed.clone_from(&points);
        }
        accepted[k] = is_seen && (localized || !seen_in.contains(&k));
        if !accepted[k] {
            frame.localized = None;
        }
    }
    let spans = spans_left_out(&walk, &accepted, &[]);
    assert!(
        spans
            .iter()
            .all(|s| s.reason == LeftOutReason::NotRecognised)
    );
    spans.iter().map(|s| (s.from_ns, s.to_ns)).collect()
}

/// Four seconds are too long for the IMU; half of them are not.
#[test]
fn points_that_one_frame_sees_by_chance_make_no_two_bridges_of_one() {
    let all = [(3_000_000_000, 6_900_000_000)];
    assert_eq!(left_out(0..0, false), all);
    assert_eq!(left_out(50..51, false), all, "nobody knows where it is");
    assert_eq!(left_out(50..51, true), []);
    assert_eq!(left_out(48..53, false), [], "not by chance for so long");
}
