use lsfb_geometry::{Se3, Vector3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{RowVector6, Vector1};

/// Eq. (4), first term: a point of keyframe n on a plane of keyframe m,
/// `r = ᵐnᵀ (W_T_m⁻¹ W_T_n ⁿp − ᵐq) / σ`.
///
/// Blocks: `world_from_rig` of m, then of n. Points and normal are in the rig frames of their keyframes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarPlane {
    /// ⁿp, metres.
    pub point_in_n: Vector3<f64>,
    /// ᵐq, a point of the plane, metres.
    pub point_in_m: Vector3<f64>,
    /// ᵐn, the unit normal.
    pub normal_in_m: Vector3<f64>,
    /// Standard deviation, metres.
    pub sigma_m: f64,
}

impl Residual for LidarPlane {
    fn dimension(&self) -> usize {
        1
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
        // Turned one after the other: cheaper than the pose of one in the other, and a map has millions of these.
        let off_m = world_from_n * self.point_in_n - world_from_m.translation;
        let p = world_from_m.rotation.inverse_transform_vector(&off_m);
        let n = self.normal_in_m / self.sigma_m;
        out.set_residual(&Vector1::new(n.dot(&(p - self.point_in_m))));
        if !out.wants_jacobians() {
            return Ok(());
        }
        // ∂p/∂δm = [[p]×, −I]
        let by_m = n.cross(&p);
        out.set_jacobian(0, &row(&by_m, &-n));
        // ∂p/∂δn = R [−[ⁿp]×, I]
        let n_in_world = world_from_m.rotation * n;
        let n_in_n = world_from_n.rotation.inverse_transform_vector(&n_in_world);
        out.set_jacobian(1, &row(&self.point_in_n.cross(&n_in_n), &n_in_n));
        Ok(())
    }
}

fn row(rotation: &Vector3<f64>, translation: &Vector3<f64>) -> RowVector6<f64> {
    RowVector6::new(
        rotation.x,
        rotation.y,
        rotation.z,
        translation.x,
        translation.y,
        translation.z,
    )
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
            m in pose(), n in pose(), p in vector(), q in vector(), normal in vector()
        ) {
            prop_assume!(normal.norm() > 0.1);
            let mut problem = Problem::new();
            let (m, n) = (problem.add_block(m), problem.add_block(n));
            let residual = LidarPlane {
                point_in_n: p,
                point_in_m: q,
                normal_in_m: normal.normalize(),
                sigma_m: 0.1,
            };
            problem.add_residual(residual, &[m.id(), n.id()], Kernel::Squared).expect("blocks fit");
            check_residual_jacobian!(all of problem);
        }
    }
}
