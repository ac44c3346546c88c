//! A lens from a block of parameters. How points move with poses is in `lsfb_perception::projection`.

use lsfb_geometry::Camera;
use lsfb_geometry::camera::{LensModel, MAX_PARAMETERS};
use lsfb_solver::Undefined;
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

/// The same while its parameters are searched: undefined where they make no lens.
pub(crate) fn searched_camera<const N: usize>(
    model: LensModel,
    size: [u32; 2],
    parameters: &SVector<f64, N>,
) -> Result<Camera, Undefined> {
    let camera = lens_camera(model, size, parameters);
    match camera.lens.problem() {
        Some(_) => Err(Undefined),
        None => Ok(camera),
    }
}
