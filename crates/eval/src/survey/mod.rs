//! Floor marks surveyed with a tape or a laser, and trajectories and maps checked by them (Eq. 6, Table II).
//!
//! A survey is a small text file, a statement a line, lengths in metres:
//!
//! ```text
//! # p1 and p2 lie on one line of tiles along x, p2 further along; q1 stands above p1 along y
//! sigma distance 0.001
//! sigma line 0.001
//! horizontal p1 p2 1.2003
//! vertical   p1 q1 2.4001
//! distance   p2 q1 2.6833 0.002     # any two marks, with a standard deviation of its own
//! visit p1 p2 q1                    # in which order the device rested on the marks
//! point a 1.20 3.40 0.95            # a point of the map, metres of its world
//! ```

mod adjustment;
mod check;
mod distances;
mod file;
mod inertial_rests;
mod initial;
mod mark_distances;
mod network;
mod observation;
mod own_trajectory;
mod page;
mod rests;
mod snooping;
mod solution;

pub use check::{FarMark, MarkError, MarkReport, check_marks};
pub use distances::{DistanceError, DistanceReport, compare_distances};
pub use file::{Survey, Tape, TapeKind, read_survey};
pub use inertial_rests::{InertialRests, inertial_rests};
pub use mark_distances::{
    Judging, MarkDistance, MeasuredDistance, judge_mark, judge_mark_distances,
};
pub use network::solve_survey;
pub use own_trajectory::expect_own_trajectory;
pub use page::SurveyView;
pub use rests::{Rest, RestConfig, find_rests};
pub use solution::{Mark, ObservationReport, SurveySolution, TermRms};
