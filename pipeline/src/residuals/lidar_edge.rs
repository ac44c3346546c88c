use lsfb_geometry::{Se3, Vector3, so3};
use lsfb_perception::projection::{by_pose_of_inverse, moved_by_pose};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

/// Eq. (4), second term: a point of keyframe n on an edge of keyframe m,
/// `r = ᵐl × (W_T_m⁻¹ W_T_n ⁿp − ᵐq) / σ`.
///
/// Blocks: `world_from_rig` of m, then of n. Points and direction are in the rig frames of their keyframes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarEdge {
    /// ⁿp, metres.
    pub point_in_n: Vector3<f64>,
    /// ᵐq, a point of the edge, metres.
    pub point_in_m: Vector3<f64>,
    /// ᵐl, the unit direction of the edge.
    pub direction_in_m: Vector3<f64>,
    /// Standard deviation, metres.
    pub sigma_m: f64,
}

impl Residual for LidarEdge {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<Se3>()] }
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let world_from_m: Se3 = parameters.get(0);
        let world_from_n: Se3 = parameters.get(1);
        let m_from_n = world_from_m.inverse() * world_from_n;
        let p = m_from_n * self.point_in_n;
        let across = so3::hat(&(self.direction_in_m / self.sigma_m));
        out.set_residual(&(across * (p - self.point_in_m)));
        if !out.wants_jacobians() {
            return Ok(());
        }
        // ∂p/∂δm = [[p]×, −I]
        out.set_jacobian(0, &by_pose_of_inverse(&across, &p));
        // ∂p/∂δn = R [−[ⁿp]×, I]
        out.set_jacobian(1, &(across * moved_by_pose(&m_from_n, &self.point_in_n)));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residuals::strategies::{pose, vector};
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn jacobians_match_differences(
            m in pose(), n in pose(), p in vector(), q in vector(), direction in vector()
        ) {
            prop_assume!(direction.norm() > 0.1);
            let mut problem = Problem::new();
            let (m, n) = (problem.add_block(m), problem.add_block(n));
            let residual = LidarEdge {
                point_in_n: p,
                point_in_m: q,
                direction_in_m: direction.normalize(),
                sigma_m: 0.1,
            };
            problem.add_residual(residual, &[m.id(), n.id()], Kernel::Squared).expect("blocks fit");
            check_residual_jacobian!(all of problem);
        }
    }
}
