use lsfb_geometry::{Matrix3, Se3, Vector3, Vector6, so3};
use lsfb_solver::{
    Error, Kernel, Linearization, Parameters, Problem, Residual, Shape, SolveConfig, Termination,
    Undefined, check_residual_jacobian, solve,
};
use nalgebra::{SMatrix, SVector};

type Scalar = SVector<f64, 1>;

/// `weight (x − target)`, undefined below `lowest`.
struct Pull {
    target: f64,
    weight: f64,
    lowest: f64,
}

impl Pull {
    fn to(target: f64) -> Self {
        Self {
            target,
            weight: 1.0,
            lowest: f64::NEG_INFINITY,
        }
    }
}

impl Residual for Pull {
    fn dimension(&self) -> usize {
        1
    }
    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Scalar>()] }
    }
    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let x: Scalar = parameters.get(0);
        if x[0] < self.lowest {
            return Err(Undefined);
        }
        out.set_residual(&Scalar::new(self.weight * (x[0] - self.target)));
        out.set_jacobian(0, &Scalar::new(self.weight));
        Ok(())
    }
}

/// `world_from_a⁻¹ p − measured`, from a pose and a point.
struct Seen {
    measured: Vector3<f64>,
}

impl Residual for Seen {
    fn dimension(&self) -> usize {
        3
    }
    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<Vector3<f64>>()] }
    }
    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let pose: Se3 = parameters.get(0);
        let point: Vector3<f64> = parameters.get(1);
        let seen = pose.inverse() * point;
        out.set_residual(&(seen - self.measured));
        let mut by_pose = SMatrix::<f64, 3, 6>::zeros();
        by_pose
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&so3::hat(&seen));
        by_pose
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&-Matrix3::identity());
        out.set_jacobian(0, &by_pose);
        out.set_jacobian(1, &pose.rotation_matrix().transpose());
        Ok(())
    }
}

/// A Jacobian with a wrong sign.
struct Wrong;

impl Residual for Wrong {
    fn dimension(&self) -> usize {
        1
    }
    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Scalar>()] }
    }
    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let x: Scalar = parameters.get(0);
        out.set_residual(&(x * 2.0));
        out.set_jacobian(0, &Scalar::new(-2.0));
        Ok(())
    }
}

fn one(start: f64, pulls: Vec<(Pull, Kernel)>) -> (Problem, lsfb_solver::Block<Scalar>) {
    let mut problem = Problem::new();
    let x = problem.add_block(Scalar::new(start));
    for (pull, kernel) in pulls {
        problem
            .add_residual(pull, &[x.id()], kernel)
            .expect("blocks fit");
    }
    (problem, x)
}

#[test]
fn robust_kernels_find_the_middle_of_many() {
    for kernel in [
        Kernel::Huber { scale: 0.1 },
        Kernel::Cauchy { scale: 0.1 },
        Kernel::GemanMcClure { scale: 0.3 },
    ] {
        let targets = [1.0, 1.01, 0.99, 1.02, 0.98, 9.0, -30.0];
        let pulls = targets.map(|t| (Pull::to(t), kernel)).into();
        let (mut problem, x) = one(1.3, pulls);
        let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
        assert!(
            (problem.value(x)[0] - 1.0).abs() < 0.02,
            "{kernel:?} {report:?}"
        );
    }
}

#[test]
fn nothing_to_do_is_no_error() {
    let mut empty = Problem::new();
    let report = solve(&mut empty, &SolveConfig::default()).expect("solves");
    assert_eq!(report.termination, Termination::NothingFree);

    let (mut problem, x) = one(5.0, vec![]);
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert_eq!(report.termination, Termination::NothingFree);
    assert_eq!((report.untouched_blocks, problem.value(x)[0]), (1, 5.0));

    let (mut problem, x) = one(5.0, vec![(Pull::to(1.0), Kernel::Squared)]);
    problem.set_constant(x);
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert_eq!((report.final_cost, problem.value(x)[0]), (8.0, 5.0));
    problem.set_free(x);
    solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert!((problem.value(x)[0] - 1.0).abs() < 1e-6);
}

