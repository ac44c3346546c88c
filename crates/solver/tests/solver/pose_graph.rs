//! Pose graphs, and the ways to solve them.

use lsfb_geometry::{Matrix6, Se3, Vector6};
use lsfb_problems::g2o;
use lsfb_solver::{LinearSolver, Method, SolveConfig, check_residual_jacobian, solve};

use crate::recordings;

check_residual_jacobian!(
    between,
    g2o::Between {
        b_from_a_measured: Se3::exp(&Vector6::new(0.3, -0.2, 0.7, 1.0, 2.0, 3.0)),
        sqrt_information: Matrix6::from_fn(|r, c| if r <= c {
            1.0 + (r * c) as f64 * 0.1
        } else {
            0.0
        }),
    },
    Se3::exp(&Vector6::new(-0.4, 1.2, 0.1, 0.5, 0.1, -2.0)),
    Se3::exp(&Vector6::new(0.5, 0.3, -0.8, 1.5, 1.1, 0.3)),
);

check_residual_jacobian!(
    between_near_its_measurement,
    g2o::Between {
        b_from_a_measured: Se3::identity(),
        sqrt_information: Matrix6::identity(),
    },
    Se3::identity(),
    Se3::exp(&Vector6::new(1e-4, -2e-4, 1e-4, 1e-3, 2e-3, 0.0)),
);

/// The optimum that GTSAM 4.3 finds (`benches/solver/gtsam_pose_graph.py`).
#[test]
fn parking_garage_reaches_the_optimum_of_gtsam() {
    let test = "parking_garage_reaches_the_optimum_of_gtsam";
    let Some(text) = recordings::text(test, "vision/posegraph/parking-garage.g2o.gz") else {
        return;
    };
    for (method, linear_solver) in [
        (Method::LevenbergMarquardt, LinearSolver::Auto),
        (Method::Dogleg, LinearSolver::Sparse),
    ] {
        let mut graph = g2o::parse(&text).expect("a pose graph");
        assert_eq!((graph.poses.len(), graph.edges), (1661, 6275));
        let config = SolveConfig {
            method,
            linear_solver,
            cost_tolerance: 1e-9,
            ..SolveConfig::default()
        };
        let report = solve(&mut graph.problem, &config).expect("solves");
        assert_eq!(report.linear_solver, LinearSolver::Sparse);
        assert!(
            (report.initial_cost - 8363.601948).abs() < 1e-4,
            "{report:?}"
        );
        assert!(
            (report.final_cost / 0.634192401 - 1.0).abs() < 1e-6,
            "{report:?}"
        );
        assert!(report.undetermined.is_empty(), "{report:?}");
    }
}
