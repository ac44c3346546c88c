//! How two cameras stand to each other by what both see: no map, no poses, no scale.
//!
//! [`estimate_relative_pose`] draws samples of five matches, each of which leaves at most ten essential matrices
//! ([`essential_matrices`]: Nistér, "An efficient solution to the five-point relative pose problem", PAMI 2004, by the action matrix of
//! Stewénius, Engels and Nistér, "Recent developments on direct relative orientation", ISPRS 2006), and refines the pose that most
//! matches agree with. Matches are viewing rays, so that pinhole and fisheye lenses are treated alike; errors are Sampson's, in pixels.

mod epipolar_error;
mod five_point;
mod relative_pose;

pub use epipolar_error::RayPair;
pub use five_point::essential_matrices;
pub use relative_pose::{RelativePoseConfig, RelativePoseEstimate, estimate_relative_pose};
