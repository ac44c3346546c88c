//! How the LiDAR turns as the gyroscope has it; how that sits on the LiDAR is found, since the rig may be wrong.

use lsfb_geometry::{Matrix3, Matrix6, Se3, UnitQuaternion, Vector3, Vector6, so3};
use nalgebra::Matrix3x6;

use super::super::gyro::Gyro;

/// Scans that are compared with the gyroscope are so many apart.
const APART: usize = 5;
/// By how much the LiDAR may be turned against the rig's axes (rad), the gyroscope's bias (rad/s), and the noise of a scan's
/// rotation (rad).
const MOUNTED_RAD: f64 = 0.04;
const BIAS_RAD_S: f64 = 0.02;
const TURN_NOISE_RAD: f64 = 1e-3;
const ITERATIONS: usize = 3;
/// The gyroscope is integrated in steps of this, seconds.
const STEP_S: f64 = 0.02;

/// How the LiDAR turns as the gyroscope has it.
pub(super) struct Turning<'a> {
    pub gyro: Option<&'a Gyro>,
    pub lidar_from_rig: UnitQuaternion<f64>,
    pub bias_rad_s: Vector3<f64>,
}

impl Turning<'_> {
    /// How the LiDAR at one time is turned to itself at another: directions at `to_s` as it had them at `from_s`.
    pub fn between(&self, from_s: f64, to_s: f64) -> UnitQuaternion<f64> {
        let Some(gyro) = self.gyro else {
            return UnitQuaternion::identity();
        };
        let steps = ((to_s - from_s).abs() / STEP_S).ceil().max(1.0);
        let mut turn = UnitQuaternion::identity();
        for k in 0..steps as usize {
            let at = |k: f64| from_s + (to_s - from_s) * k / steps;
            let (a, b) = (at(k as f64), at(k as f64 + 1.0));
            if let (Some(before), Some(after)) = (gyro.angle(a), gyro.angle(b)) {
                turn *= so3::exp(&(after - before - self.bias_rad_s * (b - a)));
            }
        }
        self.lidar_from_rig * turn * self.lidar_from_rig.inverse()
    }

    /// How the gyroscope sits on the LiDAR, and its bias, so that it turns as the scans do.
    pub fn fit(&mut self, times_s: &[f64], world_from_lidar: &[Se3]) {
        if self.gyro.is_none() {
            return;
        }
        let prior = Matrix6::from_diagonal(&Vector6::from_fn(|k, _| {
            let sigma = if k < 3 { MOUNTED_RAD } else { BIAS_RAD_S };
            (TURN_NOISE_RAD / sigma).powi(2)
        }));
        for _ in 0..ITERATIONS {
            let mut normal = prior;
            let mut right = Vector6::zeros();
            for (t, p) in times_s
                .windows(APART + 1)
                .zip(world_from_lidar.windows(APART + 1))
            {
                let (from_s, to_s) = (t[0], t[APART]);
                let turn = self.between(from_s, to_s);
                let seen = p[0].rotation.inverse() * p[APART].rotation;
                let error = so3::log(&(turn.inverse() * seen));
                let back = turn.inverse().to_rotation_matrix().into_inner();
                // exp(c) Q exp(−c) is Q exp((Qᵀ − 1) c).
                let by_mounting = back - Matrix3::identity();
                let by_bias =
                    self.lidar_from_rig.to_rotation_matrix().into_inner() * (from_s - to_s);
                let mut by = Matrix3x6::zeros();
                by.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_mounting);
                by.fixed_view_mut::<3, 3>(0, 3).copy_from(&by_bias);
                let weight = 1.0 / (1.0 + (error.norm() / (4.0 * TURN_NOISE_RAD)).powi(2));
                normal += by.transpose() * by * weight;
                right += by.transpose() * error * weight;
            }
            let Some(step) = normal.cholesky().map(|c| c.solve(&right)) else {
                return;
            };
            self.lidar_from_rig = so3::exp(&step.fixed_rows::<3>(0).into()) * self.lidar_from_rig;
            self.bias_rad_s += step.fixed_rows::<3>(3);
        }
    }
}
