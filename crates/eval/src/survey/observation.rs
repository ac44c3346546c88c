//! One term of Eq. (6): a distance, or the deviation of two marks from a line, each over its standard deviation.

use lsfb_geometry::Vector2;
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{RowVector2, Vector1};

/// What is compared of two marks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Quantity {
    /// Their distance, metres.
    Distance(f64),
    /// The difference of their y, which is zero.
    SameY,
    /// The difference of their x, which is zero.
    SameX,
}

/// One equation between two marks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Observation {
    pub quantity: Quantity,
    /// Indices of the marks.
    pub ends: [usize; 2],
    /// Its standard deviation, metres.
    pub sigma_m: f64,
    /// Which tape it comes from.
    pub tape: usize,
}

impl Observation {
    /// Computed less observed, metres, and its derivative by the second mark; by the first it is the negative. `None` where two marks
    /// coincide, and their distance has no direction.
    pub(super) fn linearize(
        &self,
        a: &Vector2<f64>,
        b: &Vector2<f64>,
    ) -> Option<(f64, Vector2<f64>)> {
        let apart = b - a;
        match self.quantity {
            Quantity::Distance(measured_m) => {
                let distance_m = apart.norm();
                (distance_m > 1e-9).then(|| (distance_m - measured_m, apart / distance_m))
            }
            Quantity::SameY => Some((apart.y, Vector2::y())),
            Quantity::SameX => Some((apart.x, Vector2::x())),
        }
    }
}

impl Residual for Observation {
    fn dimension(&self) -> usize {
        1
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Vector2<f64>>(), Shape::of::<Vector2<f64>>()] }
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let (a, b): (Vector2<f64>, Vector2<f64>) = (parameters.get(0), parameters.get(1));
        let (off_m, by_second) = self.linearize(&a, &b).ok_or(Undefined)?;
        out.set_residual(&Vector1::new(off_m / self.sigma_m));
        let row: RowVector2<f64> = by_second.transpose() / self.sigma_m;
        out.set_jacobian(0, &-row);
        out.set_jacobian(1, &row);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn of(quantity: Quantity) -> Observation {
        Observation {
            quantity,
            ends: [0, 1],
            sigma_m: 0.5,
            tape: 0,
        }
    }

    const A: Vector2<f64> = Vector2::new(0.3, -1.0);
    const B: Vector2<f64> = Vector2::new(2.0, 0.7);
    lsfb_solver::check_residual_jacobian!(distance, of(Quantity::Distance(2.0)), A, B);
    lsfb_solver::check_residual_jacobian!(same_y, of(Quantity::SameY), A, B);
    lsfb_solver::check_residual_jacobian!(same_x, of(Quantity::SameX), A, B);
}
