//! Trajectory errors, alignment and reports.
