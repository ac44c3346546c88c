//! What residuals of corners share: a lens from a block of parameters, and how points move with poses.

use lsfb_geometry::Camera;
use lsfb_geometry::camera::{LensModel, MAX_PARAMETERS};
pub(crate) use lsfb_perception::projection::{moved_by_inverse, moved_by_pose};
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
