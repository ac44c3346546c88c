//! Walks that are solved as one.

use std::path::Path;

use lsfb_geometry::StampedPose;
use lsfb_recording::Recording;

use super::recorded::{Measured, Paint, WALK_FRAMES, map, rig};
use super::*;
use crate::ground_truth::ground_truth_together;
use crate::ground_truth::together::{Member, solve_together};
use crate::kept_stages::KeptStages;

/// A walk by itself, and what would be given of it.
struct Alone {
    made: MadeUp,
    solved: Solved,
    given: Trajectory,
    covariances: Vec<Matrix6<f64>>,
}

/// With few points of the map, by which each errs its own way.
fn alone(seed: u64) -> Alone {
    let off = CameraCorrection::zeros();
    let mut made = make_walk_of(seed, (24, 300), |k| k % 3 == 0, &off);
    let config = GroundTruthConfig::default();
    let start = started(&made.walk, &config);
    let solved = solve_walk(
        &mut made.walk,
        &start,
        &made.features,
        &config,
        &no_progress,
    );
    let solved = solved.expect("solves");
    let (estimate, points) = (&solved.last.estimate, &solved.last.points);
    let found = uncertainty(&made.walk, estimate, points, &config, &no_progress);
    let poses = made.walk.frames.iter().zip(&estimate.states);
    let given = Trajectory::new(
        poses
            .map(|(frame, state)| StampedPose {
                time: frame.time,
                world_from_rig: state.nav.world_from_rig,
            })
            .collect(),
    );
    let covariances = found.expect("covariances").poses;
    Alone {
        covariances: covariances.into_iter().map(|c| c.expect("known")).collect(),
        made,
        solved,
        given,
    }
}

fn member(alone: &mut Alone) -> Member<'_> {
    Member {
        walk: &mut alone.made.walk,
        features: &alone.made.features,
        solved: &mut alone.solved,
        given: &alone.given,
        covariances: &alone.covariances,
    }
}

/// Root mean square of how far two devices that are in one place are from each other, metres, and of how far each is from the truth.
fn apart_m(walks: &[Alone]) -> (f64, f64) {
    let states = |k: usize| walks[k].solved.last.estimate.states.iter();
    let apart = states(0).zip(states(1));
    let squares = apart.map(|(a, b)| {
        (a.nav.world_from_rig.inverse() * b.nav.world_from_rig)
            .translation
            .norm_squared()
    });
    let mean = squares.sum::<f64>() / FRAMES as f64;
    let off =
        [0, 1].map(|k| errors(&walks[k].made.walk, &walks[k].solved.last.estimate.states).rms_m);
    (mean.sqrt(), off[0].hypot(off[1]) / 2f64.sqrt())
}

#[test]
fn walks_solved_as_one_lie_nearer_to_each_other() {
    let config = GroundTruthConfig::default();
    let mut ratios = Vec::new();
    for seeds in [[11, 12], [13, 14], [15, 16]] {
        let mut walks = seeds.map(alone);
        let (before_m, off_before_m) = apart_m(&walks);
        let mut members: Vec<Member> = walks.iter_mut().map(member).collect();
        let said = solve_together(&mut members, &config, &no_progress).expect("solves");
        let (after_m, off_after_m) = apart_m(&walks);
        println!(
            "{before_m:.5} to {after_m:.5} m apart, {off_before_m:.5} to {off_after_m:.5} m off, {said:?}"
        );
        assert!(
            said.iter()
                .all(|s| s.common_points > 50 && s.map_points > 10 && s.moved_sigmas < 3.0)
        );
        assert!(off_after_m < 1.1 * off_before_m);
        ratios.push(after_m / before_m);
    }
    assert!(ratios.iter().all(|r| *r < 0.8), "{ratios:?}");
}

