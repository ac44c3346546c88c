//! What other programs recorded: ROS bags ([`RosBag`]), files of point clouds ([`read_cloud`], [`CloudFolder`]), and walks of phones and
//! datasets, which become recordings ([`import`]).
//!
//! Readers only, and as tolerant as can be without guessing: what a file does not say is asked for or told, never made up.
//!
//! ```
//! use lsfb_datasets::{ScanTimes, CloudFolder};
//!
//! # let folder = tempfile::tempdir()?;
//! # std::fs::write(folder.path().join("7.bin"), [[1.0_f32, 2.0, 3.0, 0.5].map(f32::to_le_bytes); 2].as_flattened().as_flattened())?;
//! let clouds = CloudFolder::open(folder.path(), 10.0)?;
//! for cloud in clouds.scans() {
//!     assert_eq!(cloud?.cloud.scan.points.len(), 2);
//! }
//! assert_eq!(clouds.scan_times(), ScanTimes::Rate);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod clouds;
mod error;
pub mod import;
mod rosbag;

pub use clouds::{
    CloudFolder, FileScan, GraphCloud, ScanTimes, is_graph_folder, read_cloud, read_graph_folder,
};
pub use error::Error;
pub use rosbag::{BagImu, LidarMessages, LidarTopic, RosBag, Unread, pose_in};
