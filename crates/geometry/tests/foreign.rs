//! Camera models, groups and splines against OpenCV, COLMAP, GTSAM, SciPy and SymForce, and against their published formulas in
//! sixty digits: values in `expected/*.txt`, each with its recipe beside it.

use std::collections::BTreeMap;

use lsfb_geometry::camera::LensModel;
use lsfb_geometry::spline::{self, Weights};
use lsfb_geometry::{Camera, Quaternion, Se3, UnitQuaternion, Vector2, Vector3, Vector6, se3, so3};

struct Case {
    kind: String,
    source: String,
    given: Vec<f64>,
    expected: Vec<f64>,
}

fn cases() -> impl Iterator<Item = Case> {
    let lines = include_str!("expected/expected.txt").lines();
    let precise = include_str!("expected/precise.txt").lines();
    lines.chain(precise).map(|line| {
        let numbers = |text: &str| {
            let words = text.split_whitespace();
            words.map(|w| w.parse().expect("a number")).collect()
        };
        let (given, expected) = line.split_once('|').expect("a bar");
        let mut words = given.splitn(3, ' ');
        Case {
            kind: words.next().expect("kind").into(),
            source: words.next().expect("source").into(),
            given: numbers(words.next().expect("input")),
            expected: numbers(expected),
        }
    })
}

fn near(case: &Case, got: &[f64], tolerance: f64) {
    for (k, (got, expected)) in got.iter().zip(&case.expected).enumerate() {
        assert!(
            (got - expected).abs() <= tolerance * (1.0 + expected.abs()),
            "{} of {}, value {k}: {got}, expected {expected}",
            case.kind,
            case.source
        );
    }
}

#[test]
fn every_value_agrees_with_its_foreign_source() {
    let mut sources = BTreeMap::<(String, String), usize>::new();
    for case in cases() {
        *sources
            .entry((case.kind.clone(), case.source.clone()))
            .or_default() += 1;
        let v = |at: usize| Vector3::from_column_slice(&case.given[at..at + 3]);
        match case.kind.as_str() {
            "so3-exp" => {
                // q and −q are one rotation.
                let q = so3::exp(&v(0)).coords;
                let sign = if q.w * case.expected[3] < 0.0 {
                    -1.0
                } else {
                    1.0
                };
                near(&case, (q * sign).as_slice(), 1e-15);
            }
            "se3-exp" => {
                let pose = Se3::exp(&Vector6::from_column_slice(&case.given));
                let (r, t) = (pose.rotation_matrix(), pose.translation);
                let rows = (0..3).flat_map(|i| [r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]]);
                near(&case, &rows.collect::<Vec<_>>(), 2e-14);
            }
            "se3-right-jacobian" => {
                let j = se3::right_jacobian(&Vector6::from_column_slice(&case.given));
                // GTSAM's own series is good to about 1e-11 where the angle is small.
                near(&case, j.transpose().as_slice(), 1e-10);
            }
            "spline-position" | "spline-rotation" => match case.source.as_str() {
                "scipy4" => spline_case::<4>(&case),
                "scipy5" => spline_case::<5>(&case),
                "scipy6" => spline_case::<6>(&case),
                other => panic!("{other}"),
            },
            "spline-rates" => match case.source.as_str() {
                "mpmath4" => spline_rates_case::<4>(&case),
                "mpmath5" => spline_rates_case::<5>(&case),
                "mpmath6" => spline_rates_case::<6>(&case),
                other => panic!("{other}"),
            },
            _ => camera_case(&case),
        }
    }
    for (key, least) in [
        (("pinhole-radtan", "opencv"), 12),
        (("pinhole-radtan", "colmap"), 12),
        (("kannala-brandt", "opencv"), 12),
        (("kannala-brandt", "colmap"), 12),
        (("double-sphere", "opencv-omnidir"), 12),
        (("extended-unified", "opencv-omnidir"), 12),
        (("extended-unified", "colmap"), 12),
        (("field-of-view", "colmap"), 12),
        (("double-sphere", "symforce"), 30),
        (("double-sphere", "mpmath"), 42),
        (("extended-unified", "mpmath"), 24),
        (("field-of-view", "symforce"), 20),
        (("field-of-view", "mpmath"), 28),
        (("spline-rates", "mpmath4"), 2),
        (("spline-rates", "mpmath5"), 2),
        (("spline-rates", "mpmath6"), 2),
    ] {
        let key = (key.0.to_owned(), key.1.to_owned());
        assert!(sources.get(&key).is_some_and(|n| *n >= least), "{key:?}");
    }
}

