//! Problems that are wrong or hard: a named error or the right answer, never a panic or a silent NaN.

use lsfb_geometry::{Se3, Vector2, Vector3, Vector6};
use lsfb_solver::{
    Error, Kernel, LinearSolver, Linearization, Method, Parameters, Problem, Report, Residual,
    Shape, SolveConfig, Termination, Undefined, VectorPrior, solve,
};
use nalgebra::SMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Where a camera sees a point, one unit in front of it; undefined behind. Blocks: `world_from_camera`, point.
struct Sight {
    seen: Vector2<f64>,
}

impl Residual for Sight {
    fn dimension(&self) -> usize {
        2
    }
    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<Vector3<f64>>()] }
    }
    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (pose, point): (Se3, Vector3<f64>) = (parameters.get(0), parameters.get(1));
        let p = pose.inverse() * point;
        if !(p.z > 1e-3) {
            return Err(Undefined);
        }
        out.set_residual(&(Vector2::new(p.x, p.y) / p.z - self.seen));
        let by_p = SMatrix::<f64, 2, 3>::new(
            1.0 / p.z,
            0.0,
            -p.x / (p.z * p.z),
            0.0,
            1.0 / p.z,
            -p.y / (p.z * p.z),
        );
        let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
        by_pose
            .fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&(by_p * lsfb_geometry::so3::hat(&p)));
        by_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&-by_p);
        out.set_jacobian(0, &by_pose);
        out.set_jacobian(1, &(by_p * pose.rotation_matrix().transpose()));
        Ok(())
    }
}

fn configs() -> Vec<SolveConfig> {
    let mut all = Vec::new();
    for method in [Method::LevenbergMarquardt, Method::Dogleg] {
        for linear_solver in [
            LinearSolver::Dense,
            LinearSolver::Sparse,
            LinearSolver::Iterative,
        ] {
            all.push(SolveConfig {
                method,
                linear_solver,
                ..SolveConfig::default()
            });
        }
    }
    all
}

fn is_sound(problem: &Problem, report: &Report) {
    assert!(problem.stored_values().iter().all(|x| x.is_finite()));
    assert!(report.final_cost.is_finite() && report.final_cost <= report.initial_cost);
    assert!(report.gradient_max_norm.is_finite() && report.step_norm.is_finite());
    assert!(report.condition.is_none_or(|c| c >= 0.0));
}

/// Three cameras in a row, the points before them; every third point is behind all cameras.
fn sights(weight: f64) -> Problem {
    let mut problem = Problem::new();
    let poses: Vec<_> = (0..3)
        .map(|k| {
            let x = 0.4 * k as f64;
            problem.add_block(Se3::exp(&Vector6::new(
                0.0,
                0.01 * x,
                0.0,
                x + 0.02,
                0.0,
                0.0,
            )))
        })
        .collect();
    problem.set_constant(poses[0]);
    for j in 0..12 {
        let t = j as f64;
        let depth = if j % 3 == 2 { -4.0 } else { 4.0 };
        let truth = Vector3::new(t.sin(), t.cos(), depth + 0.5 * (2.0 * t).sin());
        let point = problem.add_eliminated_point(truth + Vector3::repeat(0.02));
        for (k, pose) in poses.iter().enumerate() {
            let p = truth - Vector3::new(0.4 * k as f64, 0.0, 0.0);
            let seen = Sight {
                seen: weight * Vector2::new(p.x, p.y) / p.z,
            };
            problem
                .add_residual(seen, &[pose.id(), point.id()], Kernel::Squared)
                .expect("blocks fit");
        }
    }
    problem
}

#[test]
fn points_behind_every_camera_are_counted() {
    for config in configs() {
        let mut problem = sights(1.0);
        let report = solve(&mut problem, &config).expect("solves");
        is_sound(&problem, &report);
        assert_eq!(report.undefined_at_start, 12, "{config:?}");
        assert!(
            report.final_cost < 1e-3 * report.initial_cost,
            "{config:?} {report:?}"
        );
    }
}

#[test]
fn a_problem_that_is_nowhere_defined_stays_where_it_is() {
    for config in configs() {
        let mut problem = Problem::new();
        let pose = problem.add_block(Se3::identity());
        let point = problem.add_eliminated_point(Vector3::new(0.0, 0.0, -2.0));
        let seen = Vector2::zeros();
        problem
            .add_residual(Sight { seen }, &[pose.id(), point.id()], Kernel::Squared)
            .expect("blocks fit");
        let report = solve(&mut problem, &config).expect("solves");
        is_sound(&problem, &report);
        assert_eq!((report.undefined_at_start, report.final_cost), (1, 0.0));
        assert_eq!(problem.value(pose), Se3::identity());
    }
}

#[test]
fn not_a_number_is_named_wherever_it_hides() {
    for config in configs() {
        let mut problem = sights(f64::NAN);
        let error = solve(&mut problem, &config).expect_err("a measurement is NaN");
        assert!(
            matches!(&error, Error::ResidualNotFinite { residual: 0, blocks } if blocks == &[0, 3]),
            "{error}"
        );
        let mut problem = Problem::new();
        problem.add_eliminated_point(Vector3::new(0.0, f64::INFINITY, 0.0));
        assert_eq!(
            solve(&mut problem, &config),
            Err(Error::BlockNotFinite { block: 0 })
        );
    }
}

