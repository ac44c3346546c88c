//! Cameras in COLMAP's words, which kapture and nerfstudio use as well.

use lsfb_geometry::Camera;
use lsfb_geometry::camera::ColmapError;

/// A camera by its model and parameters; what is wrong, and what helps, where it is none.
pub(super) fn camera(model: &str, size: [u32; 2], parameters: &[f64]) -> Result<Camera, String> {
    Camera::from_colmap(model, size, parameters).map_err(|error| match error {
        ColmapError::Model { .. } | ColmapError::Rational => {
            format!("camera {error}: undistort the images to PINHOLE")
        }
        other => other.to_string(),
    })
}
