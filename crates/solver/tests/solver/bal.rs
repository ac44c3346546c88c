//! A real bundle adjustment problem in the large (BAL), with the optimum that two other programs found.

use lsfb_geometry::{Vector2, Vector3, so3};
use lsfb_problems::bal::{self, BalProblem, parse};
use lsfb_solver::{Kernel, SolveConfig, check_residual_jacobian, solve};

use crate::recordings;

/// The real problem; `None`, with a line, where it is absent.
pub fn ladybug(test: &str) -> Option<BalProblem> {
    let text = recordings::text(test, "vision/ba/problem-16-22106-pre.txt.gz")?;
    Some(parse(&text, Kernel::Squared).expect("a BAL file"))
}

#[test]
fn ladybug_reaches_the_known_optimum() {
    let Some(BalProblem { mut problem, .. }) = ladybug("ladybug_reaches_the_known_optimum") else {
        return;
    };
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert!((report.initial_cost - 4_185_659.518).abs() < 1e-2);
    assert!((report.final_cost / 18_033.9 - 1.0).abs() < 1e-3);
    assert_eq!(report.undefined_at_start, 0);
    assert_eq!(
        (report.reduced_dimension, report.eliminated_points),
        (144, 22_106)
    );
    // Nothing holds the world in place: three rotations, three translations and the scale are free.
    assert_eq!(report.undetermined.len(), 7, "{:?}", report.undetermined);
}

check_residual_jacobian!(
    bal_jacobians_match_differences,
    bal::BalObservation {
        pixel: Vector2::new(-300.0, 120.0)
    },
    bal::BalCamera {
        camera_from_world: so3::exp(&Vector3::new(0.1, -0.2, 0.3)),
        translation: Vector3::new(0.5, -0.4, -5.0),
        intrinsics: Vector3::new(500.0, -0.1, 0.02),
    },
    Vector3::new(1.0, 2.0, -3.0),
);