#[test]
fn a_block_without_residuals_stays_while_others_move() {
    let (mut problem, x) = one(5.0, vec![(Pull::to(1.0), Kernel::Squared)]);
    let alone = problem.add_block(Se3::identity());
    let point = problem.add_eliminated_point(Vector3::new(1.0, 2.0, 3.0));
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert_eq!(report.untouched_blocks, 2);
    assert!((problem.value(x)[0] - 1.0).abs() < 1e-6);
    assert_eq!(problem.value(alone), Se3::identity());
    assert_eq!(problem.value(point), Vector3::new(1.0, 2.0, 3.0));
}

#[test]
fn zero_weights_move_nothing() {
    let pull = Pull {
        weight: 0.0,
        ..Pull::to(1.0)
    };
    let (mut problem, x) = one(5.0, vec![(pull, Kernel::Squared)]);
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert_eq!(report.termination, Termination::GradientTolerance);
    assert_eq!((report.final_cost, problem.value(x)[0]), (0.0, 5.0));
}

#[test]
fn what_is_not_finite_is_named() {
    let (mut problem, _) = one(f64::NAN, vec![(Pull::to(1.0), Kernel::Squared)]);
    assert_eq!(
        solve(&mut problem, &SolveConfig::default()),
        Err(Error::BlockNotFinite { block: 0 })
    );
    let pulls = vec![
        (Pull::to(1.0), Kernel::Squared),
        (Pull::to(f64::NAN), Kernel::Squared),
    ];
    let (mut problem, x) = one(3.0, pulls);
    let expected = Error::ResidualNotFinite {
        residual: 1,
        blocks: vec![0],
    };
    assert_eq!(solve(&mut problem, &SolveConfig::default()), Err(expected));
    assert_eq!(problem.value(x)[0], 3.0);
    let config = SolveConfig {
        initial_damping: f64::NAN,
        ..Default::default()
    };
    assert!(matches!(
        solve(&mut problem, &config),
        Err(Error::Setting(refused)) if refused.field == "initial_damping"
    ));
}

#[test]
fn undefined_residuals_are_left_out_and_counted() {
    let behind = Pull {
        lowest: 100.0,
        ..Pull::to(50.0)
    };
    let pulls = vec![(behind, Kernel::Squared), (Pull::to(1.0), Kernel::Squared)];
    let (mut problem, x) = one(5.0, pulls);
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert_eq!((report.undefined_at_start, report.undefined_at_end), (1, 0));
    assert!((problem.value(x)[0] - 1.0).abs() < 1e-6);

    // One that becomes undefined on the way does not hold the others up.
    let edge = Pull {
        lowest: 4.0,
        ..Pull::to(4.5)
    };
    let pulls = vec![
        (edge, Kernel::Squared),
        (
            Pull {
                weight: 10.0,
                ..Pull::to(1.0)
            },
            Kernel::Squared,
        ),
    ];
    let (mut problem, x) = one(5.0, pulls);
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert_eq!((report.undefined_at_start, report.undefined_at_end), (0, 1));
    assert!((problem.value(x)[0] - 1.0).abs() < 1e-4, "{report:?}");
}

#[test]
fn wrong_blocks_are_refused() {
    let mut problem = Problem::new();
    let x = problem.add_block(Scalar::new(1.0));
    let pose = problem.add_block(Se3::identity());
    let point = problem.add_eliminated_point(Vector3::zeros());
    let mut other = Problem::new();
    let far = (0..9)
        .map(|k| other.add_block(Scalar::new(k as f64)))
        .last();
    let far = far.expect("nine blocks");
    let seen = || Seen {
        measured: Vector3::zeros(),
    };
    let squared = Kernel::Squared;
    assert!(matches!(
        problem.add_residual(Pull::to(0.0), &[pose.id()], squared),
        Err(Error::BlockShape {
            residual: 0,
            position: 0,
            ..
        })
    ));
    assert!(matches!(
        problem.add_residual(Pull::to(0.0), &[x.id(), x.id()], squared),
        Err(Error::BlockCount {
            expected: 1,
            got: 2,
            ..
        })
    ));
    assert!(matches!(
        problem.add_residual(Pull::to(0.0), &[far.id()], squared),
        Err(Error::UnknownBlock {
            block: 8,
            blocks: 3
        })
    ));
    assert!(
        problem
            .add_residual(seen(), &[pose.id(), point.id()], squared)
            .is_ok()
    );
    assert_eq!(problem.residual_count(), 1);
}