fn camera_case(case: &Case) {
    let model = LensModel::ALL
        .into_iter()
        .find(|m| m.name() == case.kind)
        .expect("a model");
    let count = model.parameter_count();
    let mut parameters = [0.0; 9];
    parameters[..count].copy_from_slice(&case.given[..count]);
    let camera = Camera {
        width: 640,
        height: 480,
        lens: model.lens(&parameters),
    };
    let point = Vector3::from_column_slice(&case.given[count..]);
    let full = camera.project_full(&point).expect("seen");
    // OpenCV's fisheye derivative loses digits near the axis; its values do not.
    near(case, full.pixel.as_slice(), 1e-12);
    if case.expected.len() > 2 {
        let by_point = full.pixel_by_point.transpose();
        let by_parameter = full.pixel_by_parameter.transpose();
        let mut all = full.pixel.as_slice().to_vec();
        all.extend_from_slice(by_point.as_slice());
        for row in 0..2 {
            all.extend((0..count).map(|k| by_parameter[(k, row)]));
        }
        assert_eq!(all.len(), case.expected.len());
        near(
            case,
            &all,
            if case.source == "mpmath" { 1e-12 } else { 1e-9 },
        );
    }
    let ray = camera
        .unproject(&Vector2::new(case.expected[0], case.expected[1]))
        .expect("inverse");
    assert!((ray - point.normalize()).norm() < 1e-9, "{}", case.kind);
}

fn spline_case<const N: usize>(case: &Case) {
    let weights = Weights::<N>::at(case.given[1], case.given[0]);
    let controls: Vec<_> = case.given[2..]
        .chunks_exact(3)
        .map(Vector3::from_column_slice)
        .collect();
    if case.kind == "spline-position" {
        let at = spline::position(&weights, &controls).expect("N controls");
        let all: Vec<f64> = [at.position, at.velocity, at.acceleration]
            .iter()
            .flat_map(|v| v.as_slice().to_vec())
            .collect();
        near(case, &all, 1e-12);
    } else {
        let rotations: Vec<_> = controls.iter().map(so3::exp).collect();
        let at = spline::rotation(&weights, &rotations).expect("N controls");
        let [x, y, z, w] = case.expected[..] else {
            panic!("a quaternion")
        };
        let expected = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        assert!(so3::log(&(expected.inverse() * at.rotation)).norm() < 1e-13);
    }
}

/// Angular velocity and acceleration; then by each axis of each control point the change of rotation and of velocity.
fn spline_rates_case<const N: usize>(case: &Case) {
    let weights = Weights::<N>::at(case.given[1], case.given[0]);
    let controls: Vec<_> = case.given[2..]
        .chunks_exact(3)
        .map(|v| so3::exp(&Vector3::from_column_slice(v)))
        .collect();
    let full = spline::rotation_with_jacobians(&weights, &controls).expect("N controls");
    let mut all = full.at.angular_velocity.as_slice().to_vec();
    all.extend_from_slice(full.at.angular_acceleration.as_slice());
    for j in 0..N {
        for axis in 0..3 {
            all.extend_from_slice(full.rotation_by_control[j].column(axis).as_slice());
            all.extend_from_slice(full.angular_velocity_by_control[j].column(axis).as_slice());
        }
    }
    assert_eq!(all.len(), case.expected.len());
    near(case, &all, 1e-12);
    assert_eq!(spline::rotation(&weights, &controls), Some(full.at));
}
