use super::*;
use proptest::prelude::*;

fn controls<const N: usize>(numbers: &[f64]) -> Vec<UnitQuaternion<f64>> {
    // Neighbours up to about 1.5 rad apart.
    let mut rotation = so3::exp(&Vector3::new(0.4, -1.0, 2.0));
    (0..N)
        .map(|j| {
            rotation *= so3::exp(&Vector3::from_column_slice(&numbers[3 * j..3 * j + 3]));
            rotation
        })
        .collect()
}

fn laws<const N: usize>(numbers: &[f64], fraction: f64) {
    let spacing_s = 0.3;
    let w = Weights::<N>::at(fraction, spacing_s);
    assert!((w.value.iter().sum::<f64>() - 1.0).abs() < 1e-14);
    assert!(w.rate.iter().sum::<f64>().abs() < 1e-12);
    assert!(w.acceleration.iter().sum::<f64>().abs() < 1e-10);
    assert!(w.value.iter().all(|b| *b >= 0.0));

    let controls = controls::<N>(numbers);
    let at = |fraction: f64| {
        rotation(&Weights::<N>::at(fraction, spacing_s), &controls).expect("N controls")
    };
    let h = 1e-5;
    let (now, before, after) = (at(fraction), at(fraction - h), at(fraction + h));
    let step_s = 2.0 * h * spacing_s;
    let numeric = so3::log(&(before.rotation.inverse() * after.rotation)) / step_s;
    let size = 1.0 + now.angular_velocity.norm();
    assert!(
        (numeric - now.angular_velocity).norm() < 1e-7 * size * size,
        "{numeric} {}",
        now.angular_velocity
    );
    let numeric = (after.angular_velocity - before.angular_velocity) / step_s;
    assert!(
        (numeric - now.angular_acceleration).norm() < 1e-6 * size * size,
        "{numeric} {}",
        now.angular_acceleration
    );

    let full = rotation_with_jacobians(&w, &controls).expect("N controls");
    assert_eq!(full.at, now);
    for j in 0..N {
        for axis in 0..3 {
            let moved = |step: f64| {
                let mut delta = Vector3::zeros();
                delta[axis] = step;
                let mut controls = controls.clone();
                controls[j] *= so3::exp(&delta);
                rotation(&w, &controls).expect("N controls")
            };
            let (up, down) = (moved(1e-6), moved(-1e-6));
            let numeric = so3::log(&(down.rotation.inverse() * up.rotation)) / 2e-6;
            let error = (numeric - full.rotation_by_control[j].column(axis)).norm();
            assert!(error < 1e-8, "rotation {N} {j} {axis} {error}");
            let numeric = (up.angular_velocity - down.angular_velocity) / 2e-6;
            let error = (numeric - full.angular_velocity_by_control[j].column(axis)).norm();
            assert!(error < 1e-7 * size, "velocity {N} {j} {axis} {error}");
        }
    }

    let points: Vec<Vector3<f64>> = (0..N)
        .map(|j| Vector3::from_column_slice(&numbers[3 * j..3 * j + 3]))
        .collect();
    let at = |fraction: f64| {
        position(&Weights::<N>::at(fraction, spacing_s), &points).expect("N controls")
    };
    let (now, before, after) = (at(fraction), at(fraction - h), at(fraction + h));
    assert!(((after.position - before.position) / step_s - now.velocity).norm() < 1e-7);
    assert!(((after.velocity - before.velocity) / step_s - now.acceleration).norm() < 1e-6);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]
    #[test]
    fn derivatives_match_numeric_differences(
        numbers in prop::collection::vec(-0.9..0.9f64, 18), fraction in 0.001..0.999f64,
    ) {
        laws::<3>(&numbers, fraction);
        laws::<4>(&numbers, fraction);
        laws::<5>(&numbers, fraction);
        laws::<6>(&numbers, fraction);
    }

    #[test]
    fn a_constant_rate_is_kept(rate in prop::array::uniform3(-3.0..3.0f64), time_s in 0.0..1.0f64) {
        let rate = Vector3::from(rate);
        let knots = UniformKnots { start_s: 0.0, spacing_s: 0.1 };
        let controls: Vec<_> = (0..14).map(|k| so3::exp(&(rate * 0.1 * f64::from(k)))).collect();
        let segment = knots.segment::<5>(time_s, controls.len()).expect("inside");
        let at = rotation(&segment.weights, &controls[segment.first..segment.first + 5]).expect("five");
        prop_assert!((at.angular_velocity - rate).norm() < 1e-12);
        prop_assert!(at.angular_acceleration.norm() < 1e-10);
        // Uniform splines lag by (N − 2)/2 segments.
        let expected = so3::exp(&(rate * (time_s + 0.15)));
        prop_assert!(so3::log(&(expected.inverse() * at.rotation)).norm() < 1e-12);
    }

    #[test]
    fn segments_join_smoothly(numbers in prop::collection::vec(-0.9..0.9f64, 18)) {
        let controls = controls::<6>(&numbers);
        let end = rotation(&Weights::<5>::at(1.0, 0.2), &controls[..5]).expect("five");
        let start = rotation(&Weights::<5>::at(0.0, 0.2), &controls[1..]).expect("five");
        prop_assert!(so3::log(&(end.rotation.inverse() * start.rotation)).norm() < 1e-13);
        prop_assert!((end.angular_velocity - start.angular_velocity).norm() < 1e-11);
        prop_assert!((end.angular_acceleration - start.angular_acceleration).norm() < 1e-9);
    }
}

#[test]
fn times_outside_have_no_segment() {
    let knots = UniformKnots {
        start_s: 10.0,
        spacing_s: 0.5,
    };
    assert_eq!(knots.count::<4>(12.2), 8);
    assert_eq!(knots.end_s::<4>(8), 12.5);
    assert_eq!(knots.segment::<4>(12.5, 8).map(|s| s.first), Some(4));
    assert!(knots.segment::<4>(12.500_001, 8).is_none());
    assert!(knots.segment::<4>(9.999, 8).is_none());
    assert!(knots.segment::<4>(f64::NAN, 8).is_none());
    assert!(knots.segment::<4>(10.0, 3).is_none());
    assert!(rotation(&Weights::<4>::at(0.5, 1.0), &[]).is_none());
}