#[test]
#[should_panic(
    expected = "JacobianMismatch { residual: 0, position: 0, row: 0, column: 0, analytic: -2.0"
)]
fn wrong_jacobians_are_found() {
    let mut problem = Problem::new();
    let x = problem.add_block(Scalar::new(1.0));
    problem
        .add_residual(Wrong, &[x.id()], Kernel::Squared)
        .expect("blocks fit");
    check_residual_jacobian!(all of problem);
}

#[test]
fn solving_with_a_wrong_jacobian_ends_without_a_step() {
    let mut problem = Problem::new();
    let x = problem.add_block(Scalar::new(1.0));
    problem
        .add_residual(Wrong, &[x.id()], Kernel::Squared)
        .expect("blocks fit");
    let report = solve(&mut problem, &SolveConfig::default()).expect("ends");
    assert_eq!(report.termination, Termination::NoDecrease);
    assert_eq!(problem.value(x)[0], 1.0);
}

/// Two groups of poses and points that share nothing, with no pose held: solved, eliminated or not.
#[test]
fn free_gauge_and_separate_groups_are_solved() {
    let truth = |group: usize, k: usize| {
        let s = (group * 7 + k * 3) as f64;
        Se3::exp(&Vector6::new(
            0.1 * s.sin(),
            0.2 * s.cos(),
            0.05 * s,
            s.sin(),
            0.1 * s,
            0.3,
        ))
    };
    let mut finals = Vec::new();
    for eliminate in [false, true] {
        let mut problem = Problem::new();
        let mut poses = Vec::new();
        for group in 0..2 {
            let own: Vec<_> = (0..3)
                .map(|k| {
                    let start = truth(group, k) * Se3::exp(&(Vector6::repeat(0.02) * k as f64));
                    problem.add_block(start)
                })
                .collect();
            for j in 0..8 {
                let t = (j + group) as f64;
                let point = Vector3::new(t.sin() * 3.0, t.cos() * 2.0, (2.0 * t).sin());
                let start = point + Vector3::repeat(0.05 * t.sin());
                let block = if eliminate {
                    problem.add_eliminated_point(start)
                } else {
                    problem.add_block(start)
                };
                for (k, pose) in own.iter().enumerate() {
                    let measured = truth(group, k).inverse() * point;
                    problem
                        .add_residual(Seen { measured }, &[pose.id(), block.id()], Kernel::Squared)
                        .expect("blocks fit");
                }
            }
            poses.push(own);
        }
        check_residual_jacobian!(all of problem);
        let config = SolveConfig {
            cost_tolerance: 0.0,
            ..Default::default()
        };
        let report = solve(&mut problem, &config).expect("solves");
        assert!(
            report.final_cost < 1e-16 * report.initial_cost,
            "{report:?}"
        );
        for (group, own) in poses.iter().enumerate() {
            let found = problem.value(own[0]).inverse() * problem.value(own[2]);
            let expected = truth(group, 0).inverse() * truth(group, 2);
            assert!((expected.inverse() * found).log().norm() < 1e-8);
        }
        finals.push(
            poses
                .iter()
                .flatten()
                .map(|p| problem.value(*p))
                .collect::<Vec<_>>(),
        );
    }
    // Eliminating points is only algebra: the same steps, the same result.
    for (a, b) in finals[0].iter().zip(&finals[1]) {
        assert!((a.inverse() * *b).log().norm() < 1e-7);
    }
}
