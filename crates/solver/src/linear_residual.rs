//! A residual for tests whose answer is known in closed form.

use nalgebra::{SMatrix, Vector2, Vector3};

use crate::{Linearization, Parameters, Residual, Shape, Undefined};

/// `A x + B p − z` of a block and a point.
pub(crate) struct Linear {
    pub a: SMatrix<f64, 2, 2>,
    pub b: SMatrix<f64, 2, 3>,
    pub z: Vector2<f64>,
}

impl Residual for Linear {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Vector2<f64>>(), Shape::of::<Vector3<f64>>()] }
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let (x, p): (Vector2<f64>, Vector3<f64>) = (parameters.get(0), parameters.get(1));
        out.set_residual(&(self.a * x + self.b * p - self.z));
        out.set_jacobian(0, &self.a);
        out.set_jacobian(1, &self.b);
        Ok(())
    }
}
