//! Rigid transforms: the group SE(3), its exponential and the Jacobians of it.

use std::ops::Mul;

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};

use crate::so3;

/// A rigid transform `target_from_source`: `point_in_target = rotation * point_in_source + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Se3 {
    /// Rotation from source to target.
    pub rotation: UnitQuaternion<f64>,
    /// Origin of the source frame in the target frame, metres.
    pub translation: Vector3<f64>,
}

impl Se3 {
    /// The transform that changes nothing.
    #[inline]
    pub fn identity() -> Self {
        Self {
            rotation: UnitQuaternion::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// From its two parts.
    #[inline]
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self {
            rotation,
            translation,
        }
    }

    /// The exponential of `[rotation, translation]`.
    pub fn exp(delta: &Vector6<f64>) -> Self {
        let phi: Vector3<f64> = delta.fixed_rows::<3>(0).into();
        let rho: Vector3<f64> = delta.fixed_rows::<3>(3).into();
        Self {
            rotation: so3::exp(&phi),
            translation: so3::left_jacobian(&phi) * rho,
        }
    }

    /// The tangent vector `[rotation, translation]` whose exponential this is.
    pub fn log(&self) -> Vector6<f64> {
        let phi = so3::log(&self.rotation);
        let rho = so3::left_jacobian_inverse(&phi) * self.translation;
        Vector6::new(phi.x, phi.y, phi.z, rho.x, rho.y, rho.z)
    }

    /// This transform moved by a tangent vector, on the right: `self * exp(delta)`, with `delta` in the source frame.
    pub fn retract(&self, delta: &Vector6<f64>) -> Self {
        *self * Self::exp(delta)
    }

    /// The tangent vector that moves this transform to another: `self.retract(&self.local(&other)) == other`.
    pub fn local(&self, other: &Self) -> Vector6<f64> {
        (self.inverse() * *other).log()
    }

    /// `source_from_target`.
    #[inline]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// The rotation as a matrix.
    #[inline]
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }

    /// `Ad`: `self * exp(delta) == exp(Ad * delta) * self`.
    pub fn adjoint(&self) -> Matrix6<f64> {
        let r = self.rotation_matrix();
        let mut ad = Matrix6::zeros();
        ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
        ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
        ad.fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(so3::hat(&self.translation) * r));
        ad
    }

    /// The pose at `fraction` of the way to `end`: rotation by geodesic, translation by straight line.
    pub fn interpolate(&self, end: &Self, fraction: f64) -> Self {
        let phi = so3::log(&(self.rotation.inverse() * end.rotation));
        Self {
            rotation: self.rotation * so3::exp(&(phi * fraction)),
            translation: self.translation + (end.translation - self.translation) * fraction,
        }
    }
}

/// `J_l` of SE(3): `exp(xi + d) ≈ exp(J_l d) exp(xi)`, tangent `[rotation, translation]`.
pub fn left_jacobian(xi: &Vector6<f64>) -> Matrix6<f64> {
    let phi: Vector3<f64> = xi.fixed_rows::<3>(0).into();
    blocks(&so3::left_jacobian(&phi), &coupling(xi))
}

/// `J_r` of SE(3): `exp(xi + d) ≈ exp(xi) exp(J_r d)`.
pub fn right_jacobian(xi: &Vector6<f64>) -> Matrix6<f64> {
    left_jacobian(&-xi)
}

/// Inverse of [`left_jacobian`], for angles below 2π.
pub fn left_jacobian_inverse(xi: &Vector6<f64>) -> Matrix6<f64> {
    let phi: Vector3<f64> = xi.fixed_rows::<3>(0).into();
    let inverse = so3::left_jacobian_inverse(&phi);
    blocks(&inverse, &-(inverse * coupling(xi) * inverse))
}

/// Inverse of [`right_jacobian`], for angles below 2π.
pub fn right_jacobian_inverse(xi: &Vector6<f64>) -> Matrix6<f64> {
    left_jacobian_inverse(&-xi)
}

fn blocks(diagonal: &Matrix3<f64>, lower: &Matrix3<f64>) -> Matrix6<f64> {
    let mut all = Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(0, 0).copy_from(diagonal);
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(diagonal);
    all.fixed_view_mut::<3, 3>(3, 0).copy_from(lower);
    all
}

