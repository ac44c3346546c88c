//! Residuals that share what they hold.

use std::sync::Arc;

use lsfb_geometry::Vector3;
use lsfb_solver::{
    Error, Kernel, Linearization, Parameters, Problem, Residual, ResidualSet, Shape, SolveConfig,
    Undefined, solve,
};
use nalgebra::Matrix3;

/// Where a point was measured.
#[derive(Clone)]
struct Measured(Vector3<f64>);

impl Residual for Measured {
    fn dimension(&self) -> usize {
        3
    }
    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Vector3<f64>>()] }
    }
    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        out.set_residual(&(parameters.get::<Vector3<f64>>(0) - self.0));
        out.set_jacobian(0, &Matrix3::identity());
        Ok(())
    }
}

struct AllMeasured(Vec<Measured>);

impl ResidualSet for AllMeasured {
    fn dimension(&self) -> usize {
        3
    }
    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Vector3<f64>>()] }
    }
    fn evaluate(
        &self,
        number: u32,
        parameters: &Parameters,
        out: &mut Linearization,
    ) -> Result<(), Undefined> {
        let measured = self.0.get(number as usize).ok_or(Undefined)?;
        measured.evaluate(parameters, out)
    }
}

const KERNEL: Kernel = Kernel::Cauchy { scale: 1.0 };

fn measured() -> Vec<Measured> {
    let far = Vector3::new(90.0, -40.0, 7.0);
    let near = (0..6).map(|k| Vector3::new(1.0, 2.0, 0.1 * f64::from(k)));
    near.chain([far]).map(Measured).collect()
}

#[test]
fn a_set_is_the_same_as_each_by_itself_bit_for_bit() {
    let config = SolveConfig::default();
    let mut apart = Problem::new();
    let point = apart.add_block(Vector3::zeros());
    for one in measured() {
        apart
            .add_residual(one, &[point.id()], KERNEL)
            .expect("fits");
    }
    let apart_report = solve(&mut apart, &config).expect("solvable");

    let mut together = Problem::new();
    let point = together.add_block(Vector3::zeros());
    let set: Arc<dyn ResidualSet> = Arc::new(AllMeasured(measured()));
    for number in 0..measured().len() as u32 {
        let added = together.add_residual_of(set.clone(), number, &[point.id()], KERNEL);
        added.expect("fits");
    }
    let report = solve(&mut together, &config).expect("solvable");
    assert_eq!(together.stored_values(), apart.stored_values());
    assert_eq!(
        report.final_cost.to_bits(),
        apart_report.final_cost.to_bits()
    );
}

/// A number that the set does not have is left out, as all that is undefined where a solve begins; blocks are checked as ever.
#[test]
fn a_number_that_is_not_there_says_nothing() {
    let mut problem = Problem::new();
    let point = problem.add_block(Vector3::zeros());
    let set: Arc<dyn ResidualSet> = Arc::new(AllMeasured(measured()));
    for number in [0, 99] {
        let added = problem.add_residual_of(set.clone(), number, &[point.id()], Kernel::Squared);
        added.expect("fits");
    }
    solve(&mut problem, &SolveConfig::default()).expect("solvable");
    assert!((problem.value(point) - measured()[0].0).norm() < 1e-6);
    let none = problem.add_residual_of(set, 0, &[], Kernel::Squared);
    assert!(matches!(none, Err(Error::BlockCount { .. })), "{none:?}");
}
