//! Recordings, maps and trajectories for the Rerun viewer.
