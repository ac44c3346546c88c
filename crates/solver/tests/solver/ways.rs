//! One problem, all the ways to solve it.

use lsfb_solver::{LinearSolver, Method, SolveConfig, solve};

use crate::threads::scattered;

/// Gauge held, so that all ways have one answer.
fn solved(linear_solver: LinearSolver, method: Method) -> (f64, Vec<f64>) {
    let mut scattered = scattered(12, 400);
    let [first, second, ..] = scattered.cameras[..] else {
        panic!("twelve cameras");
    };
    let pose = [0, 1, 2, 3, 4, 5];
    let problem = &mut scattered.problem;
    problem
        .set_constant_components(first, &pose)
        .expect("a camera has a pose");
    problem
        .set_constant_components(second, &[3])
        .expect("a camera has a translation");
    let config = SolveConfig {
        linear_solver,
        method,
        cost_tolerance: 1e-14,
        max_iterations: 200,
        ..SolveConfig::default()
    };
    let before = problem.value(first);
    let report = solve(problem, &config).expect("solves");
    assert_eq!(report.linear_solver, linear_solver);
    let after = problem.value(first);
    // To the last bit but for the length of the quaternion.
    assert!(before.camera_from_world.angle_to(&after.camera_from_world) < 1e-14);
    assert_eq!(before.translation, after.translation);
    assert_ne!(before.intrinsics, after.intrinsics);
    assert!(report.undetermined.is_empty(), "{:?}", report.undetermined);
    (report.final_cost, problem.stored_values().to_vec())
}

#[test]
fn every_way_leads_to_the_same_optimum() {
    let (cost, values) = solved(LinearSolver::Dense, Method::LevenbergMarquardt);
    for (linear_solver, method) in [
        (LinearSolver::Sparse, Method::LevenbergMarquardt),
        (LinearSolver::Iterative, Method::LevenbergMarquardt),
        (LinearSolver::Dense, Method::Dogleg),
    ] {
        let (other_cost, other) = solved(linear_solver, method);
        assert!(
            (other_cost / cost - 1.0).abs() < 1e-8,
            "{linear_solver:?} {method:?}: {other_cost} instead of {cost}"
        );
        let farthest = values.iter().zip(&other).fold(0.0f64, |far, (a, b)| {
            far.max((a - b).abs() / (1.0 + a.abs()))
        });
        assert!(farthest < 1e-3, "{linear_solver:?} {method:?}: {farthest}");
    }
}

#[test]
fn a_reduced_system_that_outgrows_its_memory_is_never_formed() {
    let mut problem = scattered(12, 400).problem;
    let config = SolveConfig {
        max_matrix_bytes: 12 * 9 * 12 * 9,
        ..SolveConfig::default()
    };
    let report = solve(&mut problem, &config).expect("solves");
    assert_eq!(report.linear_solver, LinearSolver::Iterative);
    let formed = solve(&mut scattered(12, 400).problem, &SolveConfig::default()).expect("solves");
    assert_eq!(formed.linear_solver, LinearSolver::Dense);
    assert!((report.final_cost / formed.final_cost - 1.0).abs() < 1e-6);
}
