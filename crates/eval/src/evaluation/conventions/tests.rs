use lsfb_geometry::{Quaternion, StampedPose, UnitQuaternion};
use lsfb_types::Verdict;

use crate::evaluation::tests::{changed, curl};
use crate::{EvalConfig, evaluate};

/// Positions fit in each of these, and no figure said what was wrong.
#[test]
fn other_conventions_are_named() {
    let truth = curl(200);
    let noisy = changed(&truth, |i, p| {
        p.world_from_rig.translation.x += 0.01 * (7.0 * i as f64).sin();
    });
    let found = |estimate: &[StampedPose]| {
        let found = evaluate(&truth, estimate, &EvalConfig::default()).expect("valid");
        let named = ["orientations", "mirrored", "clock"];
        let found = found.findings.into_iter();
        found
            .filter(|f| named.contains(&f.code.as_ref()))
            .map(|f| (f.verdict, f.what))
            .collect::<Vec<_>>()
    };
    let turned = |of: fn(Quaternion<f64>) -> Quaternion<f64>| {
        let estimate = changed(&noisy, |_, p| {
            let rotation = p.world_from_rig.rotation.into_inner();
            p.world_from_rig.rotation = UnitQuaternion::new_normalize(of(rotation));
        });
        found(&estimate)
    };
    let only = |found: Vec<(Verdict, String)>, verdict: Verdict, words: &str| match &found[..] {
        [(own, what)] if *own == verdict && what.contains(words) => {}
        _ => panic!("{words}: {found:?}"),
    };
    assert_eq!(turned(|q| q), []);
    // x y z w where w x y z was meant, and the other way round.
    let w_first = turned(|q| Quaternion::new(q.k, q.w, q.i, q.j));
    only(w_first, Verdict::Fail, "w first");
    let w_last = turned(|q| Quaternion::new(q.i, q.j, q.k, q.w));
    only(w_last, Verdict::Fail, "w last");
    let inverse = turned(|q| q.conjugate());
    only(inverse, Verdict::Fail, "inverted");
    // The curl turns about one axis nearly, as a robot on wheels does.
    let none = turned(|_| Quaternion::identity());
    only(none, Verdict::Fail, "do not follow");
    let body = turned(|q| q * Quaternion::new(0.5, 0.5, 0.5, 0.5));
    only(body, Verdict::Warn, "constant rotation of 120.0°");
    let world = turned(|q| Quaternion::new(0.0, 0.0, 0.0, 1.0) * q);
    only(world, Verdict::Warn, "another world");
    let left_handed = changed(&noisy, |_, p| {
        let q = p.world_from_rig.rotation.into_inner();
        p.world_from_rig.translation.y *= -1.0;
        p.world_from_rig.rotation =
            UnitQuaternion::new_normalize(Quaternion::new(q.w, -q.i, q.j, -q.k));
    });
    let left_handed = found(&left_handed);
    assert!(left_handed[0].1.contains("mirror image"), "{left_handed:?}");
    // Stamps of the end of a long exposure.
    let late = changed(&noisy, |_, p| p.time = p.time.plus_secs(0.06));
    let config = EvalConfig {
        max_difference_secs: 0.061,
        ..EvalConfig::default()
    };
    let late = evaluate(&truth, &late, &config).expect("valid");
    let clock = late.findings.iter().find(|f| f.code == "clock");
    let clock = clock.unwrap_or_else(|| panic!("{:?}", late.findings));
    let offset_secs = clock.value.expect("seconds");
    // Each is paired with the pose of the truth 40 ms later.
    assert!((offset_secs - 0.06).abs() < 4e-3, "{offset_secs}");
}
