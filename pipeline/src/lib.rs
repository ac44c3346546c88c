//! Recording and Rig to Trajectory and Map.
//!
//! The mapping half turns a backpack's recording into an HD map; the localization half turns a device's images into
//! poses in that map. Stages meet in files: the HD map is a folder of Arrow IPC files.
//!
//! Everything here is deterministic: same input, config and seed give bit-identical results on any number of threads.

mod arrow_file;
mod bending;
mod camera_fit;
pub mod descriptor_index;
mod deskewed;
mod error;
pub mod features;
mod frames;
pub mod ground_truth;
pub mod hd_map;
mod inertial_blocks;
pub mod kept_stages;
pub mod lidar_features;
pub mod localization;
pub mod loops;
pub mod mapping;
pub mod odometry;
mod place_search;
pub mod posed_images;
mod read_ahead;
pub mod residuals;
mod sampling;
mod solve;
pub mod stored_clouds;
pub mod surface;
pub mod two_view;
pub mod vlad;
mod worst_sigma;

pub use error::{Error, MapShortage, Refusal};
