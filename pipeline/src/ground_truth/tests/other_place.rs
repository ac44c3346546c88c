//! A room that looks the same from its other end.

use super::recorded::{
    Measured, Paint, WALK_FRAMES, beside_the_walk, frame_time, map_along, render, rig, run,
};
use super::*;
use crate::features::{FeatureDetector, FrameFeatures, SiftConfig};
use crate::hd_map::HdMap;
use crate::localization::{
    Elsewhere, Localizer, LocalizerConfig, PlacedFrame, find_elsewhere, localize_near,
};

/// A map of both ends of a room, the walk at one of them.
fn map_of_both_ends(room: Paint, sift: &FeatureDetector) -> HdMap {
    let here = beside_the_walk();
    let other_end = here.iter().map(|pose| half_a_turn() * *pose);
    let poses: Vec<Se3> = here.iter().copied().chain(other_end).collect();
    map_along(room, &poses, sift)
}

/// What becomes of a walk in such a map.
fn walked(room: Paint) -> Result<GroundTruth, Error> {
    let sift = FeatureDetector::sift(&SiftConfig::default()).expect("valid");
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    Measured::in_room(room, WALK_FRAMES).record(&path, &rig());
    run(&path, &map_of_both_ends(room, &sift))
}

/// Where else the walk through a room may be, in a map of all of it.
fn elsewhere(room: Paint) -> Option<Elsewhere> {
    let sift = FeatureDetector::sift(&SiftConfig::default()).expect("valid");
    let map = map_of_both_ends(room, &sift);
    let rig = rig();
    let instants: Vec<(Se3, Vec<FrameFeatures>)> = [1, 6, 11]
        .map(|k| {
            let pose = truth(frame_time(k));
            let frames = rig.cameras.iter().map(|(name, camera)| FrameFeatures {
                camera: name.clone(),
                features: sift.clone().detect(&render(room, camera, &pose)),
            });
            (pose, frames.collect())
        })
        .into();
    let placed: Vec<PlacedFrame> = instants
        .iter()
        .map(|(pose, features)| PlacedFrame {
            features,
            world_from_rig: *pose,
        })
        .collect();
    let localizer = Localizer::new(&map, &LocalizerConfig::default()).expect("localizer");
    find_elsewhere(&localizer, &rig, &placed).into_iter().next()
}

fn half_a_turn() -> Se3 {
    Se3::exp(&lsfb_geometry::Vector6::new(
        0.0,
        0.0,
        std::f64::consts::PI,
        0.0,
        0.0,
        0.0,
    ))
}

/// In a corridor with four equal doors every image of two phones was found at the wrong end, 14 m away: nothing else was wrong with the walk.
#[test]
fn a_walk_fits_a_room_that_is_the_same_from_its_other_end_there_too() {
    let found = elsewhere(Paint::same_turned(3)).expect("another place");
    let off = half_a_turn().inverse() * found.there_from_here;
    assert!(off.log().norm() < 0.05, "{found:?}");
    let (here, there) = (found.matches_here, found.matches_there);
    assert!(here > 100 && 2 * there > here, "{found:?}");
}

#[test]
fn a_walk_fits_a_room_of_many_things_nowhere_else() {
    let found = elsewhere(Paint::of(3));
    let is_alike = |found: &Elsewhere| 4 * found.matches_there > found.matches_here;
    assert!(!found.as_ref().is_some_and(is_alike), "{found:?}");
}

/// Nothing that was seen tells the ends apart, and each image by itself knows.
#[test]
fn a_walk_that_may_be_at_either_end_is_refused() {
    let error = walked(Paint::same_turned(3)).expect_err("either end");
    assert!(
        matches!(
            error,
            Error::Refused(Refusal::NotLocalized { localized: 0, .. })
        ),
        "{error}"
    );
}

/// What tells them apart is what the map has at the other one, and the walk does not see: how much it has in common with it does not matter.
#[test]
fn an_end_that_is_half_alike_is_excluded_by_what_is_not_there() {
    let report = walked(Paint::half_alike_turned(3))
        .expect("this end")
        .report;
    let other = report.other_place.expect("much of it is alike");
    assert!(
        other.turn_deg > 175.0 && other.matches_there > 50,
        "{other:?}"
    );
    assert!(
        other.is_excluded && other.absent_share_there > 0.2,
        "{other:?}"
    );
    assert!(!other.is_possible(f64::INFINITY));
    assert!(report.absent_share < 0.01, "{}", report.absent_share);
}

/// A walk that was found at the wrong end is looked for at the other one.
#[test]
fn an_instant_is_found_at_whichever_end_it_is_looked_for() {
    let room = Paint::half_alike_turned(3);
    let sift = FeatureDetector::sift(&SiftConfig::default()).expect("valid");
    let map = map_of_both_ends(room, &sift);
    let rig = rig();
    let localizer = Localizer::new(&map, &LocalizerConfig::default()).expect("localizer");
    let pose = truth(frame_time(6));
    let frames = rig.cameras.iter().map(|(name, camera)| FrameFeatures {
        camera: name.clone(),
        features: sift.clone().detect(&render(room, camera, &pose)),
    });
    let frames: Vec<FrameFeatures> = frames.collect();
    for right in [pose, half_a_turn() * pose] {
        let beside = right * Se3::exp(&[0.01, 0.0, 0.01, 0.05, 0.0, -0.05].into());
        let found = localize_near(&localizer, &rig, &frames, &beside).expect("some of it is there");
        let off = right.inverse() * found.world_from_rig;
        assert!(off.log().norm() < 0.02, "{}", off.log());
    }
    let nowhere = pose * Se3::exp(&[0.0, 0.0, 1.5, 0.0, 0.0, 0.0].into());
    assert!(localize_near(&localizer, &rig, &frames, &nowhere).is_none());
}
