//! Recording and Rig to Trajectory and Map.
