//! Where in the HD map a rig is, from the features of its images.
//!
//! Each feature asks the map's index for its nearest descriptors; the points found vote for the map's images that saw
//! them; around the images with most votes, features and points are paired and [`estimate_pose`] looks for the pose
//! most pairs agree with; projecting the map with it finds the rest (Liu et al., section V-A).

mod localizer;
mod matches;
mod p3p;
mod posed;
mod ransac;
mod refinement;
mod voting;

pub use localizer::{
    FeatureMatch, Localization, Localizer, LocalizerConfig, NotLocalized, NotLocalizedReason,
};
pub use matches::{MountedCamera, PointMatch};
pub use p3p::solve_p3p;
pub use posed::{ImageLocalization, localize_posed_images};
pub use ransac::{PoseEstimate, RansacConfig, estimate_pose};
pub use refinement::{RefinedPose, RefinementConfig, refine_pose};
