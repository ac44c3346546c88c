//! One term of Eq. (7): how far the estimate's body is from where the reference has it.
//!
//! `r = log(N_T_A⁻¹ G_T_N(t + t₀)⁻¹ G_T_H H_T_A(t))`, in the body. The paper's order of the same factors has its translation at the
//! world's origin, where an error of rotation grows with the distance from it.

use std::sync::Arc;

use lsfb_geometry::{Se3, Vector2, Vector6, se3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{Matrix6, Matrix6x2};

use super::continuous::Continuous;

/// Which of the two is taken between its poses: the one that has more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Interpolated {
    Reference,
    Estimate,
}

#[derive(Clone, Debug)]
pub(super) struct BodyResidual {
    pub interpolated: Interpolated,
    /// The trajectory that is interpolated.
    pub dense: Arc<Continuous>,
    /// The pose of the other, and its own time, seconds since the base.
    pub pose: Se3,
    pub secs: f64,
    /// Where the clock's drift turns, seconds since the base.
    pub middle_secs: f64,
    /// Standard deviations of each rotation and translation component, rad and metres.
    pub sigmas: [f64; 2],
}

/// What a residual and its derivatives are made of.
struct Terms {
    error: Se3,
    estimate: Se3,
    reference: Se3,
    /// Body velocity of the interpolated one, rad/s and m/s.
    twist: Vector6<f64>,
}

impl BodyResidual {
    /// The same residual of other standard deviations.
    pub fn with(&self, sigmas: [f64; 2]) -> Self {
        Self {
            sigmas,
            ..self.clone()
        }
    }

    /// `[rotation, translation]` in the body, rad and metres. `None` where the other trajectory says nothing.
    pub fn error(&self, world: &Se3, body: &Se3, clock: &Vector2<f64>) -> Option<Vector6<f64>> {
        Some(self.terms(world, body, clock)?.error.log())
    }

    fn terms(&self, world: &Se3, body: &Se3, clock: &Vector2<f64>) -> Option<Terms> {
        let offset_secs = clock.x + clock.y * (self.secs - self.middle_secs);
        let (estimate, reference, twist) = match self.interpolated {
            Interpolated::Reference => {
                let found = self.dense.moving_at(self.secs + offset_secs)?;
                (self.pose, found.pose, found.twist)
            }
            Interpolated::Estimate => {
                let found = self.dense.moving_at(self.secs - offset_secs)?;
                (found.pose, self.pose, found.twist)
            }
        };
        Some(Terms {
            error: (reference * *body).inverse() * (*world * estimate),
            estimate,
            reference,
            twist,
        })
    }
}

impl Residual for BodyResidual {
    fn dimension(&self) -> usize {
        6
    }

    fn blocks(&self) -> &[Shape] {
        const {
            &[
                Shape::of::<Se3>(),
                Shape::of::<Se3>(),
                Shape::of::<Vector2<f64>>(),
            ]
        }
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let (world, body): (Se3, Se3) = (parameters.get(0), parameters.get(1));
        let clock: Vector2<f64> = parameters.get(2);
        let terms = self.terms(&world, &body, &clock).ok_or(Undefined)?;
        let [turn, shift] = self.sigmas.map(|s| 1.0 / s);
        let weights = Vector6::new(turn, turn, turn, shift, shift, shift);
        let log = terms.error.log();
        out.set_residual(&log.component_mul(&weights));
        let by_error: Matrix6<f64> =
            Matrix6::from_diagonal(&weights) * se3::right_jacobian_inverse(&log);
        out.set_jacobian(0, &(by_error * terms.estimate.inverse().adjoint()));
        out.set_jacobian(1, &-(by_error * terms.error.inverse().adjoint()));
        if out.wants_jacobian(2) {
            let by_secs: Vector6<f64> = match self.interpolated {
                Interpolated::Reference => {
                    let estimate_from_reference =
                        (world * terms.estimate).inverse() * terms.reference;
                    -(by_error * estimate_from_reference.adjoint() * terms.twist)
                }
                Interpolated::Estimate => -(by_error * terms.twist),
            };
            let since = self.secs - self.middle_secs;
            out.set_jacobian(2, &Matrix6x2::from_columns(&[by_secs, by_secs * since]));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::continuous::tests::{motion, sampled};
    use super::*;
    use lsfb_types::Timestamp;

    fn residual(interpolated: Interpolated) -> BodyResidual {
        let poses = sampled(20.0, 5.0, motion);
        BodyResidual {
            interpolated,
            dense: Arc::new(Continuous::new(&poses, Timestamp::from_nanos(0))),
            pose: motion(2.2),
            secs: 2.0,
            middle_secs: 1.0,
            sigmas: [0.1, 0.05],
        }
    }

    fn near(scale: f64) -> Se3 {
        Se3::exp(&(Vector6::new(0.3, -0.2, 0.1, 0.5, -0.4, 0.2) * scale))
    }

    lsfb_solver::check_residual_jacobian!(
        reference_between_poses,
        residual(Interpolated::Reference),
        near(1.0),
        near(-0.6),
        Vector2::new(0.11, 0.02)
    );
    lsfb_solver::check_residual_jacobian!(
        estimate_between_poses,
        residual(Interpolated::Estimate),
        near(1.0),
        near(-0.6),
        Vector2::new(0.11, 0.02)
    );
}
