//! A calibration in a rig, and as Kalibr's files.

use lsfb_geometry::Rig;

use super::CameraImuCalibration;
use crate::exchange::{ChainCamera, camera_chain};

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

    /// Kalibr's `camchain-imucam.yaml`.
    pub fn to_kalibr(&self) -> String {
        camera_chain(self.cameras.iter().map(|found| ChainCamera {
            name: &found.name,
            camera: &found.camera,
            camera_from_shared: found.camera_from_rig,
            imu_from_camera_s: Some(found.rig_from_camera_s),
        }))
    }
}
