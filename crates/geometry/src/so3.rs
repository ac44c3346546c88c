//! The rotation group: exponential, logarithm and their Jacobians, accurate near 0 and near π.
//!
//! Formulas: Solà, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", appendix B;
//! series at small angles.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Below this squared angle the series are exact to machine precision.
const SMALL_SQUARED: f64 = 1e-4;

/// The skew-symmetric matrix with `hat(a) * b == a × b`.
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Rotation by the rotation vector `phi`, radians.
pub fn exp(phi: &Vector3<f64>) -> UnitQuaternion<f64> {
    let squared = phi.norm_squared();
    let (real, factor) = if squared < SMALL_SQUARED {
        // cos(a/2) and sin(a/2)/a
        let h = squared * 0.25;
        (
            1.0 - h / 2.0 * (1.0 - h / 12.0 * (1.0 - h / 30.0)),
            0.5 * (1.0 - h / 6.0 * (1.0 - h / 20.0 * (1.0 - h / 42.0))),
        )
    } else {
        let angle = squared.sqrt();
        ((angle * 0.5).cos(), (angle * 0.5).sin() / angle)
    };
    UnitQuaternion::new_normalize(Quaternion::from_parts(real, phi * factor))
}

/// The rotation vector of `rotation`, angle in [0, π].
pub fn log(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let q = rotation.quaternion();
    // q and −q are one rotation: take the half with the shorter angle.
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let (w, v) = (q.w * sign, q.imag() * sign);
    let sine = v.norm();
    if sine < 1e-7 {
        v * (2.0 / w)
    } else {
        v * (2.0 * sine.atan2(w) / sine)
    }
}

/// Coefficients `(1 − cos a)/a²` and `(a − sin a)/a³` of the left Jacobian.
fn left_coefficients(squared: f64) -> (f64, f64) {
    if squared < SMALL_SQUARED {
        (
            0.5 - squared / 24.0 * (1.0 - squared / 30.0 * (1.0 - squared / 56.0)),
            1.0 / 6.0 - squared / 120.0 * (1.0 - squared / 42.0 * (1.0 - squared / 72.0)),
        )
    } else {
        let angle = squared.sqrt();
        (
            (1.0 - angle.cos()) / squared,
            (angle - angle.sin()) / (squared * angle),
        )
    }
}

/// `J_l`: `exp(phi + d) ≈ exp(J_l d) exp(phi)`.
pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let (b, c) = left_coefficients(phi.norm_squared());
    let k = hat(phi);
    Matrix3::identity() + k * b + k * k * c
}

/// `J_r`: `exp(phi + d) ≈ exp(phi) exp(J_r d)`.
pub fn right_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian(&-phi)
}

/// Inverse of [`left_jacobian`], for angles below 2π.
pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let squared = phi.norm_squared();
    let d = if squared < SMALL_SQUARED {
        1.0 / 12.0 + squared / 720.0 + squared * squared / 30240.0
    } else {
        let half = squared.sqrt() * 0.5;
        (1.0 - half / half.tan()) / squared
    };
    let k = hat(phi);
    Matrix3::identity() - k * 0.5 + k * k * d
}

/// Inverse of [`right_jacobian`], for angles below 2π.
pub fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian_inverse(&-phi)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use proptest::prelude::*;

    fn rotation_vector() -> impl Strategy<Value = Vector3<f64>> {
        let small = prop::array::uniform3(-1e-3..1e-3f64);
        let any = prop::array::uniform3(-1.8..1.8f64);
        prop_oneof![small, any].prop_map(Vector3::from)
    }

    proptest! {
        #[test]
        fn log_inverts_exp(phi in rotation_vector()) {
            prop_assume!(phi.norm() < 3.1);
            prop_assert!((log(&exp(&phi)) - phi).norm() < 1e-12);
        }

        #[test]
        fn jacobians_match_numeric_differences(phi in rotation_vector(), d in prop::array::uniform3(-1.0..1.0f64)) {
            prop_assume!(phi.norm() < 3.0);
            let d = Vector3::from(d);
            let h = 1e-6;
            let left = log(&(exp(&(phi + d * h)) * exp(&(phi - d * h)).inverse())) / (2.0 * h);
            prop_assert!((left - left_jacobian(&phi) * d).norm() < 1e-8);
            let right = log(&(exp(&(phi - d * h)).inverse() * exp(&(phi + d * h)))) / (2.0 * h);
            prop_assert!((right - right_jacobian(&phi) * d).norm() < 1e-8);
            prop_assert!((left_jacobian_inverse(&phi) * left_jacobian(&phi) - Matrix3::identity()).norm() < 1e-9);
            prop_assert!((right_jacobian_inverse(&phi) * right_jacobian(&phi) - Matrix3::identity()).norm() < 1e-9);
        }
    }

    #[test]
    fn log_is_accurate_up_to_pi() {
        for angle in [1e-12, 1e-8, 1e-4, PI - 1e-8, PI] {
            let axis = Vector3::new(0.36, -0.48, 0.8);
            assert!(
                (log(&exp(&(axis * angle))).norm() - angle).abs() < 1e-14 + 1e-15 * angle,
                "{angle}"
            );
        }
    }
}
