//! Wrong localizations, up to more than half of them: scattered, and agreeing with one another.

use super::*;

/// What became of the localization of a frame.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Right,
    /// Anywhere in the room, turned anyhow.
    Scattered,
    /// As right as the others, in a room beside this one that looks the same.
    Shifted,
}

fn walk_with(kind_of: impl Fn(usize) -> Kind) -> Walk {
    let MadeUp { mut walk, .. } = make_walk(20, 0, |_| true);
    let mut rng = Gauss(ChaCha8Rng::seed_from_u64(5));
    for (k, frame) in walk.frames.iter_mut().enumerate() {
        let localized = frame.localized.as_mut().expect("localized");
        let right = localized.world_from_rig;
        localized.world_from_rig = match kind_of(k) {
            Kind::Right => right,
            Kind::Scattered => Se3::new(so3::exp(&rng.vector(1.5)), rng.vector(1.5)),
            Kind::Shifted => Se3::new(Default::default(), Vector3::new(0.0, 4.0, 0.0)) * right,
        };
    }
    walk
}

/// The start is right: all right localizations are accepted, and no other.
fn assert_placed(walk: &Walk, kind_of: impl Fn(usize) -> Kind) -> Start {
    let start = started(walk, &GroundTruthConfig::default());
    for (k, accepted) in start.accepted.iter().enumerate() {
        assert_eq!(*accepted, kind_of(k) == Kind::Right, "frame {k}");
    }
    // Beyond them the IMU drifts.
    let last = start.accepted.iter().rposition(|accepted| *accepted);
    let found = errors(walk, &start.states[..=last.expect("accepted")]);
    assert!(found.worst_m < 0.03, "worst {} m", found.worst_m);
    start
}

#[test]
fn six_of_ten_scattered_localizations_are_tolerated() {
    let kind_of = |k: usize| match [1, 5, 6, 8].contains(&(k * 7 % 10)) {
        true => Kind::Right,
        false => Kind::Scattered,
    };
    let start = assert_placed(&walk_with(kind_of), kind_of);
    assert_eq!((start.accepted_count, start.rival_count), (40, 0));
}

#[test]
fn localizations_that_agree_on_another_room_are_tolerated_while_they_are_fewer() {
    let kind_of = |k: usize| match k * 7 % 10 {
        1 | 5 | 6 | 8 => Kind::Right,
        2 | 9 => Kind::Shifted,
        _ => Kind::Scattered,
    };
    let start = assert_placed(&walk_with(kind_of), kind_of);
    assert_eq!((start.accepted_count, start.rival_count), (40, 20));
}

/// The majority is wrong and consistent: nobody can know, and it must not be taken for sure.
#[test]
fn two_places_that_both_explain_the_walk_are_told() {
    for wrong in [4, 5, 6] {
        let kind_of = |k: usize| match k * 7 % 10 < wrong {
            true => Kind::Shifted,
            false => Kind::Right,
        };
        let start = started(&walk_with(kind_of), &GroundTruthConfig::default());
        let (more, fewer) = (10 * wrong.max(10 - wrong), 10 * wrong.min(10 - wrong));
        assert_eq!((start.accepted_count, start.rival_count), (more, fewer));
    }
}

/// The IMU led from one room to the other, unseen for four seconds: the second half is not where the first one leads to.
#[test]
fn a_room_that_looks_like_the_first_is_not_entered() {
    let kind_of = |k: usize| match k {
        0..=49 => Kind::Right,
        90.. => Kind::Shifted,
        _ => Kind::Scattered,
    };
    let start = assert_placed(&walk_with(kind_of), kind_of);
    assert_eq!((start.accepted_count, start.rival_count), (50, 10));
}

/// After a span without the map all localizations come back: the prediction is uncertain by then, and allows for it.
#[test]
fn localizations_after_a_long_blind_span_are_taken_in() {
    let mut walk = walk_with(|_| Kind::Right);
    for frame in &mut walk.frames[30..85] {
        frame.localized = None;
    }
    let start = started(&walk, &GroundTruthConfig::default());
    assert_eq!((start.accepted_count, start.rival_count), (45, 0));
}

/// Without the IMU's samples of a second the two ends stand for themselves.
#[test]
fn a_pause_of_the_imu_does_not_take_the_localizations_behind_it() {
    let mut walk = walk_with(|_| Kind::Right);
    walk.imu
        .retain(|s| !(4_000_000_000..5_000_000_000).contains(&s.time.nanos()));
    let start = started(&walk, &GroundTruthConfig::default());
    assert_eq!((start.accepted_count, start.rival_count), (FRAMES, 0));
}

#[test]
fn scattered_localizations_alone_start_nothing() {
    let walk = walk_with(|_| Kind::Scattered);
    let start = start_states(&walk, &GroundTruthConfig::default(), &no_progress).expect("solves");
    assert!(start.is_none_or(|start| start.accepted_count < 5));
}

/// The solve is carried on until it rests: one iteration at a time leads to the same states.
#[test]
fn no_state_depends_on_the_iteration_limit() {
    let kind_of = |k: usize| match k % 3 {
        0 => Kind::Scattered,
        _ => Kind::Right,
    };
    let walk = walk_with(kind_of);
    let mut config = GroundTruthConfig::default();
    let many = started(&walk, &config);
    config.solve.max_iterations = 4;
    let few = started(&walk, &config);
    assert_eq!(many.accepted, few.accepted);
    for (a, b) in many.states.iter().zip(&few.states) {
        let apart = a.nav.world_from_rig.translation - b.nav.world_from_rig.translation;
        assert!(apart.norm() < 1e-4, "{} m", apart.norm());
    }
}
