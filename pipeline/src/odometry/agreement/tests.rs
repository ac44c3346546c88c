//! Poses of a walk in closed form, as scans would have them, and its samples, spoilt in one way each.

use lsfb_geometry::{Se3, Vector3, so3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::odometry::tests::room;

/// From scan to scan, seconds, and how long the walk takes: ten scans a second, and one in five seconds.
const OFTEN: (f64, f64) = (0.1, 12.0);
const RARELY: (f64, f64) = (5.0, 100.0);

fn samples(seconds: f64) -> Vec<Stamped<ImuSample>> {
    room::imu_samples(seconds + 2.0, 3)
}

/// Poses as scans have them: off by half a centimetre and a twelfth of a degree, each in its own way.
fn by_scans((every_s, seconds): (f64, f64), seed: u64) -> Vec<StampedPose> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let count = (seconds / every_s) as u32;
    let poses = (0..count).map(|k| {
        let at_s = every_s * f64::from(k) + 0.9;
        let mut noise = |size: f64| {
            let mut one = || size * (rng.random::<f64>() - 0.5) * 12f64.sqrt();
            Vector3::new(one(), one(), one())
        };
        let truth = room::world_from_rig(at_s);
        StampedPose {
            time: room::time(at_s),
            world_from_rig: Se3::new(
                truth.rotation * so3::exp(&noise(1.5e-3)),
                truth.translation + noise(5e-3),
            ),
        }
    });
    poses.collect()
}

fn changed(
    all: &[Stamped<ImuSample>],
    change: impl Fn(&mut Stamped<ImuSample>),
) -> Vec<Stamped<ImuSample>> {
    let mut all = all.to_vec();
    all.iter_mut().for_each(change);
    all
}

#[test]
fn a_right_imu_is_right() {
    for walk in [OFTEN, RARELY] {
        let samples = samples(walk.1);
        for seed in 0..5 {
            for is_deskewed in [true, false] {
                let poses = by_scans(walk, seed);
                let said = contradictions(&poses, &poses, &[], &samples, is_deskewed);
                assert_eq!(said, [], "{walk:?} {seed} {is_deskewed}");
            }
        }
    }
}

#[test]
fn one_that_stands_says_nothing_of_its_imu() {
    let samples = samples(100.0);
    let still = |p: StampedPose| StampedPose {
        world_from_rig: Se3::identity(),
        ..p
    };
    let poses: Vec<_> = by_scans(RARELY, 1).into_iter().map(still).collect();
    let standing = changed(&samples, |s| {
        s.sample.angular_velocity_rad_s = [1e-3, 2e-3, -1e-3];
        s.sample.specific_force_m_s2 = [0.1, 0.0, -9.81];
    });
    assert_eq!(contradictions(&poses, &poses, &[], &standing, false), []);
}

/// Naively the world lay on its head, and nothing was said.
#[test]
fn axes_that_are_others_are_named() {
    let apply = |signs: [f64; 3], axes: [usize; 3], v: [f64; 3]| -> [f64; 3] {
        [0, 1, 2].map(|k| signs[k] * v[axes[k]])
    };
    let (straight, exchanged) = ([0, 1, 2], [1, 0, 2]);
    for (signs, axes, right) in [
        ([-1.0, -1.0, -1.0], straight, "(-x, -y, -z)"),
        ([-1.0, 1.0, 1.0], straight, "(-x, y, z)"),
        ([1.0, -1.0, 1.0], straight, "(x, -y, z)"),
        ([1.0, 1.0, -1.0], straight, "(x, y, -z)"),
        ([-1.0, 1.0, -1.0], straight, "(-x, y, -z)"),
        ([1.0, 1.0, 1.0], exchanged, "(y, x, z)"),
        ([1.0, -1.0, 1.0], [2, 0, 1], "(-y, z, x)"),
    ] {
        for walk in [OFTEN, RARELY] {
            let samples = samples(walk.1);
            let poses = by_scans(walk, 2);
            for sensor in ["accelerometer", "gyroscope"] {
                let spoilt = changed(&samples, |s| {
                    let values = match sensor {
                        "gyroscope" => &mut s.sample.angular_velocity_rad_s,
                        _ => &mut s.sample.specific_force_m_s2,
                    };
                    *values = apply(signs, axes, *values);
                });
                let said = contradictions(&poses, &poses, &[], &spoilt, true);
                let named = OdometryWarning::ImuAxes {
                    sensor: sensor.to_owned(),
                    right: right.to_owned(),
                };
                assert_eq!(said, [named], "{sensor} {walk:?}");
            }
        }
    }
}

#[test]
fn stamps_that_are_late_are_told_how_late() {
    for walk in [OFTEN, RARELY] {
        let samples = samples(walk.1);
        for late_s in [0.2, -0.2, 0.05] {
            let spoilt = changed(&samples, |s| s.time = s.time.plus_secs(late_s));
            let poses = by_scans(walk, 3);
            let said = contradictions(&poses, &poses, &[], &spoilt, true);
            let [
                OdometryWarning::ImuClock {
                    late_s: found_s, ..
                },
            ] = said[..]
            else {
                panic!("{late_s} s, {walk:?}: {said:?}");
            };
            assert!((found_s - late_s).abs() < 0.01, "{found_s} for {late_s} s");
        }
    }
}

#[test]
fn a_lidar_that_hangs_otherwise_is_named_where_scans_are_rare_too() {
    let off = Se3::new(so3::exp(&Vector3::new(0.0, 0.087, 0.0)), Vector3::zeros());
    for (walk, is_deskewed) in [(OFTEN, true), (RARELY, true), (RARELY, false)] {
        let turned = |p: StampedPose| StampedPose {
            world_from_rig: p.world_from_rig * off,
            ..p
        };
        let poses: Vec<_> = by_scans(walk, 4).into_iter().map(turned).collect();
        let said = contradictions(&poses, &poses, &[], &samples(walk.1), is_deskewed);
        let [OdometryWarning::ExtrinsicRotation { off_deg, .. }] = said[..] else {
            panic!("{walk:?} {is_deskewed}: {said:?}");
        };
        assert!((off_deg - 5.0).abs() < 0.5, "{off_deg}°");
    }
}
