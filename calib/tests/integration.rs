//! Calibration from outside: recordings of others and simulated rigs.

mod board_poses;
mod camera_imu;
mod charuco;
mod disjoint_parts;
mod exchange;
mod imu_noise;
mod joint;
mod lidar_camera;
mod recordings;
mod refine;
mod verify_recording;
