//! One edge of Eq. 3: `r = Σ^(−½) log(I_T_A⁻¹ ∘ I_T_B ∘ A_T̂_B⁻¹)`. Blocks: `I_T_A`, `I_T_B`.
//!
//! With `E` the product and `e = log E`: `∂r/∂B = Σ^(−½) J_r⁻¹(e) Ad(A_T̂_B)`, `∂r/∂A = −Σ^(−½) J_l⁻¹(e)`.

use std::cmp::Ordering;

use lsfb_geometry::{Matrix6, Se3, Vector6, se3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

use super::{IMU, JointConfig, LIDAR, Weights};
use crate::{Error, JoinProblem, TransformEdge};

/// An edge in the direction that Eq. 3 has it: to the IMU, or from the LiDAR.
#[derive(Clone, Debug)]
pub(super) struct GraphEdge {
    pub target: String,
    pub source: String,
    pub target_from_source: Se3,
    /// Of `log E`: in the target's axes.
    pub covariance: Matrix6<f64>,
    pub measured: bool,
    whitening: Matrix6<f64>,
}

impl GraphEdge {
    pub fn new(edge: &TransformEdge, config: &JointConfig) -> Result<Self, Error> {
        if edge.target == edge.source {
            return Err(Error::NotJoined {
                first: edge.target.clone(),
                second: edge.source.clone(),
                cause: JoinProblem::SameSensor,
            });
        }
        let turn = edge.target == LIDAR || edge.source == IMU;
        let (target, source, transform) = if turn {
            (
                &edge.source,
                &edge.target,
                edge.target_from_source.inverse(),
            )
        } else {
            (&edge.target, &edge.source, edge.target_from_source)
        };
        let measured = edge
            .covariance
            .filter(|_| config.weights == Weights::Measured);
        let covariance = match measured {
            // M exp(δ) M⁻¹ = exp(Ad(M) δ); turned around, (M exp δ)⁻¹ M = exp(−δ).
            Some(c) if turn => c,
            Some(c) => {
                let through = transform.adjoint();
                through * c * through.transpose()
            }
            None => {
                let variance = if source == LIDAR {
                    config.lidar_variance
                } else {
                    config.camera_variance
                };
                Matrix6::from_diagonal(&Vector6::from(variance))
            }
        };
        let name = || format!("{target} from {source}");
        let whitening = covariance
            .cholesky()
            .and_then(|c| c.l().try_inverse())
            .filter(|w| w.iter().all(|x| x.is_finite()))
            .ok_or_else(|| Error::Parse {
                path: name(),
                problem: "its covariance is not positive definite".to_owned(),
            })?;
        Ok(Self {
            target: target.clone(),
            source: source.clone(),
            target_from_source: transform,
            covariance,
            measured: measured.is_some(),
            whitening,
        })
    }

    pub fn ends(&self) -> (&str, &str) {
        (&self.target, &self.source)
    }

    /// An order among edges between the same sensors.
    pub fn order(&self, other: &Self) -> Ordering {
        let key = |e: &Self| {
            let t = e.target_from_source;
            let q = t.rotation.coords;
            [
                t.translation.x,
                t.translation.y,
                t.translation.z,
                q.x,
                q.y,
                q.z,
                q.w,
            ]
        };
        key(self)
            .iter()
            .zip(key(other))
            .map(|(a, b)| a.total_cmp(&b))
            .find(|o| o.is_ne())
            .unwrap_or(Ordering::Equal)
    }

    /// `log E` at the given poses, and its derivatives by target and source.
    pub fn error(&self, target: &Se3, source: &Se3) -> (Vector6<f64>, [Matrix6<f64>; 2]) {
        let e = (target.inverse() * *source * self.target_from_source.inverse()).log();
        let by_source = se3::right_jacobian_inverse(&e) * self.target_from_source.adjoint();
        (e, [-se3::left_jacobian_inverse(&e), by_source])
    }

    pub fn residual(&self) -> EdgeResidual {
        EdgeResidual { edge: self.clone() }
    }
}

pub(super) struct EdgeResidual {
    edge: GraphEdge,
}

impl Residual for EdgeResidual {
    fn dimension(&self) -> usize {
        6
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<Se3>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (target, source): (Se3, Se3) = (parameters.get(0), parameters.get(1));
        let (e, by) = self.edge.error(&target, &source);
        out.set_residual(&(self.edge.whitening * e));
        for (position, jacobian) in by.iter().enumerate() {
            out.set_jacobian(position, &(self.edge.whitening * jacobian));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    #[test]
    fn jacobians_are_those_of_differences() {
        let edge = TransformEdge {
            target: "cam0".into(),
            source: LIDAR.into(),
            target_from_source: Se3::exp(&Vector6::new(1.0, -0.4, 0.3, 0.2, 0.5, -0.1)),
            covariance: None,
        };
        let edge = GraphEdge::new(&edge, &JointConfig::default()).expect("an edge");
        let mut problem = Problem::new();
        let a = problem.add_block(Se3::exp(&Vector6::new(0.1, 0.2, -0.3, 0.4, 0.5, 0.6)));
        let b = problem.add_block(Se3::exp(&Vector6::new(-0.5, 0.9, 0.2, 0.1, 0.3, 0.2)));
        problem
            .add_residual(edge.residual(), &[a.id(), b.id()], Kernel::Squared)
            .expect("two poses");
        check_residual_jacobian!(all of problem, within 1e-6);
    }
}
