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
    pub fn identity() -> Self {
        Self {
            rotation: UnitQuaternion::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// From its two parts.
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

    /// `source_from_target`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// The rotation as a matrix.
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

impl Mul for Se3 {
    type Output = Se3;
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
