//! Trajectory errors, alignment and reports. The judge: this crate alone opens files of ground truth, and it knows no
//! estimator, so that any program's trajectory is judged the same way.
//!
//! Definitions are those of evo 1.38, figure for figure (`tests/evo/README.md`): poses are paired by nearest stamps,
//! the estimate is aligned to the truth, and the errors of pairs become statistics.
//!
//! ```
//! use lsfb_eval::{EvalConfig, evaluate};
//! use lsfb_geometry::{Se3, StampedPose, UnitQuaternion, Vector3};
//! use lsfb_types::Timestamp;
//! let truth: Vec<StampedPose> = (0..50)
//!     .map(|i| StampedPose {
//!         time: Timestamp::from_nanos(i * 100_000_000),
//!         world_from_rig: Se3::new(
//!             UnitQuaternion::identity(),
//!             Vector3::new((i as f64 * 0.1).cos(), (i as f64 * 0.1).sin(), 0.01 * i as f64),
//!         ),
//!     })
//!     .collect();
//! let shift = Se3::new(UnitQuaternion::identity(), Vector3::new(5.0, 0.0, 0.0));
//! let estimate: Vec<StampedPose> = truth
//!     .iter()
//!     .map(|p| StampedPose { world_from_rig: shift * p.world_from_rig, ..*p })
//!     .collect();
//! let found = evaluate(&truth, &estimate, &EvalConfig::default())?;
//! assert!(found.ate_translation_m.rmse < 1e-9); // SE(3) alignment takes the shift away
//! # Ok::<(), lsfb_eval::Error>(())
//! ```

pub mod ablation;
pub mod alignment;
pub mod association;
pub mod barometer;
mod compare;
mod consistency;
pub mod dataset;
mod error;
mod evaluation;
pub mod hand_eye;
pub mod leaderboard;
pub mod metrics;
pub mod pairs;
pub mod radio;
mod read;
mod recall;
pub mod relation;
pub mod report;
pub mod slam_bench;
mod smoothness;
mod statistics;
mod success;
pub mod survey;
mod write;

pub use compare::{Comparison, Contender, compare};
pub use consistency::Consistency;
pub use error::Error;
pub use evaluation::{
    AlignedError, Coverage, DuplicateStamps, EvalConfig, Evaluation, PoseError, Relocalization,
    RpeFigures, SmoothnessFigures, evaluate, evaluate_files,
};
pub use pairs::RpeConfig;
pub use read::{
    Columns, Orientations, ReadOptions, TrajectoryFile, covariance_in_world, read_poses,
    read_trajectory,
};
pub use recall::{Recall, Threshold};
pub use smoothness::Smoothness;
pub use statistics::Statistics;
pub use success::SuccessRate;
pub use write::{TrajectoryFormat, Written, euroc_text, write_trajectory};

/// `1 pose`, `2 poses`.
fn count(number: usize, one: &str, many: &str) -> String {
    match number {
        1 => format!("1 {one}"),
        number => format!("{number} {many}"),
    }
}
