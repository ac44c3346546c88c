use super::*;
use proptest::prelude::*;

fn cameras() -> Vec<Camera> {
    let camera = |lens| Camera {
        width: 640,
        height: 400,
        lens,
    };
    let (focal_px, principal_px) = ([350.0, 352.0], [321.0, 198.5]);
    let fisheye = |distortion| {
        camera(Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion,
        })
    };
    let wide = |distortion| {
        camera(Lens::DoubleSphere {
            focal_px: [158.3, 158.2],
            principal_px,
            distortion,
        })
    };
    let unified = |distortion| {
        camera(Lens::ExtendedUnified {
            focal_px: [300.0, 301.0],
            principal_px,
            distortion,
        })
    };
    let fov = |omega| {
        camera(Lens::FieldOfView {
            focal_px: [256.0, 257.0],
            principal_px,
            distortion: [omega],
        })
    };
    vec![
        fisheye([0.01, -0.02, 0.005, -0.001]),
        fisheye([0.0; 4]),
        camera(Lens::PinholeRadtan {
            focal_px: [500.0, 510.0],
            principal_px: [320.0, 240.0],
            distortion: [-0.28, 0.07, 1e-3, -5e-4, 0.0],
        }),
        wide([-0.172, 0.593]),
        wide([0.2, 0.3]),
        unified([0.62, 1.1]),
        unified([0.3, 0.9]),
        fov(0.92),
        fov(2e-3),
    ]
}

proptest! {
    #[test]
    fn unproject_inverts_project(u in 5.0..635.0f64, v in 5.0..395.0f64, depth in 0.2..50.0f64) {
        for camera in cameras() {
            let pixel = Vector2::new(u, v);
            let Some(ray) = camera.unproject(&pixel) else {
                // Only the unified models end inside this image: where their last sphere does.
                prop_assert!(matches!(camera.lens.model(), LensModel::DoubleSphere | LensModel::ExtendedUnified));
                continue;
            };
            prop_assert!((ray.norm() - 1.0).abs() < 1e-12);
            let again = camera.project(&(ray * depth)).expect("in the validity region");
            prop_assert!((again - pixel).norm() < 1e-7, "{camera:?} {pixel} {again}");
        }
    }

    #[test]
    fn project_is_one_to_one_where_it_is_defined(p in prop::array::uniform3(-3.0..3.0f64)) {
        let p = Vector3::from(p);
        prop_assume!(p.norm() > 0.1);
        for camera in cameras() {
            let Some(pixel) = camera.project(&p) else { continue };
            // Beyond ten image widths the pinhole loses its digits.
            if pixel.norm() > 6400.0 { continue }
            let ray = camera.unproject(&pixel).expect("what is projected can be unprojected");
            prop_assert!((ray - p.normalize()).norm() < 1e-6, "{camera:?} {p} {ray}");
        }
    }

    #[test]
    fn jacobian_by_point_matches_numeric_differences(p in prop::array::uniform3(-2.0..2.0f64)) {
        for camera in cameras() {
            let p = Vector3::from(p);
            let Some(projection) = camera.project_with_jacobian(&p) else { continue };
            for axis in 0..3 {
                let mut h = Vector3::zeros();
                h[axis] = 1e-6;
                let (Some(a), Some(b)) = (camera.project(&(p + h)), camera.project(&(p - h))) else { continue };
                let numeric = (a - b) / 2e-6;
                let scale = 1.0 + projection.pixel_by_point.norm();
                prop_assert!(
                    (numeric - projection.pixel_by_point.column(axis)).norm() < 1e-5 * scale * scale / 500.0 + 1e-4,
                    "{camera:?} {p} {numeric} {}", projection.pixel_by_point
                );
            }
        }
    }

    #[test]
    fn jacobian_by_parameter_matches_numeric_differences(x in -1.0..1.0f64, y in -1.0..1.0f64, z in 0.7..5.0f64) {
        let p = Vector3::new(x, y, z);
        for camera in cameras() {
            let Some(full) = camera.project_full(&p) else { continue };
            let simple = camera.project_with_jacobian(&p).expect("same domain");
            prop_assert_eq!(full.pixel, simple.pixel);
            prop_assert_eq!(full.pixel_by_point, simple.pixel_by_point);
            let parameters = camera.lens.parameters();
            let model = camera.lens.model();
            prop_assert_eq!(parameters.count, model.parameter_count());
            prop_assert_eq!(model.lens(&parameters.values), camera.lens);
            for k in 0..MAX_PARAMETERS {
                let moved = |step: f64| {
                    let mut values = parameters.values;
                    values[k] += step;
                    Camera { lens: model.lens(&values), ..camera }.project(&p)
                };
                let (Some(a), Some(b)) = (moved(1e-6), moved(-1e-6)) else { continue };
                let numeric = (a - b) / 2e-6;
                let analytic = full.pixel_by_parameter.column(k);
                prop_assert!((numeric - analytic).norm() < 1e-5 * (1.0 + analytic.norm()), "{camera:?} {k} {numeric} {analytic}");
            }
        }
    }
}

