use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use lsfb_geometry::{ImuNoiseModel, Matrix3, Matrix6, Se3, Vector2, Vector3};
use lsfb_types::{ImuSample, Stamped, Timestamp};

pub(super) use crate::inertial_blocks::FrameState;
use crate::residuals::MovingCamera;
use lsfb_perception::imu::{ImuBias, PreintegratedImu};

/// A recorded walk as the optimisation sees it: what the images and the IMU say, without pixels.
#[derive(Clone)]
pub(super) struct Walk {
    /// Cameras of the rig as its file has them, in their order.
    pub cameras: Vec<Arc<MovingCamera>>,
    /// Instants at which images were taken, in order.
    pub frames: Vec<Frame>,
    /// Inertial samples, in order; none where images alone were recorded.
    pub imu: Vec<Stamped<ImuSample>>,
    /// Noise of the IMU, as the optimisation should take it.
    pub noise: ImuNoiseModel,
    /// Factors of that noise in the intervals after some frames; 1 where none stands here.
    pub noise_factors: BTreeMap<usize, f64>,
    /// Covariances that the map states of the points that were recognised, by their index, m².
    pub point_covariances_m2: Arc<BTreeMap<u32, Matrix3<f64>>>,
}

/// One instant.
#[derive(Clone)]
pub(super) struct Frame {
    pub time: Timestamp,
    /// Pose by visual localization alone, where it succeeded.
    pub localized: Option<LocalizedPose>,
    /// Points of the HD map that were recognised here, rightly or not.
    pub recognised: Vec<FixedObservation>,
    /// Those of them that the optimisation uses.
    pub fixed: Vec<FixedObservation>,
}

/// What visual localization says about one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LocalizedPose {
    pub world_from_rig: Se3,
    /// Covariance, tangent `[rotation, translation]` on the right, rad² and m².
    pub covariance: Matrix6<f64>,
}

/// A point of the HD map in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FixedObservation {
    pub camera: usize,
    /// Index of the feature in the image.
    pub keypoint: u32,
    pub pixel: Vector2<f64>,
    /// Index of the point in the map.
    pub point: u32,
    pub point_in_world: Vector3<f64>,
}

/// A point of the place that is not in the map, seen several times.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LocalPoint {
    pub point_in_world: Vector3<f64>,
    pub observations: Vec<LocalObservation>,
}

/// A sight of a local point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LocalObservation {
    pub frame: usize,
    pub camera: usize,
    pub pixel: Vector2<f64>,
    /// Whether the optimisation uses it.
    pub used: bool,
}

impl LocalPoint {
    /// Whether it is seen often enough to say where it is.
    pub fn is_determined(&self) -> bool {
        self.observations.iter().filter(|seen| seen.used).count() >= 2
    }
}

impl Walk {
    /// Whether an IMU was recorded at all.
    pub fn has_imu(&self) -> bool {
        !self.imu.is_empty()
    }

    /// The same walk with some of its frames, in order, and without what was recognised in them.
    pub fn with_frames(&self, kept: &[usize]) -> Self {
        let frame = |k: &usize| Frame {
            time: self.frames[*k].time,
            localized: self.frames[*k].localized,
            recognised: Vec::new(),
            fixed: Vec::new(),
        };
        Self {
            cameras: self.cameras.clone(),
            frames: kept.iter().map(frame).collect(),
            imu: self.imu.clone(),
            noise: self.noise.clone(),
            noise_factors: BTreeMap::new(),
            point_covariances_m2: Arc::clone(&self.point_covariances_m2),
        }
    }

    /// Takes the noise of the IMU so many times as large in all intervals.
    pub fn loosen_imu(&mut self, noise_factor: f64) {
        let frames = 0..self.frames.len();
        self.noise_factors = frames.map(|k| (k, noise_factor)).collect();
    }

    /// Sums the IMU up between neighbours of some frames, with the bias of the first of each; `None` where samples are missing.
    pub fn preintegrate(
        &self,
        frames: Range<usize>,
        bias_of: impl Fn(usize) -> ImuBias,
    ) -> Vec<Option<PreintegratedImu>> {
        let mut intervals = Vec::with_capacity(frames.len().saturating_sub(1));
        for (k, pair) in frames.clone().zip(self.frames[frames].windows(2)) {
            let sum = PreintegratedImu::integrate(
                &self.imu,
                pair[0].time,
                pair[1].time,
                bias_of(k),
                &self.noise,
            );
            intervals.push(sum.ok().map(|mut sum| {
                let factor = self.noise_factors.get(&k).copied().unwrap_or(1.0);
                sum.covariance *= factor * factor;
                sum
            }));
        }
        intervals
    }
}
