//! A place that is built like the mapped one.

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
    assert!(
        20 * here.points_absent < here.points_in_view,
        "{}",
        here.points_absent
    );
    let error = walked(Paint::other_floor(1)).expect_err("another floor");
    assert!(matches!(error, Error::PointsAbsent { .. }), "{error}");
}
