//! Settings of every stage, as TOML.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_calib::camera::CameraConfig;
use lsfb_calib::camera_imu::CameraImuConfig;
use lsfb_calib::imu_noise::ImuNoiseConfig;
use lsfb_calib::joint::JointConfig;
use lsfb_calib::lidar_camera::LidarCameraConfig;
use lsfb_calib::verify::VerifyConfig;
use lsfb_capture::clock::ClockConfig;
use lsfb_capture::doctor::DoctorConfig;
use lsfb_pipeline::ground_truth::GroundTruthConfig;
use lsfb_pipeline::hd_map::PosedMapConfig;
use lsfb_pipeline::mapping::MappingConfig;
use lsfb_pipeline::odometry::OdometryConfig;
use lsfb_sim::SimConfig;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// What is read can be written, and is read as the same.
fn read<C: DeserializeOwned + Serialize>(text: &str) -> Option<C> {
    let config: C = toml::from_str(text).ok()?;
    if let Ok(written) = toml::to_string(&config) {
        let again: C = toml::from_str(&written).expect("it was written");
        assert_eq!(toml::to_string(&again).ok(), Some(written));
    }
    Some(config)
}

fuzz_target!(|data: &[u8]| {
    let Some((kind, data)) = data.split_first() else {
        return;
    };
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    match kind {
        b'c' => drop(read::<CameraConfig>(text)),
        b'i' => drop(read::<CameraImuConfig>(text)),
        b'n' => drop(read::<ImuNoiseConfig>(text)),
        b'j' => drop(read::<JointConfig>(text)),
        b'l' => drop(read::<LidarCameraConfig>(text)),
        b'v' => drop(read::<VerifyConfig>(text)),
        b'k' => drop(read::<ClockConfig>(text)),
        b'd' => drop(read::<DoctorConfig>(text)),
        b'g' => drop(read::<GroundTruthConfig>(text)),
        b'p' => drop(read::<PosedMapConfig>(text)),
        b'm' => drop(read::<MappingConfig>(text)),
        b'o' => drop(read::<OdometryConfig>(text)),
        _ => {
            if let Some(config) = read::<SimConfig>(text) {
                let _ = config.check();
            }
        }
    }
});
