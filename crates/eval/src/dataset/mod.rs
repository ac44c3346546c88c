//! Datasets: what is recorded where, by whom and how it is packed; what its sequences measure; and whether that can be true.
//!
//! A dataset is a folder:
//!
//! | path | what |
//! | --- | --- |
//! | `dataset.toml` | environments and sequences, and the hash of the truth that is held back |
//! | `SHA256SUMS` | hash of every file but the truth, as `sha256sum --check` reads it |
//! | `LICENSE.txt`, `README.txt` | |
//! | `calibration/DEVICE.toml` | rigs |
//! | `map/ENVIRONMENT/scan.mcap` | scans, for maps |
//! | `query/SEQUENCE/walk.mcap` | walks, to be localized |
//! | `truth/SHA256SUMS`, `truth/map/ENVIRONMENT.tum`, `truth/query/SEQUENCE.tum` | true trajectories: this folder may be held back |

mod description;
mod folder;
mod images;
mod indoor_location;
mod motion;
mod page;
mod plan;
mod plausible;
mod sequence;
mod session;
mod sums;
mod tables;

pub use description::{Description, MapEntry, QueryEntry};
pub use folder::{DatasetFolder, TRUTH};
pub use images::{CameraFigures, ImageFigures, image_figures};
pub use indoor_location::indoor_location;
pub use motion::{MotionFigures, motion_figures};
pub use page::{DatasetViews, EnvironmentView, EstimateView};
pub use plan::{DatasetPlan, Device, Environment, Gait, Gaze, Motion, PerDevice, PlannedSequence};
pub use plausible::{judge_measured, judge_planned};
pub use sequence::{SequenceFigures, measure};
pub use session::{LamarSession, lamar_session};
pub use sums::{Difference, SUMS, check_sums, write_sums};
pub use tables::{cameras_table, environments_table, motion_classes_table, motions_table};

#[cfg(test)]
mod tests;
