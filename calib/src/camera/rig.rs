//! A calibration put into a rig, and as edges of the joint graph.

use lsfb_geometry::{Rig, RigCamera, Se3};

use super::CameraCalibration;
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
            let timing = rig
                .cameras
                .get(&calibrated.name)
                .map_or_else(Default::default, |c| c.timing);
            rig.cameras.insert(
                calibrated.name.clone(),
                RigCamera {
                    camera: calibrated.camera,
                    rig_from_camera: rig_from_first * calibrated.camera_from_first.inverse(),
                    timing,
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