#[test]
fn all_weights_zero_move_nothing_and_every_parameter_is_named() {
    for config in configs() {
        let mut problem = Problem::new();
        let block = problem.add_block(Vector3::new(1.0, 2.0, 3.0));
        let nothing = VectorPrior {
            value: Vector3::zeros(),
            sqrt_information: nalgebra::Matrix3::zeros(),
        };
        problem
            .add_residual(nothing, &[block.id()], Kernel::Squared)
            .expect("blocks fit");
        let report = solve(&mut problem, &config).expect("solves");
        is_sound(&problem, &report);
        assert_eq!(report.termination, Termination::GradientTolerance);
        assert_eq!(problem.value(block), Vector3::new(1.0, 2.0, 3.0));
        if config.linear_solver != LinearSolver::Iterative {
            assert_eq!(report.undetermined.len(), 3, "{config:?} {report:?}");
        }
    }
}

#[test]
fn two_parts_that_share_nothing_are_both_solved() {
    for config in configs() {
        let mut problem = Problem::new();
        let goals = [Vector3::new(1.0, 2.0, 3.0), Vector3::new(1e4, -1e4, 5.0)];
        let blocks = goals.map(|_| problem.add_block(Vector3::zeros()));
        let alone = problem.add_block(Vector3::repeat(9.0));
        for (goal, block) in goals.iter().zip(blocks) {
            let prior = VectorPrior::new(*goal, Vector3::new(1.0, 1e3, 1e-3));
            problem
                .add_residual(prior, &[block.id()], Kernel::Squared)
                .expect("blocks fit");
        }
        let report = solve(&mut problem, &config).expect("solves");
        is_sound(&problem, &report);
        assert_eq!(report.untouched_blocks, 1);
        assert_eq!(problem.value(alone), Vector3::repeat(9.0));
        for (goal, block) in goals.iter().zip(blocks) {
            let error = problem.value(block) - goal;
            assert!(error.norm() < 1e-2 * goal.norm(), "{config:?} {error}");
        }
    }
}

/// Six of ten measurements of a position lie anywhere; graduation finds the others from a start at one of the wrong
/// ones, where the kernel alone stays.
#[test]
fn sixty_percent_outliers_are_left_out_by_graduation() {
    let mut rng = ChaCha8Rng::seed_from_u64(60);
    let mut uniform = |half: f64| (rng.random::<f64>() * 2.0 - 1.0) * half;
    let truth = Vector3::new(3.0, -2.0, 1.0);
    let mut problem = Problem::new();
    let start = Vector3::new(-20.0, 15.0, 9.0);
    let block = problem.add_block(start);
    for k in 0..200 {
        let value = if k == 0 {
            start
        } else if k % 5 < 3 {
            Vector3::new(uniform(30.0), uniform(30.0), uniform(30.0))
        } else {
            truth + Vector3::new(uniform(0.05), uniform(0.05), uniform(0.05))
        };
        let prior = VectorPrior::new(value, Vector3::repeat(1.0));
        let kernel = Kernel::GemanMcClure { scale: 0.1 };
        problem
            .add_residual(prior, &[block.id()], kernel)
            .expect("blocks fit");
    }
    let plain = SolveConfig::default();
    solve(&mut problem, &plain).expect("solves");
    assert!(
        (problem.value(block) - truth).norm() > 1.0,
        "no need of graduation"
    );

    problem.set_value(block, &start);
    let config = SolveConfig {
        graduation: 1.4,
        ..plain
    };
    let report = solve(&mut problem, &config).expect("solves");
    assert!((problem.value(block) - truth).norm() < 0.02, "{report:?}");
    assert!(report.graduation_steps > 10 && report.final_cost < report.initial_cost);
}

#[test]
fn the_observer_can_stop_a_solve() {
    let mut problem = sights(1.0);
    let mut calls = 0;
    let report = lsfb_solver::solve_controlled(&mut problem, &SolveConfig::default(), &mut |_| {
        calls += 1;
        std::ops::ControlFlow::Break(())
    })
    .expect("solves");
    assert_eq!(
        (report.termination, report.iterations, calls),
        (Termination::Stopped, 1, 1)
    );
    assert!(report.final_cost < report.initial_cost);
    is_sound(&problem, &report);
}

#[test]
fn removed_residuals_and_blocks_are_out() {
    let mut problem = Problem::new();
    let block = problem.add_block(Vector3::zeros());
    let other = problem.add_block(Vector3::zeros());
    let pull = |to: f64| VectorPrior::new(Vector3::repeat(to), Vector3::repeat(1.0));
    let good = problem.add_residual(pull(1.0), &[block.id()], Kernel::Squared);
    let bad = problem.add_residual(pull(9.0), &[block.id()], Kernel::Squared);
    problem
        .add_residual(pull(5.0), &[other.id()], Kernel::Squared)
        .expect("blocks fit");
    problem.remove_residual(bad.expect("blocks fit"));
    problem.remove_block(other);
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert_eq!((report.residuals, report.reduced_dimension), (1, 3));
    assert!((problem.value(block) - Vector3::repeat(1.0)).norm() < 1e-6);
    assert_eq!(problem.value(other), Vector3::zeros());
    assert!(matches!(
        problem.add_residual(pull(5.0), &[other.id()], Kernel::Squared),
        Err(Error::UnknownBlock { block: 1, .. })
    ));
    problem.remove_residual(good.expect("blocks fit"));
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert_eq!(report.termination, Termination::NothingFree);
}
