//! A calibration in a rig, and as Kalibr's files.

use std::fmt::Write as _;

use lsfb_geometry::{Rig, RigImu, Se3};

use super::CameraImuCalibration;
use crate::camera::kalibr_camera;

/// Kalibr's `imu.yaml`.
pub fn imu_to_kalibr(noise: &RigImu, rate_hz: f64, topic: &str) -> String {
    format!(
        "rostopic: {topic}\nupdate_rate: {rate_hz:?}\naccelerometer_noise_density: {:?}\naccelerometer_random_walk: {:?}\ngyroscope_noise_density: {:?}\ngyroscope_random_walk: {:?}\n",
        noise.accel_noise_density,
        noise.accel_bias_walk,
        noise.gyro_noise_density,
        noise.gyro_bias_walk
    )
}

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
        let mut text = String::new();
        let mut before: Option<Se3> = None;
        for (k, found) in self.cameras.iter().enumerate() {
            // Infallible on a String.
            let _ = writeln!(text, "cam{k}:");
            text += &matrix("T_cam_imu", &found.camera_from_rig);
            if let Some(before) = before {
                let chain = found.camera_from_rig * before.inverse();
                text += &matrix("T_cn_cnm1", &chain);
            }
            text += &kalibr_camera(&found.name, &found.camera);
            let _ = writeln!(text, "  timeshift_cam_imu: {:?}", found.rig_from_camera_s);
            before = Some(found.camera_from_rig);
        }
        text
    }
}

fn matrix(name: &str, pose: &Se3) -> String {
    let (r, t) = (pose.rotation_matrix(), pose.translation);
    let mut text = format!("  {name}:\n");
    for row in 0..3 {
        let _ = writeln!(
            text,
            "  - [{:?}, {:?}, {:?}, {:?}]",
            r[(row, 0)],
            r[(row, 1)],
            r[(row, 2)],
            t[row]
        );
    }
    text + "  - [0.0, 0.0, 0.0, 1.0]\n"
}
