//! How the LiDAR turns as the gyroscope has it; how that sits on the LiDAR is found, since the rig may be wrong.

use lsfb_geometry::IntegratedGyro;
use lsfb_geometry::{Matrix3, Se3, UnitQuaternion, Vector3, Vector6, so3};
use lsfb_solver::gauss_newton::{Next, NormalEquations, minimise};
use nalgebra::Matrix3x6;

/// Scans that are compared with the gyroscope are so many apart.
const APART: usize = 5;
/// By how much the LiDAR may be turned against the rig's axes (rad), the gyroscope's bias (rad/s), and the noise of a scan's
/// rotation (rad).
const MOUNTED_RAD: f64 = 0.04;
const BIAS_RAD_S: f64 = 0.02;
const TURN_NOISE_RAD: f64 = 1e-3;
const ITERATIONS: u32 = 3;
/// The gyroscope is integrated in steps of this, seconds.
const STEP_S: f64 = 0.02;

/// How the LiDAR turns as the gyroscope has it.
#[derive(Clone, Copy)]
pub(super) struct PredictedRotation<'a> {
    pub gyro: Option<&'a IntegratedGyro>,
    pub lidar_from_rig: UnitQuaternion<f64>,
    pub bias_rad_s: Vector3<f64>,
}

impl PredictedRotation<'_> {
    /// How the LiDAR at one time is turned to itself at another: directions at `to_s` as it had them at `from_s`.
    pub fn between(&self, from_s: f64, to_s: f64) -> UnitQuaternion<f64> {
        self.lidar_from_rig * self.of_rig(from_s, to_s) * self.lidar_from_rig.inverse()
    }

    /// The same of the rig.
    fn of_rig(&self, from_s: f64, to_s: f64) -> UnitQuaternion<f64> {
        let Some(gyro) = self.gyro else {
            return UnitQuaternion::identity();
        };
        let steps = ((to_s - from_s).abs() / STEP_S).ceil().max(1.0);
        let mut turn = UnitQuaternion::identity();
        for k in 0..steps as usize {
            let at = |k: f64| from_s + (to_s - from_s) * k / steps;
            let (a, b) = (at(k as f64), at(k as f64 + 1.0));
            if let (Some(before), Some(after)) = (gyro.angle(a), gyro.angle(b)) {
                turn = so3::retract(&turn, &(after - before - self.bias_rad_s * (b - a)));
            }
        }
        turn
    }

    /// How the gyroscope sits on the LiDAR, and its bias, so that it turns as the scans do.
    pub fn fit(&mut self, times_s: &[f64], world_from_lidar: &[Se3]) {
        if self.gyro.is_none() {
            return;
        }
        let damping = Vector6::from_fn(|k, _| {
            let sigma = if k < 3 { MOUNTED_RAD } else { BIAS_RAD_S };
            (TURN_NOISE_RAD / sigma).powi(2)
        });
        let before = *self;
        let terms = |(lidar_from_rig, bias_rad_s): &(UnitQuaternion<f64>, Vector3<f64>)| {
            let own = PredictedRotation {
                lidar_from_rig: *lidar_from_rig,
                bias_rad_s: *bias_rad_s,
                ..before
            };
            let mut terms = NormalEquations::<6>::default();
            terms.information.set_diagonal(&damping);
            for (t, p) in times_s
                .windows(APART + 1)
                .zip(world_from_lidar.windows(APART + 1))
            {
                let seen = p[0].rotation.inverse() * p[APART].rotation;
                own.add_turn([t[0], t[APART]], &seen, &mut terms);
            }
            Some(terms)
        };
        let start = (self.lidar_from_rig, self.bias_rad_s);
        if let Some(found) = minimise(start, ITERATIONS, terms, |_| Next::Iterate) {
            (self.lidar_from_rig, self.bias_rad_s) = found.value;
        }
    }

    /// What the scans say of the LiDAR's turn between two times.
    fn add_turn(
        &self,
        [from_s, to_s]: [f64; 2],
        seen: &UnitQuaternion<f64>,
        terms: &mut NormalEquations<6>,
    ) {
        let rig_turn = self.of_rig(from_s, to_s);
        let lidar_turn = self.lidar_from_rig * rig_turn * self.lidar_from_rig.inverse();
        let error = so3::local(&lidar_turn, seen);
        let mounting = self.lidar_from_rig.to_rotation_matrix().into_inner();
        let back = rig_turn.inverse().to_rotation_matrix().into_inner();
        let mut jacobian = Matrix3x6::zeros();
        // L exp(c) T exp(−c) L⁻¹ is L T L⁻¹ exp(L (Tᵀ − 1) c); the error moves against it.
        jacobian
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(mounting * (Matrix3::identity() - back)));
        jacobian
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&(mounting * (to_s - from_s)));
        let weight = 1.0 / (1.0 + (error.norm() / (4.0 * TURN_NOISE_RAD)).powi(2));
        terms.add_block(&error, &jacobian, weight);
    }
}
