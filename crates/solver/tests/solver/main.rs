//! The solver as its users meet it.

mod bad_problems;
mod bal;
mod constraints;
mod covariance;
mod edge_cases;
mod incremental;
mod pose_graph;
mod recordings;
mod residual_sets;
mod stereo_odometry;
mod threads;
mod ways;
