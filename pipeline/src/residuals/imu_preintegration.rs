use lsfb_geometry::{Matrix3, Se3, UnitQuaternion, Vector3, so3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{SMatrix, SVector, Vector1};

use crate::preintegration::{
    BiasJacobians, CorrectedChange, ImuBias, ImuErrors, Matrix9, NavState, PreintegratedImu,
};

/// The IMU's samples between two states, `h` of eq. (5). Blocks: pose, velocity, gyroscope bias, accelerometer bias of the
/// first state; pose and velocity of the second; gravity in the world; and [with errors](Self::with_errors) the scales of gyroscope and
/// accelerometer and the delay of the latter.
///
/// Forster et al. 2017, eq. (45), whitened by `L⁻¹` of the preintegrated covariance `L Lᵀ`:
///
/// - `r_R = log(ΔR(b)ᵀ R_iᵀ R_j)`
/// - `r_v = R_iᵀ (v_j − v_i − g Δt) − Δv(b)`
/// - `r_p = R_iᵀ (p_j − p_i − v_i Δt − ½ g Δt²) − Δp(b)`
///
/// Perturbing `R exp(φ)`, `p + R ρ`:
///
/// | | φ_i | ρ_i | v_i | b_g | b_a | φ_j | ρ_j | v_j | g |
/// |---|---|---|---|---|---|---|---|---|---|
/// | r_R | −J_r⁻¹ R_jᵀ R_i | | | −J_r⁻¹ exp(r_R)ᵀ J_r(ΔR_b δb) ΔR_b | | J_r⁻¹ | | | |
/// | r_v | \[R_iᵀ(…)\]ₓ | | −R_iᵀ | −Δv_bg | −Δv_ba | | | R_iᵀ | −R_iᵀ Δt |
/// | r_p | \[R_iᵀ(…)\]ₓ | −I | −R_iᵀ Δt | −Δp_bg | −Δp_ba | | R_iᵀ R_j | | −½ R_iᵀ Δt² |
///
/// The columns of the scales are those of the biases, with the derivatives by the scales; the delay's are −Δv_d and −Δp_d.
#[derive(Clone, Debug)]
pub struct ImuPreintegration {
    preintegrated: PreintegratedImu,
    sqrt_information: Matrix9,
    has_errors: bool,
}

/// Blocks but for the errors.
const WITHOUT_ERRORS: usize = 7;

type Block<const N: usize> = SMatrix<f64, 9, N>;

impl ImuPreintegration {
    /// `None` where the covariance is not positive definite: the IMU's noise densities must not be zero.
    pub fn new(preintegrated: PreintegratedImu) -> Option<Self> {
        let factor = preintegrated.covariance.cholesky()?.l();
        let sqrt_information = factor.solve_lower_triangular(&Matrix9::identity())?;
        Some(Self {
            preintegrated,
            sqrt_information,
            has_errors: false,
        })
    }

    /// With the scales of gyroscope and accelerometer and the latter's delay as three more blocks.
    pub fn with_errors(self) -> Self {
        Self {
            has_errors: true,
            ..self
        }
    }

    /// The summed samples.
    pub fn preintegrated(&self) -> &PreintegratedImu {
        &self.preintegrated
    }

    /// By how much the samples and two states differ, in the standard deviations of the noise: rotation, velocity, position.
    pub fn whitened(
        &self,
        ends: [&NavState; 2],
        bias: &ImuBias,
        errors: &ImuErrors,
        gravity_m_s2: &Vector3<f64>,
    ) -> SVector<f64, 9> {
        let difference = self.difference(ends, bias, errors, gravity_m_s2);
        self.sqrt_information * difference.residual()
    }

    fn difference(
        &self,
        [start, end]: [&NavState; 2],
        bias: &ImuBias,
        errors: &ImuErrors,
        gravity_m_s2: &Vector3<f64>,
    ) -> Difference {
        let change = self.preintegrated.corrected_by(bias, errors);
        let dt = self.preintegrated.duration_secs;
        let (pose_i, pose_j) = (&start.world_from_rig, &end.world_from_rig);
        let i_from_world = pose_i.rotation_matrix().transpose();
        let j_from_i = pose_j.rotation.inverse() * pose_i.rotation;
        let velocity = i_from_world * (end.velocity_m_s - start.velocity_m_s - gravity_m_s2 * dt);
        let position = i_from_world
            * (pose_j.translation
                - pose_i.translation
                - start.velocity_m_s * dt
                - gravity_m_s2 * (0.5 * dt * dt));
        Difference {
            rotation: so3::log(&(change.rotation.inverse() * j_from_i.inverse())),
            change,
            i_from_world,
            j_from_i,
            velocity,
            position,
        }
    }
}

/// What two states say of the motion between them, beside what the samples say.
struct Difference {
    change: CorrectedChange,
    i_from_world: Matrix3<f64>,
    j_from_i: UnitQuaternion<f64>,
    /// `r_R`.
    rotation: Vector3<f64>,
    /// `R_iᵀ (…)` of `r_v` and `r_p`.
    velocity: Vector3<f64>,
    position: Vector3<f64>,
}

impl Difference {
    fn residual(&self) -> SVector<f64, 9> {
        let mut residual = SVector::<f64, 9>::zeros();
        for (row, part) in [
            (0, self.rotation),
            (3, self.velocity - self.change.velocity_m_s),
            (6, self.position - self.change.position_m),
        ] {
            residual.fixed_rows_mut::<3>(row).copy_from(&part);
        }
        residual
    }
}

impl Residual for ImuPreintegration {
    fn dimension(&self) -> usize {
        9
    }

    fn blocks(&self) -> &[Shape] {
        const ALL: &[Shape] = &[
            Shape::of::<Se3>(),
            Shape::of::<Vector3<f64>>(),
            Shape::of::<Vector3<f64>>(),
            Shape::of::<Vector3<f64>>(),
            Shape::of::<Se3>(),
            Shape::of::<Vector3<f64>>(),
            Shape::of::<Vector3<f64>>(),
            Shape::of::<Vector3<f64>>(),
            Shape::of::<Vector3<f64>>(),
            Shape::of::<Vector1<f64>>(),
        ];
        &ALL[..if self.has_errors {
            ALL.len()
        } else {
            WITHOUT_ERRORS
        }]
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let state = |first: usize, velocity: usize| NavState {
            world_from_rig: parameters.get(first),
            velocity_m_s: parameters.get(velocity),
        };
        let ends = [&state(0, 1), &state(4, 5)];
        let bias = ImuBias {
            gyro_rad_s: parameters.get(2),
            accel_m_s2: parameters.get(3),
        };
        let errors = match self.has_errors {
            true => ImuErrors {
                gyro_scale: parameters.get(WITHOUT_ERRORS),
                accel_scale: parameters.get(WITHOUT_ERRORS + 1),
                accel_delay_s: parameters.get::<Vector1<f64>>(WITHOUT_ERRORS + 2).x,
            },
            false => ImuErrors::default(),
        };
        let difference = self.difference(ends, &bias, &errors, &parameters.get(6));
        out.set_residual(&(self.sqrt_information * difference.residual()));
        if !(0..self.blocks().len()).any(|k| out.wants_jacobian(k)) {
            return Ok(());
        }

        let Difference {
            change,
            i_from_world,
            j_from_i,
            rotation,
            velocity,
            position,
        } = difference;
        let dt = self.preintegrated.duration_secs;
        let log_by_turn = so3::right_jacobian_inverse(&rotation);
        let j_from_i = j_from_i.to_rotation_matrix().into_inner();
        let by_rotation_correction = -log_by_turn
            * so3::exp(&-rotation).to_rotation_matrix().into_inner()
            * so3::right_jacobian(&change.rotation_correction);
        let zero = Matrix3::zeros();
        let mut by_pose_i = Block::<6>::zeros();
        by_pose_i.fixed_view_mut::<9, 3>(0, 0).copy_from(&stack(
            &(-log_by_turn * j_from_i),
            &so3::hat(&velocity),
            &so3::hat(&position),
        ));
        by_pose_i
            .fixed_view_mut::<3, 3>(6, 3)
            .copy_from(&-Matrix3::identity());
        let mut by_pose_j = Block::<6>::zeros();
        by_pose_j
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&log_by_turn);
        by_pose_j
            .fixed_view_mut::<3, 3>(6, 3)
            .copy_from(&j_from_i.transpose());
        let by_velocity_i = stack(&zero, &-i_from_world, &(-i_from_world * dt));
        let by_gyro = |by: &BiasJacobians| {
            let rotation = by_rotation_correction * by.rotation_by_gyro;
            self.sqrt_information * stack(&rotation, &-by.velocity_by_gyro, &-by.position_by_gyro)
        };
        let by_accel = |by: &BiasJacobians| {
            self.sqrt_information * stack(&zero, &-by.velocity_by_accel, &-by.position_by_accel)
        };
        let (bias, scale) = (&self.preintegrated.by_bias, &self.preintegrated.by_scale);
        let by_velocity_j = stack(&zero, &i_from_world, &zero);
        let by_gravity = stack(
            &zero,
            &(-i_from_world * dt),
            &(-i_from_world * (0.5 * dt * dt)),
        );
        out.set_jacobian(0, &(self.sqrt_information * by_pose_i));
        out.set_jacobian(1, &(self.sqrt_information * by_velocity_i));
        out.set_jacobian(2, &by_gyro(bias));
        out.set_jacobian(3, &by_accel(bias));
        out.set_jacobian(4, &(self.sqrt_information * by_pose_j));
        out.set_jacobian(5, &(self.sqrt_information * by_velocity_j));
        out.set_jacobian(6, &(self.sqrt_information * by_gravity));
        if self.has_errors {
            out.set_jacobian(WITHOUT_ERRORS, &by_gyro(scale));
            out.set_jacobian(WITHOUT_ERRORS + 1, &by_accel(scale));
            let mut by_delay = Block::<1>::zeros();
            let [velocity, position] = &self.preintegrated.by_delay;
            by_delay.fixed_rows_mut::<3>(3).copy_from(&-velocity);
            by_delay.fixed_rows_mut::<3>(6).copy_from(&-position);
            out.set_jacobian(WITHOUT_ERRORS + 2, &(self.sqrt_information * by_delay));
        }
        Ok(())
    }
}

