//! A calibration put into a rig, and as edges of the joint graph.

use lsfb_geometry::{CameraSigmas, Matrix6, Rig};

use super::{CameraImuCalibration, CameraOnImu};
use crate::camera::focal_sigma;
use crate::transform::{IMU, TransformEdge};

impl CameraImuCalibration {
    /// Lenses, poses, clocks and shutters put into `rig`, for those of its cameras that were calibrated.
    pub fn put_into(&self, rig: &mut Rig) {
        for found in &self.cameras {
            if let Some(mounted) = rig.cameras.get_mut(&found.name) {
                mounted.camera = found.camera;
                mounted.rig_from_camera = found.camera_from_rig.inverse();
                mounted.timing.rig_from_camera_s = found.rig_from_camera_s;
                mounted.timing.readout_s = found.readout_s;
                mounted.sigmas = found.sigmas(&mounted.sigmas);
            }
        }
    }

    /// Poses of the cameras in the IMU for the joint graph, with their covariances.
    pub fn edges(&self) -> Vec<TransformEdge> {
        let edge = |found: &CameraOnImu| TransformEdge {
            target: IMU.to_owned(),
            source: found.name.clone(),
            target_from_source: found.camera_from_rig.inverse(),
            covariance: Some(found.covariance_in_rig()),
        };
        self.cameras.iter().map(edge).collect()
    }
}

impl CameraOnImu {
    /// Covariance of the camera's pose in the rig, `[rotation, translation]`, by right perturbation.
    fn covariance_in_rig(&self) -> Matrix6<f64> {
        // (T exp δ)⁻¹ = T⁻¹ exp(−Ad_T δ)
        let by = self.camera_from_rig.adjoint();
        let covariance = by * self.covariance * by.transpose();
        // Symmetric to the last bit, as files of transforms want it.
        (covariance + covariance.transpose()) * 0.5
    }

    /// How well all of it is known; as `before` what was not searched.
    fn sigmas(&self, before: &CameraSigmas) -> CameraSigmas {
        CameraSigmas {
            focal_share: focal_sigma(&self.lens).or(before.focal_share),
            rig_from_camera_s: CameraSigmas::estimated(self.rig_from_camera_sigma_s),
            readout_s: CameraSigmas::estimated(self.readout_sigma_s).or(before.readout_s),
            ..CameraSigmas::of_pose(&self.covariance_in_rig())
        }
    }
}
