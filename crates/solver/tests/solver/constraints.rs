//! Held components, bounds, priors, names.

use lsfb_geometry::{Se3, Vector2, Vector3, Vector6};
use lsfb_solver::{
    DirectionPrior, Error, Kernel, Linearization, Parameters, PosePrior, Problem, Residual, Shape,
    SolveConfig, Undefined, VectorPrior, solve,
};
use nalgebra::{Matrix2, SVector, UnitVector3};

fn exact() -> SolveConfig {
    SolveConfig {
        cost_tolerance: 1e-16,
        step_tolerance: 1e-14,
        ..SolveConfig::default()
    }
}

/// A quadratic whose free minimum is (4, 3): along y it leans on x.
fn leaning() -> VectorPrior<2> {
    VectorPrior {
        value: Vector2::new(4.0, 3.0),
        sqrt_information: Matrix2::new(1.0, 1.0, 0.0, 1.0),
    }
}

#[test]
fn bounds_are_kept_and_the_rest_is_optimal() {
    // With x at its bound 1, (x − 4 + y − 3)² + (y − 3)² is least at y = 4.5.
    for start in [
        Vector2::new(0.0, 0.0),
        Vector2::new(9.0, 9.0),
        Vector2::new(1.0, -5.0),
    ] {
        let mut problem = Problem::new();
        let block = problem.add_block(start);
        problem
            .add_residual(leaning(), &[block.id()], Kernel::Squared)
            .expect("blocks fit");
        problem
            .set_bounds(block, 0, f64::NEG_INFINITY, 1.0)
            .expect("bounds");
        solve(&mut problem, &exact()).expect("solves");
        let found = problem.value(block);
        assert!((found - Vector2::new(1.0, 4.5)).norm() < 1e-7, "{found}");
    }
}

#[test]
fn eliminated_points_keep_their_bounds() {
    let mut problem = Problem::new();
    let point = problem.add_eliminated_point(Vector3::new(0.0, 0.0, 0.0));
    let pose = problem.add_block(Vector3::zeros());
    let pull = VectorPrior::new(Vector3::new(1.0, 2.0, 3.0), Vector3::repeat(1.0));
    problem
        .add_residual(pull, &[point.id()], Kernel::Squared)
        .expect("blocks fit");
    problem
        .add_residual(Difference, &[pose.id(), point.id()], Kernel::Squared)
        .expect("blocks fit");
    problem.set_bounds(point, 2, -1.0, 2.5).expect("bounds");
    solve(&mut problem, &exact()).expect("solves");
    let expected = Vector3::new(1.0, 2.0, 2.5);
    assert!((problem.value(point) - expected).norm() < 1e-7);
    assert!((problem.value(pose) - expected).norm() < 1e-7);
}

/// `b − a`.
struct Difference;

impl Residual for Difference {
    fn dimension(&self) -> usize {
        3
    }
    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Vector3<f64>>(), Shape::of::<Vector3<f64>>()] }
    }
    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (a, b): (Vector3<f64>, Vector3<f64>) = (parameters.get(0), parameters.get(1));
        out.set_residual(&(b - a));
        out.set_jacobian(0, &-nalgebra::Matrix3::identity());
        out.set_jacobian(1, &nalgebra::Matrix3::identity());
        Ok(())
    }
}

#[test]
fn held_components_stay_and_the_rest_is_optimal() {
    let mut problem = Problem::new();
    let block = problem.add_block(Vector2::new(1.0, 0.0));
    problem
        .add_residual(leaning(), &[block.id()], Kernel::Squared)
        .expect("blocks fit");
    problem
        .set_constant_components(block, &[0])
        .expect("a component");
    solve(&mut problem, &exact()).expect("solves");
    assert_eq!(problem.value(block).x, 1.0);
    assert!((problem.value(block).y - 4.5).abs() < 1e-8);

    problem
        .set_constant_components(block, &[0, 1])
        .expect("components");
    solve(&mut problem, &exact()).expect("nothing to do");
    problem
        .set_constant_components(block, &[])
        .expect("no component");
    solve(&mut problem, &exact()).expect("solves");
    assert!((problem.value(block) - Vector2::new(4.0, 3.0)).norm() < 1e-7);
}

/// A pose held in rotation about z and translation along x, in its own frame.
#[test]
fn components_of_a_pose_are_held_in_its_frame() {
    let mut problem = Problem::new();
    let pose = problem.add_block(Se3::identity());
    let known = Se3::exp(&Vector6::new(0.0, 0.0, 0.4, 1.0, 2.0, 3.0));
    let prior = PosePrior::isotropic(known, 0.1, 0.1);
    problem
        .add_residual(prior, &[pose.id()], Kernel::Squared)
        .expect("blocks fit");
    problem
        .set_constant_components(pose, &[0, 1, 2, 3])
        .expect("components");
    solve(&mut problem, &exact()).expect("solves");
    let found = problem.value(pose);
    assert_eq!((found.rotation.angle(), found.translation.x), (0.0, 0.0));
    let rest = found.translation - known.translation;
    assert!(rest.y.abs() < 1e-9 && rest.z.abs() < 1e-9, "{rest}");
}

