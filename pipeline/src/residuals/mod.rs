//! The terms of the optimisation problems, one file each: formula, Jacobian, test against numeric differences.

mod between_reprojection;
mod bias_walk;
mod fixed_point_reprojection;
mod imu_preintegration;
mod lidar_edge;
mod lidar_plane;
mod moving_camera;
mod moving_reprojection;
mod reprojection;
#[cfg(test)]
mod strategies;
mod surveyed_point;

pub use between_reprojection::BetweenReprojection;
pub use bias_walk::BiasWalk;
pub use fixed_point_reprojection::FixedPointReprojection;
pub use imu_preintegration::ImuPreintegration;
pub use lidar_edge::LidarEdge;
pub use lidar_plane::LidarPlane;
pub use moving_camera::{CameraCorrection, FrameMotion, MovingCamera};
pub(crate) use moving_camera::{entry, stated_from_found};
pub use moving_reprojection::MovingReprojection;
pub use reprojection::{ObservingCamera, Reprojection};
pub use surveyed_point::SurveyedPoint;
