//! Calibration that says whether it may be trusted.
//!
//! A [`Target`] is found in images by [`detect`]; [`camera`] makes lenses and poses of cameras of
//! that, and [`camera_imu`] puts them on an IMU. Every result carries the errors it leaves, and says in words what to record better.
//!
//! ```no_run
//! use lsfb_calib::Target;
//! use lsfb_calib::camera::{CameraConfig, calibrate_cameras, views_from_folder};
//! use lsfb_types::no_progress;
//!
//! let board = Target::Checkerboard { columns: 9, rows: 6, square_m: 0.025 };
//! let views = views_from_folder("cam0", "images".as_ref(), "", &board, &no_progress)?;
//! let calibration = calibrate_cameras(&board, &[views], &CameraConfig::default(), &no_progress)?;
//! println!("{}", calibration.judgement().headline(&calibration.summary()));
//! # Ok::<(), lsfb_calib::Error>(())
//! ```

mod angles;
pub mod board;
pub mod camera;
pub mod camera_imu;
mod clusters;
mod copies;
mod coverage;
pub mod detect;
mod error;
pub mod exchange;
mod findings;
pub mod imu_noise;
pub mod joint;
pub mod lidar_camera;
mod overlapping_planes;
mod overlay;
mod plots;
mod projection;
mod recorded;
pub mod refine;
mod residual_diagnosis;
mod scatter;
mod stamps;
mod transform;
pub mod verify;

pub use angles::{Angles, PoseNumbers};
pub use board::Target;
pub use error::{
    BadImu, Error, JoinProblem, NoRest, PatternExcess, PoorMotion, SeenInstead, TargetProblem,
    WrongSize, WrongUnit,
};
pub use overlay::Overlay;
pub use transform::TransformEdge;