/// How rotation moves translation in the left Jacobian: `Q` of Barfoot, "State Estimation for Robotics", eq. (7.86).
fn coupling(xi: &Vector6<f64>) -> Matrix3<f64> {
    let phi: Vector3<f64> = xi.fixed_rows::<3>(0).into();
    let p = so3::hat(&phi);
    let r = so3::hat(&xi.fixed_rows::<3>(3).into());
    let [second, third, fourth] = coupling_coefficients(phi.norm_squared());
    let (pr, rp) = (p * r, r * p);
    let prp = p * rp;
    r * 0.5
        + (pr + rp + prp) * second
        + (p * pr + rp * p - prp * 3.0) * third
        + (prp * p + p * prp) * fourth
}

/// `(a − sin a)/a³`, `(a² + 2 cos a − 2)/(2a⁴)`, `(2a − 3 sin a + a cos a)/(2a⁵)`.
fn coupling_coefficients(squared: f64) -> [f64; 3] {
    const SECOND: [f64; 12] = so3::inverse_factorials(3);
    const THIRD: [f64; 12] = so3::inverse_factorials(4);
    const FOURTH: [f64; 12] = {
        let mut c = so3::inverse_factorials::<12>(5);
        let mut k = 0;
        while k < c.len() {
            c[k] *= (k + 1) as f64;
            k += 1;
        }
        c
    };
    // The closed forms cancel below two radians.
    if squared < 4.0 {
        [
            so3::series(squared, &SECOND),
            so3::series(squared, &THIRD),
            so3::series(squared, &FOURTH),
        ]
    } else {
        let a = squared.sqrt();
        let (sine, cosine) = a.sin_cos();
        [
            (a - sine) / (squared * a),
            (squared + 2.0 * cosine - 2.0) / (2.0 * squared * squared),
            (2.0 * a - 3.0 * sine + a * cosine) / (2.0 * squared * squared * a),
        ]
    }
}

impl Mul for Se3 {
    type Output = Se3;
    #[inline]
    fn mul(self, rhs: Se3) -> Se3 {
        let mut rotation = self.rotation * rhs.rotation;
        // Long products drift off the unit sphere; one Newton step holds them there.
        rotation.renormalize_fast();
        Se3 {
            rotation,
            translation: self.rotation * rhs.translation + self.translation,
        }
    }
}

impl Mul<Vector3<f64>> for Se3 {
    type Output = Vector3<f64>;
    #[inline]
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn se3() -> impl Strategy<Value = Se3> {
        prop::array::uniform6(-1.5..1.5f64).prop_map(|a| Se3::exp(&Vector6::from(a)))
    }

    proptest! {
        #[test]
        fn group_laws(a in se3(), b in se3(), c in se3()) {
            let near = |x: Se3, y: Se3| (x.inverse() * y).log().norm() < 1e-12;
            prop_assert!(near((a * b) * c, a * (b * c)));
            prop_assert!(near(a * a.inverse(), Se3::identity()));
            prop_assert!(near(Se3::exp(&a.log()), a));
            prop_assert!(near(a.retract(&a.local(&b)), b));
        }

        #[test]
        fn jacobians_match_numeric_differences(
            xi in prop::array::uniform6(-1.7..1.7f64), shrink in 0..4i32, d in prop::array::uniform6(-1.0..1.0f64),
        ) {
            let (mut xi, d) = (Vector6::from(xi), Vector6::from(d));
            let angle = 100f64.powi(-shrink);
            xi.fixed_rows_mut::<3>(0).scale_mut(angle);
            let h = 1e-5;
            let (up, down) = (Se3::exp(&(xi + d * h)), Se3::exp(&(xi - d * h)));
            let left = (up * down.inverse()).log() / (2.0 * h);
            prop_assert!((left - left_jacobian(&xi) * d).norm() < 1e-8);
            let right = (down.inverse() * up).log() / (2.0 * h);
            prop_assert!((right - right_jacobian(&xi) * d).norm() < 1e-8);
            prop_assert!((left_jacobian_inverse(&xi) * left_jacobian(&xi) - Matrix6::identity()).norm() < 2e-14);
            prop_assert!((right_jacobian_inverse(&xi) * right_jacobian(&xi) - Matrix6::identity()).norm() < 2e-14);
            // J_l = Ad(exp) J_r
            let through = Se3::exp(&xi).adjoint() * right_jacobian(&xi);
            prop_assert!((through - left_jacobian(&xi)).norm() < 2e-14);
        }

        #[test]
        fn adjoint_moves_a_perturbation_across(a in se3(), d in prop::array::uniform6(-0.5..0.5f64)) {
            let d = Vector6::from(d);
            let left = a * Se3::exp(&d);
            let right = Se3::exp(&(a.adjoint() * d)) * a;
            prop_assert!((left.inverse() * right).log().norm() < 1e-12);
        }
    }
}