#[test]
fn behind_and_non_finite_points_are_not_seen() {
    for camera in cameras() {
        assert!(
            camera.project(&Vector3::new(0.0, 0.0, -1.0)).is_none(),
            "{camera:?}"
        );
        assert!(camera.project(&Vector3::new(f64::NAN, 0.0, 1.0)).is_none());
        assert!(
            camera
                .project(&Vector3::new(0.0, f64::INFINITY, 1.0))
                .is_none()
        );
        assert!(camera.project(&Vector3::zeros()).is_none());
        assert!(camera.unproject(&Vector2::new(f64::NAN, 0.0)).is_none());
    }
}

#[test]
fn a_fold_is_not_passed_even_where_the_polynomial_rises_again() {
    // The slope of r (1 − 0.55 r² + 0.1 r⁴) is below zero for r² between 0.8 and 2.5 alone.
    let lens = |k3| Lens::PinholeRadtan {
        focal_px: [400.0; 2],
        principal_px: [320.0; 2],
        distortion: [-0.55, 0.1, 0.0, 0.0, k3],
    };
    for k3 in [0.0, 1e-3, -1e-3] {
        let camera = Camera {
            width: 640,
            height: 640,
            lens: lens(k3),
        };
        assert!(camera.project(&Vector3::new(0.8, 0.0, 1.0)).is_some());
        for tangent in [1.0, 1.2, 1.7, 2.0, 2.5] {
            assert!(
                camera.project(&Vector3::new(tangent, 0.0, 1.0)).is_none(),
                "{k3} {tangent}"
            );
        }
    }
}

#[test]
fn parameters_outside_the_domain_are_named() {
    let (focal_px, principal_px) = ([300.0; 2], [320.0, 200.0]);
    let bad = [
        (
            Lens::DoubleSphere {
                focal_px,
                principal_px,
                distortion: [0.1, 1.2],
            },
            "alpha is 1.2",
        ),
        (
            Lens::ExtendedUnified {
                focal_px,
                principal_px,
                distortion: [0.5, -1.0],
            },
            "beta is -1",
        ),
        (
            Lens::FieldOfView {
                focal_px: [0.0, 1.0],
                principal_px,
                distortion: [0.9],
            },
            "fx is 0",
        ),
        (
            Lens::KannalaBrandt {
                focal_px,
                principal_px,
                distortion: [0.0, f64::NAN, 0.0, 0.0],
            },
            "k2 is NaN",
        ),
    ];
    for (lens, words) in bad {
        let problem = lens.problem().expect("bad");
        assert!(problem.starts_with(words), "{problem}");
    }
    assert!(cameras().iter().all(|c| c.lens.problem().is_none()));
}
