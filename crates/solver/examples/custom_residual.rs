//! A residual of one's own: the centre and the radius of a round column from a few LiDAR returns of it, one of which met something
//! else; how well they are known; and a test of the Jacobian.
//!
//! ```sh
//! cargo run --release -p lsfb-solver --example custom_residual
//! ```

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use lsfb_geometry::{Vector2, Vector3};
use lsfb_solver::{
    Kernel, Linearization, Parameters, Problem, Residual, Shape, SolveConfig, Undefined,
    covariance, solve,
};
use nalgebra::{RowVector3, SVector};

/// Standard deviation of a range, metres.
const SIGMA_M: f64 = 0.03;

/// How far a return lies from the circle `[x, y, radius]`, in standard deviations.
struct Return {
    seen_m: Vector2<f64>,
}

impl Residual for Return {
    fn dimension(&self) -> usize {
        1
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Vector3<f64>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let circle: Vector3<f64> = parameters.get(0);
        let from_centre = self.seen_m - circle.xy();
        let distance_m = from_centre.norm();
        if distance_m == 0.0 {
            return Err(Undefined);
        }
        let direction = from_centre / distance_m;
        out.set_residual(&SVector::<f64, 1>::new((distance_m - circle.z) / SIGMA_M));
        let jacobian = RowVector3::new(-direction.x, -direction.y, -1.0) / SIGMA_M;
        out.set_jacobian(0, &jacobian);
        Ok(())
    }
}

fn main() -> Result<(), lsfb_solver::Error> {
    // About half of the column is seen.
    let returns = (0..24).map(|k| {
        let angle = 0.15 * f64::from(k);
        let noise_m = SIGMA_M * (7.0 * angle).sin();
        let radius_m = if k == 5 { 1.1 } else { 0.3 + noise_m };
        Vector2::new(2.0 + radius_m * angle.cos(), 1.0 + radius_m * angle.sin())
    });
    let returns: Vec<Vector2<f64>> = returns.collect();
    // From the far side of the returns a circle would bend the other way: the search starts among them.
    let middle = returns.iter().sum::<Vector2<f64>>() / returns.len() as f64;
    let mut problem = Problem::new();
    let circle = problem.add_block(Vector3::new(middle.x, middle.y, 0.2));
    problem.set_name(circle.id(), "column");
    problem.set_component_names(circle.id(), &["x", "y", "radius"]);
    for seen_m in returns {
        let kernel = Kernel::Cauchy { scale: 2.0 };
        problem.add_residual(Return { seen_m }, &[circle.id()], kernel)?;
    }
    lsfb_solver::check_residual_jacobian!(all of problem);

    let report = solve(&mut problem, &SolveConfig::default())?;
    let found = problem.value(circle);
    let variances = covariance(&problem, &[circle.id()])?.joint().diagonal();
    for (name, k) in [("x", 0), ("y", 1), ("radius", 2)] {
        println!("{name:6} {:.3} ± {:.3} m", found[k], variances[k].sqrt());
    }
    println!("{} iterations", report.iterations);
    Ok(())
}
