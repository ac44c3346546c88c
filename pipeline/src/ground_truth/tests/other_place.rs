//! A room that looks the same from its other end.

use super::recorded::{Paint, beside_the_walk, frame_time, map_along, render, rig};
use super::*;
use crate::features::{FeatureDetector, FrameFeatures, SiftConfig};
use crate::localization::{Elsewhere, Localizer, LocalizerConfig, PlacedFrame, find_elsewhere};

/// Where else the walk through a room may be, in a map of all of it.
fn elsewhere(room: Paint) -> Option<Elsewhere> {
    let sift = FeatureDetector::sift(&SiftConfig::default()).expect("valid");
    let here = beside_the_walk();
    let other_end = here.iter().map(|pose| half_a_turn() * *pose);
    let poses: Vec<Se3> = here.iter().copied().chain(other_end).collect();
    let map = map_along(room, &poses, &sift);
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
    find_elsewhere(&localizer, &rig, &placed)
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
    let is_alike = found.is_some_and(|found| 4 * found.matches_there > found.matches_here);
    assert!(!is_alike, "{found:?}");
}
