//! A calibration put into a rig, and as edges of the joint graph.

use lsfb_geometry::{CameraSigmas, Rig, RigCamera, Se3};

use super::{CameraCalibration, focal_sigma};
use crate::TransformEdge;

impl CameraCalibration {
    /// The cameras put into `rig`: those it has already keep the first one's pose on the rig and get lenses and poses to each
    /// other from here. In an empty rig the first camera is the origin.
    pub fn put_into(&self, rig: &mut Rig) {
        let rig_from_first = self
            .cameras
            .first()
            .and_then(|c| rig.cameras.get(&c.name))
            .map_or_else(Se3::identity, |c| c.rig_from_camera);
        for calibrated in &self.cameras {
            let before = rig.cameras.get(&calibrated.name);
            let timing = before.map(|c| c.timing).unwrap_or_default();
            let rig_from_camera = rig_from_first * calibrated.camera_from_first.inverse();
            let sigmas = before.map(|c| match c.rig_from_camera == rig_from_camera {
                true => c.sigmas,
                // Poses on the IMU are not known from here.
                false => CameraSigmas {
                    rotation_rad: None,
                    translation_m: None,
                    ..c.sigmas
                },
            });
            let sigmas = CameraSigmas {
                focal_share: focal_sigma(&calibrated.parameters),
                ..sigmas.unwrap_or_default()
            };
            rig.cameras.insert(
                calibrated.name.clone(),
                RigCamera {
                    camera: calibrated.camera,
                    rig_from_camera,
                    timing,
                    sigmas,
                },
            );
        }
    }

    /// Poses of the first camera in the others for the joint graph, with their covariances; none for one camera.
    pub fn edges(&self) -> Vec<TransformEdge> {
        let Some((first, others)) = self.cameras.split_first() else {
            return Vec::new();
        };
        let edge = |other: &super::CalibratedCamera| TransformEdge {
            target: other.name.clone(),
            source: first.name.clone(),
            target_from_source: other.camera_from_first,
            covariance: Some(other.pose_covariance),
        };
        others.iter().map(edge).collect()
    }
}
