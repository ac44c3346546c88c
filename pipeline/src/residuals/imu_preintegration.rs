use lsfb_geometry::{Matrix3, Se3, UnitQuaternion, Vector3, so3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{SMatrix, SVector, Vector1, Vector6};

use lsfb_perception::imu::{
    BiasJacobians, CorrectedChange, ImuBias, ImuErrors, Matrix9, NavState, PreintegratedImu,
};

/// The IMU's samples between two states, `h` of eq. (5). Blocks: pose, velocity, gyroscope bias, accelerometer bias of the
/// first state; pose and velocity of the second; gravity in the world; and [with errors](Self::with_errors) scale and shear of gyroscope and of
/// accelerometer, the latter's turn and delay, and the world's scale `s`, by which `1 − s` of `v` and `p` are true.
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
/// The columns of scale and shear are those of the biases, with the derivatives by these; those of turn and delay are −Δv and −Δp by these.
/// With the world's scale, the columns of `ρ` and `v` are `1 − s` as large, and its own are `−R_iᵀ (v_j − v_i)` and `−R_iᵀ (p_j − p_i − v_i Δt)`.
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

    /// With scale and shear of gyroscope and of accelerometer, the latter's turn and delay, and the world's scale as five more blocks.
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

    /// By how much the samples pull two poses, tangent `[rotation, translation]`: the gradient of half of the squared whitened residual.
    pub fn pulls(
        &self,
        ends: [&NavState; 2],
        bias: &ImuBias,
        errors: &ImuErrors,
        gravity_m_s2: &Vector3<f64>,
    ) -> [Vector6<f64>; 2] {
        let difference = self.difference(ends, bias, errors, gravity_m_s2);
        let weighted = self
            .sqrt_information
            .tr_mul(&(self.sqrt_information * difference.residual()));
        let [by_pose_i, by_pose_j] = difference.by_poses();
        [by_pose_i.tr_mul(&weighted), by_pose_j.tr_mul(&weighted)]
    }

    /// Columns of what gyroscope and accelerometer are off by.
    fn by_both<const N: usize>(
        &self,
        by: &BiasJacobians<N>,
        by_rotation_correction: &Matrix3<f64>,
    ) -> [Block<N>; 2] {
        let rotation = by_rotation_correction * by.rotation_by_gyro;
        let none = SMatrix::<f64, 3, N>::zeros();
        [
            stack(&rotation, &-by.velocity_by_gyro, &-by.position_by_gyro),
            stack(&none, &-by.velocity_by_accel, &-by.position_by_accel),
        ]
        .map(|columns| self.sqrt_information * columns)
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
        let true_share = 1.0 - errors.world_scale;
        let (pose_i, pose_j) = (&start.world_from_rig, &end.world_from_rig);
        let i_from_world = pose_i.rotation_matrix().transpose();
        let j_from_i = pose_j.rotation.inverse() * pose_i.rotation;
        let gained = i_from_world * (end.velocity_m_s - start.velocity_m_s);
        let moved =
            i_from_world * (pose_j.translation - pose_i.translation - start.velocity_m_s * dt);
        let fallen = i_from_world * gravity_m_s2 * dt;
        let velocity = gained * true_share - fallen;
        let position = moved * true_share - fallen * (0.5 * dt);
        Difference {
            rotation: so3::log(&(change.rotation.inverse() * j_from_i.inverse())),
            change,
            i_from_world,
            j_from_i,
            velocity,
            position,
            by_scale: [-gained, -moved],
            true_share,
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
    /// How these depend on the world's scale, and what it leaves of lengths.
    by_scale: [Vector3<f64>; 2],
    true_share: f64,
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

    /// Its derivatives by both poses.
    fn by_poses(&self) -> [Block<6>; 2] {
        let log_by_turn = so3::right_jacobian_inverse(&self.rotation);
        let j_from_i = self.j_from_i.to_rotation_matrix().into_inner();
        let mut by_pose_i = Block::<6>::zeros();
        by_pose_i.fixed_view_mut::<9, 3>(0, 0).copy_from(&stack(
            &(-log_by_turn * j_from_i),
            &so3::hat(&self.velocity),
            &so3::hat(&self.position),
        ));
        by_pose_i
            .fixed_view_mut::<3, 3>(6, 3)
            .copy_from(&-Matrix3::from_diagonal_element(self.true_share));
        let mut by_pose_j = Block::<6>::zeros();
        by_pose_j
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&log_by_turn);
        by_pose_j
            .fixed_view_mut::<3, 3>(6, 3)
            .copy_from(&(j_from_i.transpose() * self.true_share));
        [by_pose_i, by_pose_j]
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
            Shape::of::<Vector6<f64>>(),
            Shape::of::<Vector6<f64>>(),
            Shape::of::<Vector3<f64>>(),
            Shape::of::<Vector1<f64>>(),
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
        let axes = |block: usize| match self.has_errors {
            true => parameters.get::<Vector6<f64>>(WITHOUT_ERRORS + block),
            false => Vector6::zeros(),
        };
        let (gyro, accel) = (axes(0), axes(1));
        let first = |v: &Vector6<f64>| v.fixed_rows::<3>(0).into_owned();
        let last = |v: &Vector6<f64>| v.fixed_rows::<3>(3).into_owned();
        let errors = match self.has_errors {
            true => ImuErrors {
                gyro_scale: first(&gyro),
                gyro_shear: last(&gyro),
                accel_scale: first(&accel),
                accel_shear: last(&accel),
                accel_turn_rad: parameters.get(WITHOUT_ERRORS + 2),
                accel_delay_s: parameters.get::<Vector1<f64>>(WITHOUT_ERRORS + 3).x,
                world_scale: parameters.get::<Vector1<f64>>(WITHOUT_ERRORS + 4).x,
            },
            false => ImuErrors::default(),
        };
        let difference = self.difference(ends, &bias, &errors, &parameters.get(6));
        out.set_residual(&(self.sqrt_information * difference.residual()));
        if !out.wants_jacobians() {
            return Ok(());
        }

        let [by_pose_i, by_pose_j] = difference.by_poses();
        let Difference {
            change,
            i_from_world,
            rotation,
            by_scale,
            true_share,
            ..
        } = difference;
        let dt = self.preintegrated.duration_secs;
        let log_by_turn = so3::right_jacobian_inverse(&rotation);
        let by_rotation_correction = -log_by_turn
            * so3::exp(&-rotation).to_rotation_matrix().into_inner()
            * so3::right_jacobian(&change.rotation_correction);
        let zero = Matrix3::zeros();
        let scaled = i_from_world * true_share;
        let by_velocity_i = stack(&zero, &-scaled, &(-scaled * dt));
        let (bias, scale) = (&self.preintegrated.by_bias, &self.preintegrated.by_scale);
        let by_velocity_j = stack(&zero, &scaled, &zero);
        let by_gravity = stack(
            &zero,
            &(-i_from_world * dt),
            &(-i_from_world * (0.5 * dt * dt)),
        );
        out.set_jacobian(0, &(self.sqrt_information * by_pose_i));
        out.set_jacobian(1, &(self.sqrt_information * by_velocity_i));
        let [by_gyro, by_accel] = self.by_both(bias, &by_rotation_correction);
        out.set_jacobian(2, &by_gyro);
        out.set_jacobian(3, &by_accel);
        out.set_jacobian(4, &(self.sqrt_information * by_pose_j));
        out.set_jacobian(5, &(self.sqrt_information * by_velocity_j));
        out.set_jacobian(6, &(self.sqrt_information * by_gravity));
        if self.has_errors {
            let [by_gyro, by_accel] = self.by_both(scale, &by_rotation_correction);
            out.set_jacobian(WITHOUT_ERRORS, &by_gyro);
            out.set_jacobian(WITHOUT_ERRORS + 1, &by_accel);
            let [velocity, position] = &self.preintegrated.by_turn;
            let by_turn = stack(&zero, &-velocity, &-position);
            out.set_jacobian(WITHOUT_ERRORS + 2, &(self.sqrt_information * by_turn));
            let column = |[velocity, position]: [Vector3<f64>; 2]| {
                let mut by = Block::<1>::zeros();
                by.fixed_rows_mut::<3>(3).copy_from(&velocity);
                by.fixed_rows_mut::<3>(6).copy_from(&position);
                self.sqrt_information * by
            };
            let by_delay = self.preintegrated.by_delay.map(|changed| -changed);
            out.set_jacobian(WITHOUT_ERRORS + 3, &column(by_delay));
            out.set_jacobian(WITHOUT_ERRORS + 4, &column(by_scale));
        }
        Ok(())
    }
}

fn stack<const N: usize>(
    rotation: &SMatrix<f64, 3, N>,
    velocity: &SMatrix<f64, 3, N>,
    position: &SMatrix<f64, 3, N>,
) -> Block<N> {
    let mut block = Block::<N>::zeros();
    for (row, part) in [(0, rotation), (3, velocity), (6, position)] {
        block.fixed_view_mut::<3, N>(row, 0).copy_from(part);
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
                [0.01, 0.02, -0.015],
            ];
            let [v_i, gyro, accel, v_j, gravity, accel_turn] =
                vectors.map(|v| problem.add_block(Vector3::from(v)).id());
            let axes = [
                [0.02, -0.01, 0.03, 0.01, -0.02, 0.005],
                [-0.01, 0.015, 0.02, -0.02, 0.01, 0.03],
            ];
            let [gyro_axes, accel_axes] = axes.map(|v| problem.add_block(Vector6::from(v)).id());
            let [delay, scale] = [3e-3, 0.02].map(|v| problem.add_block(Vector1::new(v)).id());
            let blocks = [
                first, v_i, gyro, accel, second, v_j, gravity, gyro_axes, accel_axes, accel_turn,
                delay, scale,
            ];
            let count = residual.blocks().len();
            problem
                .add_residual(residual, &blocks[..count], Kernel::Squared)
                .expect("blocks fit");
            check_residual_jacobian!(all of problem, within 1e-6);
        }
    }
}
