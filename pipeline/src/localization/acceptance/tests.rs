use super::*;

#[test]
fn a_place_that_looks_the_same_makes_a_pose_doubtful() {
    let sure = Evidence {
        first_matches: 300,
        first_inliers: 90,
        chance_level: 0.001,
        log10_false_alarms: -120.0,
        known_decades: 0.0,
        guided_inliers: 200,
        decoy_inliers: 12.0,
        image_spread: 0.6,
        first_spread: 0.6,
        focal_scale: 1.0,
        focal_log_sigma: 0.01,
        focal_decades: 0.0,
        log10_false_alarms_mirrored: 3.0,
        decades_together: decades_together(&Feature::Sift),
        rival_inliers: 0,
        twin_inliers: 0,
    };
    assert!(sure.probability() > 0.999);
    let with_rival = |rival_inliers| Evidence {
        rival_inliers,
        ..sure
    };
    assert!(with_rival(85).probability() < 0.6);
    assert!(with_rival(25).probability() > 0.99);
    // As many inliers as ever after guided matching, but none that was not searched for.
    let searched = Evidence {
        first_inliers: 3,
        log10_false_alarms: 6.0,
        decoy_inliers: 60.0,
        image_spread: 0.1,
        first_spread: 0.1,
        ..sure
    };
    assert!(searched.probability() < 1e-3);
}

#[test]
fn another_focal_length_must_fit_for_sure() {
    let as_calibrated = Evidence {
        first_matches: 300,
        first_inliers: 90,
        chance_level: 0.001,
        log10_false_alarms: -120.0,
        known_decades: 0.0,
        guided_inliers: 200,
        decoy_inliers: 12.0,
        image_spread: 0.6,
        first_spread: 0.6,
        focal_scale: 1.02,
        focal_log_sigma: 0.003,
        focal_decades: 30.0,
        log10_false_alarms_mirrored: 3.0,
        decades_together: 0.075,
        rival_inliers: 0,
        twin_inliers: 0,
    };
    assert!(!as_calibrated.contradicts_focal_length());
    // Half-size images in a frame have 200 guided inliers and all else that makes a pose probable.
    let resized = Evidence {
        focal_scale: 0.5,
        ..as_calibrated
    };
    assert!(resized.probability() > 0.99 && resized.contradicts_focal_length());
    let (unsure, no_better) = (
        Evidence {
            focal_log_sigma: 0.3,
            focal_decades: 10.0,
            ..resized
        },
        Evidence {
            focal_decades: 1.0,
            ..resized
        },
    );
    assert!(!unsure.contradicts_focal_length() && !no_better.contradicts_focal_length());
    // An image of the office with a focal length a tenth off, 15 cm off itself: its matches hardly say by how much, but that they do.
    let a_tenth_off = Evidence {
        focal_scale: 0.927,
        focal_log_sigma: 0.069,
        focal_decades: 16.9,
        ..as_calibrated
    };
    assert!(a_tenth_off.contradicts_focal_length());
}

#[test]
fn what_looks_alike_in_a_mirror_is_no_place() {
    // A mirrored image with XFeat: 22 of 300 first matches agree.
    let mirrored = Evidence {
        first_matches: 300,
        first_inliers: 22,
        chance_level: 0.001,
        log10_false_alarms: -18.0,
        known_decades: 0.0,
        guided_inliers: 53,
        decoy_inliers: 6.0,
        image_spread: 0.35,
        first_spread: 0.35,
        focal_scale: 1.0,
        focal_log_sigma: 0.03,
        focal_decades: 0.0,
        log10_false_alarms_mirrored: 3.0,
        decades_together: 0.075,
        rival_inliers: 0,
        twin_inliers: 0,
    };
    assert!(mirrored.probability() < 0.95);
    let alone = Evidence {
        log10_false_alarms: -190.0,
        ..mirrored
    };
    assert!(alone.probability() > 0.99);
    let explained = Evidence {
        log10_false_alarms_mirrored: -300.0,
        ..alone
    };
    assert!(explained.probability() < 0.01);
}

