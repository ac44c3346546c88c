//! Problems for the solver, for its tests, its examples and its fuzz target: [`bal`] (bundle adjustment in the large), [`g2o`]
//! (pose graphs), [`stereo`] (odometry as GTSAM's example data has it), and a [`walk`] that is simulated and grows.

#![allow(missing_docs, reason = "fields are named as their formats name them")]

pub mod bal;
pub mod g2o;
pub mod gauge;
pub mod stereo;
pub mod walk;
