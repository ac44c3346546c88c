//! Where in the HD map a rig is, from the features of its images.

mod p3p;
mod ransac;
mod refinement;

pub use p3p::solve_p3p;
pub use ransac::{MountedCamera, PointMatch, PoseEstimate, RansacConfig, estimate_pose};
pub use refinement::{RefinedPose, RefinementConfig, refine_pose};