#[test]
fn points_with_held_components_are_still_solved() {
    let mut problem = Problem::new();
    let point = problem.add_eliminated_point(Vector3::new(0.0, 0.0, 7.0));
    let pull = VectorPrior::new(Vector3::new(1.0, 2.0, 3.0), Vector3::repeat(1.0));
    problem
        .add_residual(pull, &[point.id()], Kernel::Squared)
        .expect("blocks fit");
    problem
        .set_constant_components(point, &[2])
        .expect("a component");
    solve(&mut problem, &exact()).expect("solves");
    assert!((problem.value(point) - Vector3::new(1.0, 2.0, 7.0)).norm() < 1e-6);
}

#[test]
fn directions_are_searched_on_the_sphere() {
    let goal = UnitVector3::new_normalize(Vector3::new(0.2, -0.5, -0.8));
    for start in [Vector3::z(), -Vector3::z(), Vector3::new(-0.2, 0.4, 0.9)] {
        let mut problem = Problem::new();
        let direction = problem.add_block(UnitVector3::new_normalize(start));
        let prior = DirectionPrior {
            value: goal,
            sigma_rad: 0.1,
        };
        problem
            .add_residual(prior, &[direction.id()], Kernel::Squared)
            .expect("blocks fit");
        solve(&mut problem, &exact()).expect("solves");
        let found = problem.value(direction);
        assert!(
            (found.into_inner() - goal.into_inner()).norm() < 1e-7,
            "{found:?}"
        );
        assert!((found.norm() - 1.0).abs() < 1e-15);
    }
}

#[test]
fn wrong_components_and_bounds_are_refused() {
    let mut problem = Problem::new();
    let block = problem.add_block(Vector2::zeros());
    assert!(matches!(
        problem.set_constant_components(block, &[2]),
        Err(Error::UnknownComponent {
            component: 2,
            components: 2,
            ..
        })
    ));
    for (lower, upper) in [(1.0, 0.0), (f64::NAN, 1.0)] {
        assert!(matches!(
            problem.set_bounds(block, 0, lower, upper),
            Err(Error::EmptyBounds { .. })
        ));
    }
    let kernel = Kernel::Huber { scale: 0.0 };
    assert!(matches!(
        problem.add_residual(leaning(), &[block.id()], kernel),
        Err(Error::Setting(refused)) if refused.field == "kernel.scale"
    ));
}

/// One scale for two blocks: their product is known, neither of them is.
struct Product;

impl Residual for Product {
    fn dimension(&self) -> usize {
        1
    }
    fn blocks(&self) -> &[Shape] {
        const {
            &[
                Shape::of::<SVector<f64, 1>>(),
                Shape::of::<SVector<f64, 3>>(),
            ]
        }
    }
    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (a, b): (SVector<f64, 1>, Vector3<f64>) = (parameters.get(0), parameters.get(1));
        out.set_residual(&SVector::<f64, 1>::new(a.x * b.x - 6.0));
        out.set_jacobian(0, &SVector::<f64, 1>::new(b.x));
        out.set_jacobian(1, &nalgebra::RowVector3::new(a.x, 0.0, 0.0));
        Ok(())
    }
}

#[test]
fn what_the_data_does_not_determine_is_named() {
    let mut problem = Problem::new();
    let scale = problem.add_block(SVector::<f64, 1>::new(2.0));
    let camera = problem.add_block(Vector3::new(2.9, 1.0, 1.0));
    problem.set_name(camera.id(), "camera 2");
    problem.set_component_names(camera.id(), &["baseline", "focal length", "k1"]);
    problem
        .add_residual(Product, &[scale.id(), camera.id()], Kernel::Squared)
        .expect("blocks fit");
    let known = VectorPrior::new(SVector::<f64, 1>::new(2.0), SVector::<f64, 1>::new(0.1));
    problem
        .add_residual(known, &[scale.id()], Kernel::Squared)
        .expect("blocks fit");
    let report = solve(&mut problem, &exact()).expect("solves");
    assert!(report.final_cost < 1e-12);
    let said: Vec<String> = report.undetermined.iter().map(|u| u.to_string()).collect();
    assert_eq!(
        said,
        [
            "camera 2 focal length is not determined by this data",
            "camera 2 k1 is not determined by this data"
        ]
    );
    let third = VectorPrior {
        value: SVector::<f64, 3>::zeros(),
        sqrt_information: nalgebra::Matrix3::identity(),
    };
    problem
        .add_residual(third, &[camera.id()], Kernel::Squared)
        .expect("blocks fit");
    let report = solve(&mut problem, &exact()).expect("solves");
    assert!(report.undetermined.is_empty());
    assert!(report.condition.is_some_and(|c| c < 1e4), "{report:?}");
}

#[test]
fn a_point_seen_along_one_line_is_named() {
    let mut problem = Problem::new();
    let point = problem.add_eliminated_point(Vector3::new(1.0, 1.0, 1.0));
    problem.set_name(point.id(), "point 17");
    let flat = VectorPrior {
        value: Vector3::zeros(),
        sqrt_information: nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, 0.0, 1.0)),
    };
    problem
        .add_residual(flat, &[point.id()], Kernel::Squared)
        .expect("blocks fit");
    let report = solve(&mut problem, &exact()).expect("solves");
    assert_eq!(report.undetermined.len(), 1);
    assert_eq!(
        report.undetermined[0].to_string(),
        "point 17 component 1 is not determined by this data"
    );
}