fn stack(rotation: &Matrix3<f64>, velocity: &Matrix3<f64>, position: &Matrix3<f64>) -> Block<3> {
    let mut block = Block::<3>::zeros();
    for (row, part) in [(0, rotation), (3, velocity), (6, position)] {
        block.fixed_view_mut::<3, 3>(row, 0).copy_from(part);
    }
    block
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::ImuNoiseModel;
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};
    use lsfb_types::{ImuSample, Stamped, Timestamp};

    use super::*;

    #[test]
    fn jacobians_match_differences() {
        let samples: Vec<_> = (0..41)
            .map(|k| {
                let t = k as f64 * 0.005;
                let time = Timestamp::from_nanos(k * 5_000_000);
                Stamped {
                    time,
                    arrival: time,
                    device_ticks: 0,
                    sample: ImuSample {
                        angular_velocity_rad_s: [t.sin(), 1.0 - t, (3.0 * t).cos()],
                        specific_force_m_s2: [t, 2.0 * t.sin(), 9.8 + t],
                    },
                }
            })
            .collect();
        let noise = ImuNoiseModel {
            gyro_noise_density: 0.05,
            accel_noise_density: 0.3,
            gyro_bias_walk: 1e-5,
            accel_bias_walk: 1e-4,
        };
        let preintegrated = PreintegratedImu::integrate(
            &samples,
            samples[0].time,
            samples[40].time,
            ImuBias::default(),
            &noise,
        )
        .expect("covered");
        let residual = ImuPreintegration::new(preintegrated).expect("noise is not zero");
        for residual in [residual.clone(), residual.with_errors()] {
            let mut problem = Problem::new();
            let poses = [
                [0.4, -0.1, 0.9, 3.0, -2.0, 1.0],
                [0.2, 0.3, 0.7, 3.3, -2.1, 1.2],
            ];
            let [first, second] = poses.map(|p| problem.add_block(Se3::exp(&p.into())).id());
            let vectors = [
                [0.5, -0.7, 0.1],
                [0.1, -0.2, 0.15],
                [-0.3, 0.2, 0.1],
                [0.8, -0.2, 0.3],
                [0.1, 0.2, -9.7],
                [0.02, -0.01, 0.03],
                [-0.01, 0.015, 0.02],
            ];
            let [v_i, gyro, accel, v_j, gravity, gyro_scale, accel_scale] =
                vectors.map(|v| problem.add_block(Vector3::from(v)).id());
            let delay = problem.add_block(Vector1::new(3e-3)).id();
            let blocks = [
                first,
                v_i,
                gyro,
                accel,
                second,
                v_j,
                gravity,
                gyro_scale,
                accel_scale,
                delay,
            ];
            let count = residual.blocks().len();
            problem
                .add_residual(residual, &blocks[..count], Kernel::Squared)
                .expect("blocks fit");
            check_residual_jacobian!(all of problem, within 1e-6);
        }
    }
}
