use super::*;
use lsfb_geometry::{Vector3, Vector6};
use lsfb_types::Timestamp;

/// Poses at the given places on the x axis, one per 100 ms, each turned by 10° more.
fn walk(x_m: &[f64]) -> Vec<StampedPose> {
    x_m.iter()
        .enumerate()
        .map(|(i, &x)| {
            let yaw = (10.0 * i as f64).to_radians();
            let turn = Se3::exp(&Vector6::new(0.0, 0.0, yaw, 0.0, 0.0, 0.0));
            StampedPose {
                time: Timestamp::from_nanos(i as i64 * 100_000_000),
                world_from_rig: Se3::new(turn.rotation, Vector3::new(x, 0.0, 0.0)),
            }
        })
        .collect()
}

fn found(
    x_m: &[f64],
    delta: f64,
    unit: DeltaUnit,
    selection: PairSelection,
) -> Vec<(usize, usize)> {
    select(&walk(x_m), delta, unit, selection)
        .map(|found| found.pairs.iter().map(|p| (p.from, p.to)).collect())
        .unwrap_or_default()
}

use crate::relation::DeltaUnit::{Degrees, Frames, Metres, Radians, Seconds};
use PairSelection::{All, Consecutive};

const EVEN: [f64; 6] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];

#[test]
fn counts_frames() {
    assert_eq!(found(&EVEN, 2.0, Frames, Consecutive), [(0, 2), (2, 4)]);
    assert_eq!(found(&EVEN, 4.0, Frames, All), [(0, 4), (1, 5)]);
    assert_eq!(found(&EVEN, 6.0, Frames, All), []);
}

#[test]
fn walks_metres() {
    let x = [0.0, 0.6, 1.2, 1.2, 2.05, 4.0];
    assert_eq!(found(&x, 1.0, Metres, Consecutive), [(0, 2), (2, 5)]);
    // From 1 (0.6 m) nothing lies within 0.1 m of 1.6 m; from 2 and 3 pose 4 is 0.85 m away, too near.
    assert_eq!(
        found(&[0.0, 0.5, 1.05, 1.05, 2.0], 1.0, Metres, All),
        [(0, 2), (2, 4), (3, 4)]
    );
}

#[test]
fn waits_seconds() {
    assert_eq!(found(&EVEN, 0.2, Seconds, Consecutive), [(0, 2), (2, 4)]);
    assert_eq!(found(&EVEN, 0.3, Seconds, All), [(0, 3), (1, 4), (2, 5)]);
}

#[test]
fn turns_degrees_and_radians() {
    assert_eq!(
        found(&EVEN, 20.0, Degrees, All),
        [(0, 2), (1, 3), (2, 4), (3, 5)]
    );
    assert_eq!(
        found(&EVEN, 15f64.to_radians(), Radians, Consecutive),
        [(0, 2), (2, 4)]
    );
}

#[test]
fn refuses_deltas_without_meaning() {
    for (delta, unit) in [
        (0.0, Frames),
        (1.5, Frames),
        (-1.0, Metres),
        (f64::NAN, Seconds),
        (181.0, Degrees),
        (4.0, Radians),
    ] {
        let error = select(&walk(&EVEN), delta, unit, All).expect_err("out of range");
        assert!(matches!(error, Error::Setting(_)), "{error}");
    }
    let error = select(&walk(&EVEN), 9.0, Metres, Consecutive).expect_err("too long");
    assert!(matches!(error, Error::NoPairs { .. }), "{error}");
}

/// Poses every three seconds, and a minute without any: each pair across them counted as one "per 1 s".
#[test]
fn no_pair_per_second_lies_across_a_gap() {
    let at = |secs: &[f64]| -> Vec<StampedPose> {
        let mut poses = walk(&vec![0.0; secs.len()]);
        for (pose, secs) in poses.iter_mut().zip(secs) {
            pose.time = Timestamp::from_nanos((secs * 1e9) as i64);
        }
        poses
    };
    let keyframes: Vec<f64> = (0..20).map(|i| 3.0 * f64::from(i)).collect();
    let none = select(&at(&keyframes), 1.0, Seconds, Consecutive).expect_err("none per second");
    assert!(matches!(none, Error::NoPairs { .. }), "{none}");
    let lost: Vec<f64> = (0..5)
        .map(|i| 0.5 * f64::from(i))
        .chain((0..5).map(|i| 62.0 + 0.5 * f64::from(i)))
        .collect();
    let found = select(&at(&lost), 1.0, Seconds, Consecutive).expect("pairs");
    let pairs: Vec<_> = found.pairs.iter().map(|p| (p.from, p.to)).collect();
    assert_eq!(pairs, [(0, 2), (2, 4), (5, 7), (7, 9)]);
    assert_eq!((found.left_out, found.deltas), (1, vec![1.0; 4]));
}

/// Pairs per metre and angle are evo's; how long they are is told.
#[test]
fn how_far_apart_pairs_are_is_told() {
    let x = [0.0, 0.6, 1.2, 1.2, 2.05, 4.0];
    let found = select(&walk(&x), 1.0, Metres, Consecutive).expect("pairs");
    assert!((found.deltas[0] - 1.2).abs() < 1e-12 && (found.deltas[1] - 2.8).abs() < 1e-12);
    for selection in [Consecutive, All] {
        let turned = select(&walk(&EVEN), 20.0, Degrees, selection).expect("pairs");
        assert!(turned.deltas.iter().all(|d| (d - 20.0).abs() < 1e-9));
    }
    assert_eq!(
        select(&walk(&EVEN), 2.0, Frames, All)
            .expect("pairs")
            .deltas,
        [2.0; 4]
    );
}
