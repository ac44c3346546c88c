use lsfb_geometry::{Se3, StampedPose, UnitQuaternion, Vector3};
use lsfb_types::{Timestamp, Verdict};

use crate::evaluation::tests::changed;
use crate::{EvalConfig, evaluate};

/// A walk of 150 s that turns about all axes, as it is at a time in seconds.
fn pose(t: f64) -> Se3 {
    let turn = |axis: Vector3<f64>, angle: f64| UnitQuaternion::new(axis * angle);
    let rotation = turn(Vector3::z(), 0.3 * t + 0.8 * (0.2 * t).sin())
        * turn(Vector3::y(), 0.25 * (0.7 * t).sin())
        * turn(Vector3::x(), 0.2 * (0.9 * t + 1.0).sin());
    let x = 6.0 * (0.11 * t).sin() + 1.5 * (0.41 * t).sin();
    let y = 7.0 * (0.083 * t).cos() + 1.2 * (0.37 * t + 1.0).sin();
    let z = 1.5 + 0.25 * (0.5 * t).sin();
    Se3::new(rotation, Vector3::new(x, y, z))
}

/// The walk as a clock has it that shows `late_secs` too much.
fn walk(late_secs: impl Fn(f64) -> f64) -> Vec<StampedPose> {
    (0..1500)
        .map(|i| {
            let t = f64::from(i) * 0.1;
            StampedPose {
                time: Timestamp::from_nanos(i64::from(i) * 100_000_000),
                world_from_rig: pose(t - late_secs(t)),
            }
        })
        .collect()
}

/// With errors of a centimetre and a quarter of a degree, and in another world.
fn estimated(poses: &[StampedPose]) -> Vec<StampedPose> {
    let world = Se3::exp(&[0.1, -0.2, 0.9, 3.0, -2.0, 0.5].into());
    changed(poses, |i, p| {
        let shake = |k: f64| (0.05 * i as f64 * k + k).sin();
        let off = Vector3::new(shake(1.0), shake(1.7), shake(2.3));
        p.world_from_rig.translation += 0.01 * off;
        p.world_from_rig.rotation *= UnitQuaternion::new(0.003 * off);
        p.world_from_rig = world * p.world_from_rig;
    })
}

fn named(estimate: &[StampedPose]) -> Vec<(String, String)> {
    let found = evaluate(&walk(|_| 0.0), estimate, &EvalConfig::default()).expect("valid");
    let wrong = found.findings.into_iter();
    wrong
        .filter(|f| f.verdict != Verdict::Pass)
        .map(|f| (f.code.into_owned(), f.what))
        .collect()
}

#[track_caller]
fn only(found: &[(String, String)], code: &str, words: &str) {
    match found {
        [(own, what)] if own == code && what.contains(words) => {}
        _ => panic!("{code}, {words}: {found:?}"),
    }
}

/// All of these passed: their figures were of one mistake, and nothing said so.
#[test]
fn one_mistake_that_makes_all_errors_is_named() {
    let right = estimated(&walk(|_| 0.0));
    assert_eq!(named(&right), []);

    let elsewhere = changed(&right, |_, p| {
        let lever = Vector3::new(0.3, 0.1, -0.2);
        p.world_from_rig.translation += p.world_from_rig.rotation * lever;
    });
    only(&named(&elsewhere), "lever", "another point");

    only(&named(&estimated(&walk(|t| 0.002 * t))), "clock", "late");
    let jumped = |t: f64| if t > 75.0 { 0.2 } else { 0.0 };
    only(&named(&estimated(&walk(jumped))), "clock", "late");

    for (axis, factor, words) in [
        (2, 0.5, "1.0000, 0.5"),
        (2, 10.0, "1.0000, 10.0"),
        (0, 1.05, "are 1.05"),
    ] {
        let plain = changed(&walk(|_| 0.0), |i, p| {
            p.world_from_rig.translation.y += 0.01 * (0.3 * i as f64).sin();
            p.world_from_rig.rotation *=
                UnitQuaternion::new(Vector3::z() * 0.01 * (0.3 * i as f64).sin());
            p.world_from_rig.translation[axis] *= factor;
        });
        let found = named(&plain);
        assert!(
            found.iter().any(|(code, _)| code == "axes"),
            "{words}: {found:?}"
        );
    }
    let flat = changed(&walk(|_| 0.0), |i, p| {
        p.world_from_rig.translation.x += 0.01 * (0.3 * i as f64).sin();
        p.world_from_rig.rotation *=
            UnitQuaternion::new(Vector3::z() * 0.01 * (0.3 * i as f64).sin());
        p.world_from_rig.translation.z = 0.0;
    });
    only(&named(&flat), "axes", "z of the estimate is constant");

    let in_feet = changed(&right, |_, p| p.world_from_rig.translation /= 0.3048);
    only(&named(&in_feet), "scale", "3.28");

    let mounted = changed(&right, |_, p| {
        p.world_from_rig.rotation *= UnitQuaternion::new(Vector3::z() * 0.06);
    });
    only(&named(&mounted), "orientations", "rotation of 3.");

    let true_turns = changed(&right, |i, p| {
        p.world_from_rig.rotation = walk(|_| 0.0)[i].world_from_rig.rotation;
    });
    let found = named(&true_turns);
    assert!(
        found.iter().any(|(code, _)| code == "same-orientations"),
        "{found:?}"
    );
}

/// A drift, another scale of a few per cent, white noise: errors of the estimate itself, of no mistake in the file.
#[test]
fn errors_of_an_estimate_are_no_mistake() {
    let right = estimated(&walk(|_| 0.0));
    let drifted = changed(&right, |i, p| {
        let t = i as f64 * 0.1;
        p.world_from_rig.translation += Vector3::new(0.002 * t, 0.1 * (0.03 * t).sin(), 0.0);
    });
    assert_eq!(named(&drifted), []);
    let larger = changed(&right, |_, p| p.world_from_rig.translation *= 1.03);
    assert_eq!(named(&larger), []);
    let turning = changed(&right, |i, p| {
        p.world_from_rig.translation =
            UnitQuaternion::new(Vector3::z() * 2e-5 * i as f64) * p.world_from_rig.translation;
    });
    assert_eq!(named(&turning), []);
    let jumped = changed(&right, |i, p| {
        p.world_from_rig.translation.x += if i > 700 { 0.5 } else { 0.0 };
    });
    assert_eq!(named(&jumped), []);
}
