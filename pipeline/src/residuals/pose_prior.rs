use lsfb_geometry::{Matrix6, Se3, Vector6, so3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

/// A pose known from elsewhere. Block: the pose.
///
/// With `E = T̂⁻¹ T`: `r = W [log R_E, t_E]`; `∂log R_E/∂φ = J_r⁻¹(log R_E)`, `∂t_E/∂ρ = R_E`, the rest is zero.
#[derive(Clone, Copy, Debug)]
pub struct PosePrior {
    /// The known pose.
    pub pose: Se3,
    /// Square root of the information of `[rotation, translation]` in the known pose's frame.
    pub sqrt_information: Matrix6<f64>,
}

impl PosePrior {
    /// Independent errors, the same in each direction.
    pub fn isotropic(pose: Se3, rotation_sigma_rad: f64, translation_sigma_m: f64) -> Self {
        let (r, t) = (1.0 / rotation_sigma_rad, 1.0 / translation_sigma_m);
        Self {
            pose,
            sqrt_information: Matrix6::from_diagonal(&Vector6::new(r, r, r, t, t, t)),
        }
    }
}

impl Residual for PosePrior {
    fn dimension(&self) -> usize {
        6
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let error = self.pose.inverse() * parameters.get::<Se3>(0);
        let rotation = so3::log(&error.rotation);
        let mut residual = Vector6::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&rotation);
        residual
            .fixed_rows_mut::<3>(3)
            .copy_from(&error.translation);
        out.set_residual(&(self.sqrt_information * residual));
        if out.wants_jacobian(0) {
            let mut by_pose = Matrix6::zeros();
            by_pose
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&so3::right_jacobian_inverse(&rotation));
            by_pose
                .fixed_view_mut::<3, 3>(3, 3)
                .copy_from(&error.rotation_matrix());
            out.set_jacobian(0, &(self.sqrt_information * by_pose));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_solver::{Kernel, Problem, check_jacobians};

    use super::*;

    #[test]
    fn jacobians_match_differences() {
        let known = Se3::exp(&Vector6::new(0.4, -0.1, 0.9, 3.0, -2.0, 1.0));
        let mut problem = Problem::new();
        let mut sqrt_information = Matrix6::from_fn(|r, c| (r as f64 - c as f64 * 0.7).sin());
        sqrt_information.fill_lower_triangle(0.0, 1);
        for residual in [
            PosePrior::isotropic(known, 0.1, 0.5),
            PosePrior {
                pose: known,
                sqrt_information,
            },
        ] {
            let off = Se3::exp(&Vector6::new(0.3, 0.8, -0.5, 0.2, 0.4, -0.6));
            let pose = problem.add_block(known * off);
            problem
                .add_residual(residual, &[pose.id()], Kernel::Squared)
                .expect("blocks fit");
        }
        check_jacobians(&problem, 1e-7).expect("Jacobians match");
    }
}
