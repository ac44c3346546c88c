//! What is seen and felt, before anything is concluded from it: images, corners, scans and inertial samples.
//!
//! Calibration and mapping both look at the world through these functions; neither has a second one of its own.
//!
//! | module | gives |
//! | --- | --- |
//! | [`image`] | grey images from files, reduced images with their cameras, corners, patches followed from image to image, the rotation between two images |
//! | [`imu`] | samples between two instants summed up (preintegration), with what noise and biases do to the sum |
//! | [`lidar`] | scans deskewed to one instant, planes of points in cells, scans registered to planes |
//! | [`projection`] | how points move with the poses through which they are seen |
//! | [`RelativePose`] | a measured transform between two poses, as a residual of the solver |
//! | [`statistics`] | medians, and peaks between samples |

pub mod image;
pub mod imu;
pub mod lidar;
pub mod projection;
mod relative_pose;
pub mod statistics;

pub use relative_pose::RelativePose;