#[test]
fn a_picture_that_hangs_in_another_room_is_no_place() {
    // The demo's walk of seed 12 in the map of seed 11: a picture agrees, nothing around it does, and points are found all over by chance.
    let picture = Evidence {
        first_matches: 504,
        first_inliers: 40,
        chance_level: 2e-4,
        log10_false_alarms: -68.1,
        known_decades: 0.0,
        guided_inliers: 363,
        decoy_inliers: 170.8,
        image_spread: 0.42,
        first_spread: 0.133,
        focal_scale: 1.0,
        focal_log_sigma: 0.02,
        focal_decades: 0.0,
        log10_false_alarms_mirrored: 6.3,
        decades_together: decades_together(&Feature::Sift),
        rival_inliers: 0,
        twin_inliers: 0,
    };
    assert!(picture.probability() < 0.9);
    // The kitchen of 7-Scenes, 2.8 cm off: few agree, but all over the image.
    let scattered = Evidence {
        first_matches: 371,
        first_inliers: 34,
        log10_false_alarms: -42.6,
        guided_inliers: 126,
        decoy_inliers: 41.6,
        image_spread: 0.97,
        first_spread: 0.72,
        ..picture
    };
    assert!(scattered.probability() > 0.99);
}

#[test]
fn a_door_that_is_the_same_at_either_end_is_no_place() {
    // A bare corridor of the standard trial, seed 46, from its other end: hardly anything is in the image but the door.
    let door = Evidence {
        first_matches: 18,
        first_inliers: 10,
        chance_level: 0.002,
        log10_false_alarms: -15.3,
        known_decades: 0.0,
        guided_inliers: 18,
        decoy_inliers: 0.59,
        image_spread: 0.45,
        first_spread: 0.40,
        focal_scale: 1.0,
        focal_log_sigma: 0.02,
        focal_decades: 0.0,
        log10_false_alarms_mirrored: -2.3,
        decades_together: decades_together(&Feature::Sift),
        rival_inliers: 0,
        twin_inliers: 0,
    };
    assert!(door.probability() < 0.97);
    // Up is the same at the other end, where one was a moment ago is not.
    let known = |known_decades| Evidence {
        known_decades,
        ..door
    };
    assert!(known(-2.0).probability() < 0.97);
    assert!(known(-4.0).probability() > 0.99);
    // The office with a tenth of its features, 1 cm off.
    let thinned = Evidence {
        first_matches: 59,
        first_inliers: 15,
        log10_false_alarms: -23.3,
        guided_inliers: 26,
        decoy_inliers: 5.99,
        image_spread: 0.52,
        log10_false_alarms_mirrored: 1.0,
        ..door
    };
    assert!(thinned.probability() > 0.99);
}

#[test]
fn a_corridor_that_is_the_same_from_either_end_is_no_place() {
    // The same corridor with another seed: whole walks were found at the wrong end, by first matches that no pose at the right one had.
    let end = Evidence {
        first_matches: 60,
        first_inliers: 25,
        chance_level: 0.002,
        log10_false_alarms: -40.0,
        known_decades: 0.0,
        guided_inliers: 40,
        decoy_inliers: 1.0,
        image_spread: 0.45,
        first_spread: 0.40,
        focal_scale: 1.0,
        focal_log_sigma: 0.02,
        focal_decades: 0.0,
        log10_false_alarms_mirrored: 1.0,
        decades_together: decades_together(&Feature::Sift),
        rival_inliers: 0,
        twin_inliers: 0,
    };
    assert!(end.is_thin() && end.probability() > 0.99);
    let with_twin = |twin_inliers| Evidence {
        twin_inliers,
        ..end
    };
    for of_40 in [33, 38, 55] {
        let twin = with_twin(of_40);
        assert!(twin.probability() < 0.98 && twin.is_doubtful_by_twin());
    }
    let chance = with_twin(16);
    assert!(chance.probability() > 0.99 && !chance.is_doubtful_by_twin());
}

#[test]
fn spread_is_that_of_an_even_distribution() {
    let grid: Vec<Vector2<f64>> = (0..6400)
        .map(|i| Vector2::new(f64::from(i % 80) * 8.0, f64::from(i / 80) * 6.0))
        .collect();
    assert!((image_spread(&grid, 640, 480) - 1.0).abs() < 0.01);
    let line: Vec<_> = grid.iter().map(|p| Vector2::new(p.x, p.x)).collect();
    assert!(image_spread(&line, 640, 480) < 1e-6);
    assert_eq!(image_spread(&[], 640, 480), 0.0);
}