/// Nothing in common is said, and moves nothing.
#[test]
fn walks_with_nothing_in_common_stay_as_they_are() {
    let config = GroundTruthConfig::default();
    let mut walks = [11, 12].map(alone);
    let other = &mut walks[1].made;
    for features in &mut other.features {
        let flip = |d: &mut [u8; DESCRIPTOR_LEN]| d.rotate_left(17);
        features.descriptors.iter_mut().for_each(flip);
    }
    for frame in &mut other.walk.frames {
        let elsewhere = |seen: &mut FixedObservation| seen.point += 1000;
        frame.recognised.iter_mut().for_each(elsewhere);
        frame.fixed.iter_mut().for_each(elsewhere);
    }
    let before = walks[0].solved.last.estimate.states.clone();
    let mut members: Vec<Member> = walks.iter_mut().map(member).collect();
    let said = solve_together(&mut members, &config, &no_progress).expect("solves");
    let is_nothing = |s: &Together| {
        s.map_points + s.common_points == 0 && s.moved_m == 0.0 && s.moved_sigmas < 1e-9
    };
    assert!(said.iter().all(is_nothing), "{said:?}");
    assert!(walks[0].solved.last.estimate.states == before);
}

/// From recordings, in either order; and with a walk that is refused by itself nothing is solved.
#[test]
fn recorded_walks_are_solved_as_one_if_each_is_right() {
    let map = map(1);
    let folder = tempfile::tempdir().expect("folder");
    // What was found in the images of each is looked for once.
    let opened = |path: &Path| {
        let stages = KeptStages::in_folder(&path.with_extension("stages"), "walk");
        let recording = Recording::open(path).expect("recording");
        (recording, stages.expect("folder"))
    };
    let recorded = |name: &str, room: Paint, frames: usize| {
        let path = folder.path().join(name);
        Measured::in_room(room, frames).record(&path, &rig());
        opened(&path)
    };
    let long = recorded("long.mcap", Paint::of(1), WALK_FRAMES);
    let short = recorded("short.mcap", Paint::of(1), WALK_FRAMES * 2 / 3);
    let elsewhere = recorded("elsewhere.mcap", Paint::other_floor(1), WALK_FRAMES);
    let solve = |first: &(Recording, KeptStages), other: &(Recording, KeptStages)| {
        let config = GroundTruthConfig::default();
        let walks = [first, other].map(|(recording, stages)| (recording, stages));
        ground_truth_together(&walks, &map, &config, &no_progress)
    };
    let both = [solve(&long, &short), solve(&short, &long)].map(|s| s.expect("solved"));
    // Each walk is given, in the order in which it was named.
    let lengths = both.each_ref().map(|given| {
        let given: Vec<usize> = given.iter().map(|g| g.trajectory.len()).collect();
        given
    });
    assert!(
        lengths[0].len() == 2 && lengths[0][0] > lengths[0][1],
        "{lengths:?}"
    );
    assert_eq!(
        lengths[0],
        lengths[1].iter().rev().copied().collect::<Vec<_>>()
    );
    let [a, b] = both.map(|given| given[0].report.together.expect("together"));
    assert!(a.map_points > 50 && a.common_points > 10, "{a:?}");
    assert_eq!(
        (a.map_points, a.common_points),
        (b.map_points, b.common_points)
    );
    match solve(&long, &elsewhere) {
        Err(Error::OtherWalk { path, error }) => {
            assert!(path.ends_with("elsewhere.mcap"));
            assert!(
                matches!(*error, Error::Refused(Refusal::PointsAbsent { .. })),
                "{error}"
            );
        }
        other => panic!("{other:?}"),
    }
    // By itself a walk whose images are late is given, and not to be used.
    let path = folder.path().join("late.mcap");
    let mut late = Measured::in_room(Paint::of(1), WALK_FRAMES);
    for (_, image) in &mut late.images {
        image.time = image.time.plus_nanos(100_000_000);
    }
    late.record(&path, &rig());
    let late = opened(&path);
    for (first, other) in [(&long, &late), (&late, &long)] {
        let refused = match solve(first, other) {
            Err(Error::OtherWalk { error, .. }) => *error,
            refused => refused.expect_err("images are late"),
        };
        match refused {
            Error::Refused(Refusal::FailedAlone { path, .. }) => {
                assert!(path.ends_with("late.mcap"))
            }
            other => panic!("{other}"),
        }
    }
}
