//! What calibration is tried on, by its tests, its examples and those of the program: a [`board`] before a LiDAR and a camera, a
//! [`rig`] in front of a board, a [`graph`] of transforms, and a [`walk`] of the whole backpack. The truth is exact, noise is a
//! parameter, everything is seeded. Boards of others are [`recorded`], and calibrated in [`parts`].

#![allow(missing_docs, reason = "for tests alone, which read the fields' names")]

pub mod board;
pub mod graph;
pub mod parts;
pub mod recorded;
pub mod rig;
pub mod walk;
