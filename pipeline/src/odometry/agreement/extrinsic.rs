//! Whether the LiDAR hangs on the IMU as the rig says: both see the same turns.
//!
//! The rotation of a span by the gyroscope, `G`, and by the scans, `S`, are the same motion seen in two frames: `G = E S Eᵀ`, and so
//! `log G = E log S + b t` with the rotation `E` by which the rig's is off and the gyroscope's bias `b`. Both are found by least squares over
//! spans of the walk. What is left of the gyroscope in the poses of the scans (their information is no better known than their correspondences) makes
//! it too little, never too much. About an axis that all turns share nothing is learnt, and then nothing is said.

use lsfb_geometry::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6, so3};
use lsfb_solver::gauss_newton::{Next, NormalEquations, minimise};
use nalgebra::Matrix3x6;

use super::turns::{MIN_SPANS, Turn, scatter, weight};

/// What is known beforehand: of the rotation, radians, and of the bias, rad/s.
const PRIOR_RAD: f64 = 0.5;
const PRIOR_RAD_S: f64 = 0.05;
/// Spans are known no better than this, radians.
const LEAST_SIGMA_RAD: f64 = 5e-4;
/// A start far from the rig's must leave less than this share of the squares.
const FAR_BETTER: f64 = 0.25;
const ITERATIONS: u32 = 12;
/// What is said: more standard deviations than this.
const SIGMAS: f64 = 4.0;

/// By how much the rotation of the LiDAR on the IMU is off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RotationOff {
    /// Angle, radians.
    pub off_rad: f64,
    /// Its standard deviation, radians.
    pub sigma_rad: f64,
}

/// What is off, where it is off for certain and by more than `least_rad`; of the poses that scans have without the gyroscope's help.
pub(super) fn rotation_off(turns: &[Turn], least_rad: f64) -> Option<RotationOff> {
    if turns.len() < MIN_SPANS {
        return None;
    }
    let found = minimise(
        (start_rotation(turns), Vector3::zeros()),
        ITERATIONS,
        |(rotation, bias)| Some(equations(turns, rotation, bias)),
        |_| Next::Iterate,
    )?;
    let covariance = found.information.cholesky()?.inverse();
    let off = so3::log(&found.value.0);
    let off_rad = off.norm();
    let along = off.try_normalize(1e-9)?;
    let of_rotation: Matrix3<f64> = covariance.fixed_view::<3, 3>(0, 0).into();
    let sigma_rad = along.dot(&(of_rotation * along)).max(0.0).sqrt();
    (off_rad > least_rad.max(SIGMAS * sigma_rad)).then_some(RotationOff { off_rad, sigma_rad })
}

/// The rotation from which to search: that of the rig, unless another by far fits better, as where clouds are in another frame than the rig
/// says. That which turns the scans' turns best into the gyroscope's (Wahba's problem).
fn start_rotation(turns: &[Turn]) -> UnitQuaternion<f64> {
    let sum: Matrix3<f64> = turns
        .iter()
        .map(|s| s.by_gyro * s.by_scans.transpose())
        .sum();
    let identity = UnitQuaternion::identity();
    let Some(best) = so3::nearest(&sum) else {
        return identity;
    };
    let left = |rotation: &UnitQuaternion<f64>| -> f64 {
        let each = turns.iter();
        each.map(|s| (s.by_gyro - rotation * s.by_scans).norm_squared())
            .sum()
    };
    if left(&best) < FAR_BETTER * left(&identity) {
        best
    } else {
        identity
    }
}

/// At a rotation and a bias, weighted by how the spans scatter; those that do not fit lose their weight (Cauchy).
fn equations(
    turns: &[Turn],
    rotation: &UnitQuaternion<f64>,
    bias: &Vector3<f64>,
) -> NormalEquations<6> {
    let residual = |s: &Turn| s.by_gyro - rotation * s.by_scans - bias * s.duration_s;
    let residuals: Vec<_> = turns.iter().map(residual).collect();
    let sigma = scatter(&residuals).max(LEAST_SIGMA_RAD);
    let mut equations = NormalEquations::default();
    for (turn, r) in turns.iter().zip(&residuals) {
        let mut jacobian = Matrix3x6::zeros();
        let by_rotation = rotation.to_rotation_matrix() * so3::hat(&turn.by_scans);
        jacobian
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&by_rotation);
        jacobian
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&(-Matrix3::identity() * turn.duration_s));
        equations.add_block(r, &jacobian, weight(r, sigma));
    }
    let off = so3::log(rotation);
    let deviation = Vector6::new(off.x, off.y, off.z, bias.x, bias.y, bias.z);
    let (r, b) = (PRIOR_RAD.powi(-2), PRIOR_RAD_S.powi(-2));
    let prior = Vector6::new(r, r, r, b, b, b);
    equations.add_prior(&deviation, &Matrix6::from_diagonal(&prior));
    equations
}
