//! Where in the HD map a rig is, from the features of its images.
//!
//! Each feature asks the map's index for its nearest descriptors; the points found vote for the map's images that saw
//! them; around the images with most votes, features and points are paired and [`estimate_pose`] looks for the pose
//! most pairs agree with; projecting the map with it finds the rest (Liu et al., section V-A). Among poses that were given, the images next
//! to it say where it is at last.

mod acceptance;
mod config;
mod covariance;
mod elsewhere;
mod expected;
mod focal_length;
mod generalized_p3p;
mod given_poses;
mod guided_matching;
mod joint_focal_length;
mod judging;
mod kept;
mod localizer;
mod map_error;
mod matches;
mod outcome;
mod p3p;
mod prior;
mod queries;
mod ransac;
mod refinement;
mod scoring;
mod sequence;
mod shared_errors;
mod tally;
mod upright;
mod verified;
mod voting;

pub use crate::frames::images_of_instants;
pub use acceptance::Evidence;
pub use config::LocalizerConfig;
#[cfg(test)]
pub(crate) use elsewhere::Elsewhere;
pub(crate) use elsewhere::{PlacedFrame, find_elsewhere, localize_near};
pub use joint_focal_length::{FocalLengthDecision, JointFocalLength};
pub use localizer::Localizer;
pub use matches::{MountedCamera, PointMatch};
pub use outcome::{FeatureMatch, Localization, NotLocalized, NotLocalizedReason};
pub use p3p::solve_p3p;
pub use prior::{ExpectedPose, PoseKnowledge, Up};
pub(crate) use queries::localize_frames_apart;
pub use queries::{
    ImageLocalization, InstantLocalization, WalkLocalization, judge_together, localize_images,
    localize_posed_images, localize_recording, localize_recording_in_stages,
};
pub use ransac::{PoseEstimate, RansacConfig, estimate_known_pose, estimate_pose};
pub use refinement::{RefinedPose, RefinementConfig, refine_pose};
pub use tally::{RIGHT_ANGLE_DEG, RIGHT_DISTANCE_M, Tally};
pub(crate) use verified::{VerifiedPose, verified_pose};
