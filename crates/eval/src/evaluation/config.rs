//! How a trajectory is judged.

use lsfb_types::Bounds;

use crate::alignment::AlignmentMode;
use crate::association::MAX_DIFFERENCE;
use crate::pairs::{PairSelection, RpeConfig};
use crate::read::Orientations;
use crate::recall::Threshold;
use crate::relation::DeltaUnit;

/// What becomes of poses that share one stamp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DuplicateStamps {
    /// Each counts, as evo has it; [`crate::Evaluation::duplicate_stamps`] says how many there were.
    #[default]
    Keep,
    /// They are an error.
    Refuse,
}

/// How a trajectory is judged.
#[derive(Clone, Debug, PartialEq)]
pub struct EvalConfig {
    /// Largest difference of two stamps that belong together, seconds.
    pub max_difference_secs: f64,
    /// What is taken away before errors are measured.
    pub alignment: AlignmentMode,
    /// Poses that share one stamp.
    pub duplicates: DuplicateStamps,
    /// Whether rotations of truth and estimate mean anything: without them nothing is said about rotations.
    pub orientations: Orientations,
    /// The relative errors wanted: an error where no two poses are that far apart.
    pub rpe: Vec<RpeConfig>,
    /// Relative errors that are left out, with a finding, where no two poses are that far apart.
    pub rpe_where_possible: Vec<RpeConfig>,
    /// What counts as found.
    pub recall: Vec<Threshold>,
    /// Neighbouring poses of the estimate further apart than this leave the truth between them uncovered, seconds.
    pub coverage_gap_secs: f64,
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self {
            max_difference_secs: 0.01,
            alignment: AlignmentMode::Se3,
            duplicates: DuplicateStamps::Keep,
            orientations: Orientations::Known,
            rpe: vec![RpeConfig {
                delta: 1.0,
                unit: DeltaUnit::Metres,
                selection: PairSelection::Consecutive,
            }],
            rpe_where_possible: Vec::new(),
            recall: Threshold::USUAL.to_vec(),
            coverage_gap_secs: 1.0,
        }
    }
}

lsfb_types::bounds! {
    EvalConfig {
        max_difference_secs: number(MAX_DIFFERENCE),
        alignment: any,
        duplicates: any,
        orientations: any,
        rpe: sections,
        rpe_where_possible: sections,
        recall: any,
        coverage_gap_secs: number(Bounds::POSITIVE),
    }
}
