//! Pixels of mounted cameras beside the map points that they may show.

use lsfb_geometry::{Camera, Matrix3, Se3, Vector2, Vector3};

/// A camera with its place on the rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountedCamera {
    /// Size and lens.
    pub camera: Camera,
    /// Pose of the camera in the rig frame.
    pub rig_from_camera: Se3,
    /// Time from the first row to one row below the last, seconds; zero where all rows are exposed at once.
    pub readout_s: f64,
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
    /// Covariance of its position, m²; zero of one that is exact.
    pub point_covariance_m2: Matrix3<f64>,
}

/// The matches that agree with a pose.
pub(super) struct PosedMatches<'a> {
    pub cameras: &'a [MountedCamera],
    pub matches: &'a [PointMatch],
    pub world_from_rig: &'a Se3,
    /// Errors beyond this count linearly, pixels.
    pub huber_px: f64,
}
