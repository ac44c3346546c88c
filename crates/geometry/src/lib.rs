//! Geometry of the sensors: rotations and rigid transforms with their Jacobians, integrated angular velocities, camera models, the [`Rig`],
//! [`Trajectory`] and alignment.
//!
//! Conventions, once: a transform is named `target_from_source` and takes coordinates from source to target.
//! Tangent vectors are `[rotation, translation]` and perturb on the right, `x * exp(delta)`.
//! Rig: x forward, y left, z up. Camera: x right, y down, z forward. World: z up, gravity along −z.
//!
//! ```
//! use lsfb_geometry::{Se3, Vector3, Vector6};
//! let world_from_rig = Se3::exp(&Vector6::new(0.0, 0.0, 0.1, 1.0, 2.0, 0.0));
//! let point_in_rig = Vector3::new(1.0, 0.0, 0.0);
//! let point_in_world = world_from_rig * point_in_rig;
//! assert!(((world_from_rig.inverse() * point_in_world) - point_in_rig).norm() < 1e-12);
//! ```

pub mod align;
pub mod camera;
mod integrated_gyro;
mod rig;
pub mod rolling_shutter;
pub mod se3;
pub mod so3;
pub mod spline;
mod trajectory;

pub use camera::Camera;
pub use integrated_gyro::IntegratedGyro;
pub use nalgebra::{
    Matrix2, Matrix2x3, Matrix2x6, Matrix3, Matrix3x6, Matrix6, Quaternion, UnitQuaternion,
    Vector2, Vector3, Vector6,
};
pub use rig::{
    CameraSigmas, CameraTiming, ImuNoiseModel, MAIN_IMU, MAIN_LIDAR, Rig, RigCamera, RigError,
    RigImu, RigLidar, toml_problem,
};
pub use se3::Se3;
pub use trajectory::{StampedPose, Trajectory, mean_position, path_length_m};
