//! A measured transform between two poses, as a residual.

use lsfb_geometry::{Matrix6, Se3, Vector6, so3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

/// A measured transform between two poses. Blocks: `world_from_a`, `world_from_b`.
///
/// With `D = T_A⁻¹ T_B`, `E_R = R̂ᵀ R_D`: `r = W [log E_R, t_D − t̂]`;
/// `∂log E_R/∂φ_a = −J_r⁻¹ R_Dᵀ`, `∂log E_R/∂φ_b = J_r⁻¹`, `∂t_D/∂φ_a = [t_D]ₓ`, `∂t_D/∂ρ_a = −I`, `∂t_D/∂ρ_b = R_D`.
#[derive(Clone, Copy, Debug)]
pub struct RelativePose {
    /// The measurement.
    pub a_from_b: Se3,
    /// Square root of the information of `[rotation in b, translation in a]`.
    pub sqrt_information: Matrix6<f64>,
}

impl RelativePose {
    /// Independent errors, the same in each direction.
    pub fn isotropic(a_from_b: Se3, rotation_sigma_rad: f64, translation_sigma_m: f64) -> Self {
        let (r, t) = (1.0 / rotation_sigma_rad, 1.0 / translation_sigma_m);
        Self {
            a_from_b,
            sqrt_information: Matrix6::from_diagonal(&Vector6::new(r, r, r, t, t, t)),
        }
    }
}

impl Residual for RelativePose {
    fn dimension(&self) -> usize {
        6
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<Se3>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (world_from_a, world_from_b): (Se3, Se3) = (parameters.get(0), parameters.get(1));
        let found = world_from_a.inverse() * world_from_b;
        let rotation = so3::log(&(self.a_from_b.rotation.inverse() * found.rotation));
        let mut residual = Vector6::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&rotation);
        residual
            .fixed_rows_mut::<3>(3)
            .copy_from(&(found.translation - self.a_from_b.translation));
        out.set_residual(&(self.sqrt_information * residual));
        if !(out.wants_jacobian(0) || out.wants_jacobian(1)) {
            return Ok(());
        }
        let turn = found.rotation_matrix();
        let log_by_turn = so3::right_jacobian_inverse(&rotation);
        let (mut by_a, mut by_b) = (Matrix6::zeros(), Matrix6::zeros());
        by_a.fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(-log_by_turn * turn.transpose()));
        by_a.fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&so3::hat(&found.translation));
        by_a.fixed_view_mut::<3, 3>(3, 3).fill_with_identity();
        by_a.fixed_view_mut::<3, 3>(3, 3).neg_mut();
        by_b.fixed_view_mut::<3, 3>(0, 0).copy_from(&log_by_turn);
        by_b.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        out.set_jacobian(0, &(self.sqrt_information * by_a));
        out.set_jacobian(1, &(self.sqrt_information * by_b));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_solver::{Kernel, Problem, SolveConfig, check_residual_jacobian, solve};

    use super::*;

    check_residual_jacobian!(
        jacobians_match_differences,
        RelativePose::isotropic(
            Se3::exp(&Vector6::new(0.2, 0.3, -0.4, 0.5, 0.6, 0.7)),
            0.1,
            0.5
        ),
        Se3::exp(&Vector6::new(0.4, -0.1, 0.9, 3.0, -2.0, 1.0)),
        Se3::exp(&Vector6::new(-0.6, 0.5, 0.2, 1.0, 0.5, 2.0)),
    );

    #[test]
    fn a_ring_of_poses_closes() {
        let step = Se3::exp(&Vector6::new(
            0.0,
            0.0,
            std::f64::consts::TAU / 12.0,
            1.0,
            0.0,
            0.0,
        ));
        let mut problem = Problem::new();
        let mut guess = Se3::identity();
        let poses: Vec<_> = (0..12)
            .map(|_| {
                let pose = problem.add_block(guess);
                guess =
                    guess * step * Se3::exp(&Vector6::new(0.01, -0.02, 0.03, 0.05, 0.02, -0.04));
                pose
            })
            .collect();
        problem.set_constant(poses[0]);
        for k in 0..12 {
            problem
                .add_residual(
                    RelativePose::isotropic(step, 0.01, 0.05),
                    &[poses[k].id(), poses[(k + 1) % 12].id()],
                    Kernel::Squared,
                )
                .expect("blocks fit");
        }
        let config = SolveConfig {
            cost_tolerance: 0.0,
            ..Default::default()
        };
        let report = solve(&mut problem, &config).expect("solves");
        assert!(report.final_cost < 1e-12, "{report:?}");
        let expected = (0..7).fold(Se3::identity(), |pose, _| pose * step);
        assert!((expected.inverse() * problem.value(poses[7])).log().norm() < 1e-6);
    }
}
