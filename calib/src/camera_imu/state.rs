//! What the batch estimates, and what it estimates it from.

use lsfb_geometry::camera::LensModel;
use lsfb_geometry::rolling_shutter::row_time_s;
use lsfb_geometry::{Camera, ImuNoiseModel, Se3, Vector2, Vector3};
use lsfb_types::Finding;

use super::bend::Bend;
use super::inertial::AxisErrors;
use super::{Clock, Motion};
use crate::residual_diagnosis::Unmodelled;

pub(super) struct View {
    pub camera: usize,
    /// The camera's own stamp, seconds after the origin.
    pub stamp_s: f64,
    pub corners: Vec<(Vector3<f64>, Vector2<f64>)>,
    pub inliers: Vec<bool>,
    pub holdout: bool,
}

pub(super) struct Sample {
    pub time_s: f64,
    pub gyro: Vector3<f64>,
    pub accel: Vector3<f64>,
    /// Axes that are at the end of their range.
    pub gyro_saturated: [bool; 3],
    pub accel_saturated: [bool; 3],
}

/// A camera on its way.
pub(super) struct Mounted {
    pub name: String,
    pub camera: Camera,
    pub camera_from_rig: Se3,
    pub clock: Clock,
    pub readout_s: f64,
    /// Standard deviation of a corner in one direction, pixels.
    pub sigma_px: f64,
    /// What moves its pixels that the models of lens and board do not know of: a board that is taken to be flat as this camera
    /// sees it, and the rest.
    pub unmodelled: Unmodelled,
    /// Median error of its corners with each view for itself, pixels.
    pub alone_px: f64,
    pub cells: Vec<u32>,
}

impl Mounted {
    /// When the row of a pixel is exposed, after the view's time, seconds.
    pub fn row_s(&self, pixel: &Vector2<f64>) -> f64 {
        row_time_s(&self.camera, self.readout_s, pixel.y)
    }

    pub fn model(&self) -> LensModel {
        self.camera.lens.model()
    }
}

/// Everything that is estimated, and what it is estimated from.
pub(super) struct RigEstimate {
    pub motion: Motion,
    pub cameras: Vec<Mounted>,
    /// Control points of the biases, and how far apart they are, seconds.
    pub gyro_bias: Vec<Vector3<f64>>,
    pub accel_bias: Vec<Vector3<f64>>,
    pub bias_spacing_s: f64,
    pub gyro_axes: AxisErrors,
    pub accel_axes: AxisErrors,
    /// How much later than the gyroscope the accelerometer measures, seconds.
    pub accel_delay_s: f64,
    pub gravity: Vector3<f64>,
    pub bend: Bend,
    /// Time at which the offsets of the clocks hold, seconds after the origin.
    pub middle_s: f64,
    /// Middle of the board, and how far its corners lie from it, metres.
    pub centre: Vector3<f64>,
    pub half_board_m: f64,
    pub samples: Vec<Sample>,
    pub views: Vec<View>,
    pub noise: ImuNoiseModel,
    /// Standard deviation of a sample.
    pub gyro_sigma: f64,
    pub accel_sigma: f64,
    pub rate_rms: Vector3<f64>,
    pub force_rms: Vector3<f64>,
    /// What was found before the first guess.
    pub findings: Vec<Finding>,
}
