//! The rotation between vectors that are the same in two frames (Kabsch).

use lsfb_geometry::{Matrix3, UnitQuaternion, Vector3};
use nalgebra::Rotation3;

/// The rotation that turns `b` onto `a` best, from the sum of `a bᵀ`; vectors of one plane determine it.
pub(super) fn best_rotation(crossed: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let svd = crossed.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut sign = Vector3::repeat(1.0);
    // A mirror fits as well: the direction that says least is turned round.
    sign[svd.singular_values.imin()] = (u * v_t).determinant().signum();
    let matrix = u * Matrix3::from_diagonal(&sign) * v_t;
    let rotation = Rotation3::from_matrix_unchecked(matrix);
    Some(UnitQuaternion::from_rotation_matrix(&rotation))
}
