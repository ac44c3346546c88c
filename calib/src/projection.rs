//! What residuals of corners share: a lens from a block of parameters, and how a point moves with a pose.

use lsfb_geometry::camera::{LensModel, MAX_PARAMETERS};
use lsfb_geometry::{Camera, Matrix3x6, Se3, Vector3, so3};
use nalgebra::SVector;

/// The camera of a model with the first `N` parameters.
pub(crate) fn lens_camera<const N: usize>(
    model: LensModel,
    [width, height]: [u32; 2],
    parameters: &SVector<f64, N>,
) -> Camera {
    let mut values = [0.0; MAX_PARAMETERS];
    values[..N].copy_from_slice(parameters.as_slice());
    Camera {
        width,
        height,
        lens: model.lens(&values),
    }
}

/// Derivative of `pose · exp(δ) · point` by `δ`.
pub(crate) fn moved_by_pose(pose: &Se3, point: &Vector3<f64>) -> Matrix3x6<f64> {
    let r = pose.rotation_matrix();
    let mut by = Matrix3x6::zeros();
    by.fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&(-(r * so3::hat(point))));
    by.fixed_view_mut::<3, 3>(0, 3).copy_from(&r);
    by
}
