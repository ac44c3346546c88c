use lsfb_geometry::{Matrix6, Se3, UnitQuaternion, Vector3, Vector6, so3};
use nalgebra::{SMatrix, SVector, UnitVector3};

use crate::manifold::directions_across;
use crate::{Linearization, Parameters, Residual, Shape, Undefined};

/// What is known of a vector beforehand. Block: the vector.
///
/// `r = W (x − x̂)`, `∂r/∂x = W`.
#[derive(Clone, Debug)]
pub struct VectorPrior<const N: usize> {
    /// The value that is known.
    pub value: SVector<f64, N>,
    /// Square root of its information.
    pub sqrt_information: SMatrix<f64, N, N>,
}

impl<const N: usize> VectorPrior<N> {
    /// Independent entries with these standard deviations.
    pub fn new(value: SVector<f64, N>, sigmas: SVector<f64, N>) -> Self {
        Self {
            value,
            sqrt_information: SMatrix::from_diagonal(&sigmas.map(|s| 1.0 / s)),
        }
    }
}

impl<const N: usize> Residual for VectorPrior<N> {
    fn dimension(&self) -> usize {
        N
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<SVector<f64, N>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let x: SVector<f64, N> = parameters.get(0);
        out.set_residual(&(self.sqrt_information * (x - self.value)));
        out.set_jacobian(0, &self.sqrt_information);
        Ok(())
    }
}

/// What is known of a rotation beforehand. Block: the rotation.
///
/// `r = log(R̂⁻¹ R) / σ`, `∂r/∂R = Jᵣ⁻¹ / σ`.
#[derive(Clone, Copy, Debug)]
pub struct RotationPrior {
    /// The rotation that is known.
    pub value: UnitQuaternion<f64>,
    /// Its standard deviation about each axis.
    pub sigma_rad: f64,
}

impl Residual for RotationPrior {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<UnitQuaternion<f64>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let rotation: UnitQuaternion<f64> = parameters.get(0);
        let error = so3::log(&(self.value.inverse() * rotation));
        out.set_residual(&(error / self.sigma_rad));
        out.set_jacobian(0, &(so3::right_jacobian_inverse(&error) / self.sigma_rad));
        Ok(())
    }
}

/// What is known of a pose beforehand. Block: the pose.
///
/// With `E = T̂⁻¹ T`: `r = W [log E_R, t_E]`, `∂log E_R/∂φ = Jᵣ⁻¹`, `∂t_E/∂ρ = E_R`.
#[derive(Clone, Copy, Debug)]
pub struct PosePrior {
    /// The pose that is known.
    pub value: Se3,
    /// Square root of the information of `[rotation, translation]`, both in the known body frame.
    pub sqrt_information: Matrix6<f64>,
}

impl PosePrior {
    /// Independent errors, the same in each direction.
    pub fn isotropic(value: Se3, rotation_sigma_rad: f64, translation_sigma_m: f64) -> Self {
        let (r, t) = (1.0 / rotation_sigma_rad, 1.0 / translation_sigma_m);
        Self {
            value,
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
        let pose: Se3 = parameters.get(0);
        let error = self.value.inverse() * pose;
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

/// What is known of a direction beforehand. Block: the direction.
///
/// `r = (d − d̂) / σ`, `∂r/∂d = B / σ` with `B` the two directions across `d`.
#[derive(Clone, Copy, Debug)]
pub struct DirectionPrior {
    /// The direction that is known.
    pub value: UnitVector3<f64>,
    /// Its standard deviation, for small angles.
    pub sigma_rad: f64,
}

impl Residual for DirectionPrior {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<UnitVector3<f64>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let direction: UnitVector3<f64> = parameters.get(0);
        let error: Vector3<f64> = direction.into_inner() - self.value.into_inner();
        out.set_residual(&(error / self.sigma_rad));
        out.set_jacobian(0, &(directions_across(&direction) / self.sigma_rad));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use nalgebra::{Matrix3, Vector2};

    use super::*;
    use crate::{check_residual_jacobian, values_of};

    check_residual_jacobian!(
        vector_prior,
        VectorPrior::new(Vector2::new(1.0, 2.0), Vector2::new(0.5, 3.0)),
        Vector2::new(4.0, -1.0)
    );
    check_residual_jacobian!(
        full_vector_prior,
        VectorPrior {
            value: Vector3::new(0.1, 0.2, 0.3),
            sqrt_information: Matrix3::new(1.0, 2.0, 0.5, 0.0, 3.0, -1.0, 0.0, 0.0, 2.0),
        },
        Vector3::new(4.0, -1.0, 2.0),
    );
    check_residual_jacobian!(
        rotation_prior,
        RotationPrior {
            value: so3::exp(&Vector3::new(0.3, -0.2, 0.7)),
            sigma_rad: 0.1,
        },
        so3::exp(&Vector3::new(-0.4, 1.2, 0.1)),
    );
    check_residual_jacobian!(
        pose_prior,
        PosePrior::isotropic(
            Se3::exp(&Vector6::new(0.3, -0.2, 0.7, 1.0, 2.0, 3.0)),
            0.1,
            0.2
        ),
        Se3::exp(&Vector6::new(-0.4, 1.2, 0.1, 0.5, 0.1, -2.0)),
    );
    check_residual_jacobian!(
        direction_prior,
        DirectionPrior {
            value: UnitVector3::new_normalize(Vector3::new(0.3, -0.2, 0.7)),
            sigma_rad: 0.1,
        },
        UnitVector3::new_normalize(Vector3::new(-0.4, 1.2, -0.1)),
    );

    #[test]
    fn values_are_named_in_the_order_given() {
        let mut problem = crate::Problem::new();
        let blocks = values_of!(problem, Vector2::new(1.0, 2.0), Vector3::zeros());
        assert_eq!((blocks[0].index(), blocks[1].index()), (0, 1));
    }
}
