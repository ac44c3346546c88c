//! A calibration put into a rig, and as edges of the joint graph.

use lsfb_geometry::Rig;

use super::{CameraImuCalibration, CameraOnImu};
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
            }
        }
    }

    /// Poses of the cameras in the IMU for the joint graph, with their covariances.
    pub fn edges(&self) -> Vec<TransformEdge> {
        let edge = |found: &CameraOnImu| {
            // (T exp δ)⁻¹ = T⁻¹ exp(−Ad_T δ)
            let by = found.camera_from_rig.adjoint();
            let covariance = by * found.covariance * by.transpose();
            TransformEdge {
                target: IMU.to_owned(),
                source: found.name.clone(),
                target_from_source: found.camera_from_rig.inverse(),
                // Symmetric to the last bit, as files of transforms want it.
                covariance: Some((covariance + covariance.transpose()) * 0.5),
            }
        };
        self.cameras.iter().map(edge).collect()
    }
}
