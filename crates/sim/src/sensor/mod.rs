//! What the sensors of a rig measure.

pub mod camera;
pub mod imu;
pub mod lidar;
