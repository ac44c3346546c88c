//! Pixels of mounted cameras beside the map points that they may show.

use lsfb_geometry::{Camera, Se3, Vector2, Vector3};

/// A camera with its place on the rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountedCamera {
    /// Size and lens.
    pub camera: Camera,
    /// Pose of the camera in the rig frame.
    pub rig_from_camera: Se3,
}

/// A map point and the pixel that may show it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointMatch {
    /// Index of the camera among the mounted ones.
    pub camera: usize,
    /// Where it is seen.
    pub pixel: Vector2<f64>,
    /// The point, metres.
    pub point_in_world: Vector3<f64>,
}
