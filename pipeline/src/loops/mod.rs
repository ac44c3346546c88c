#![doc = include_str!("README.md")]

mod agreement;
mod assessment;
mod closing;
mod descriptor;
mod file;
mod graph;
mod keyframes;
mod online;
mod search;
mod ways;

#[cfg(test)]
mod tests;

use lsfb_geometry::{Matrix6, Se3};
use lsfb_types::Timestamp;
use serde::{Deserialize, Serialize};

pub(crate) use agreement::agree;
pub(crate) use assessment::CHI_SQUARED;
pub use closing::{Closing, close_loops};
pub(crate) use graph::{closed_poses, fitting, squared_sigmas};
pub(crate) use keyframes::Keyframe;
pub use online::{OnlineLoop, OnlineLoops};
pub use search::find_loops;
pub(crate) use ways::{Way, Ways};

/// Two scans of one place, or what looks like it.
#[derive(Clone, Debug, PartialEq)]
pub struct Loop {
    /// The end of the scan of the earlier visit.
    pub earlier: Timestamp,
    /// The end of the scan of the later visit.
    pub later: Timestamp,
    /// Whether it is closed.
    pub decision: LoopDecision,
    /// By what it was judged.
    pub scores: LoopScores,
    /// How the two lie to each other, where that was measured.
    pub measured: Option<MeasuredLoop>,
}

/// Whether a loop is closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoopDecision {
    /// It is.
    Accepted,
    /// It is not.
    Rejected(LoopRejection),
}

/// Why a loop is not closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LoopRejection {
    /// The odometry knows that it is elsewhere.
    ContradictsOdometry,
    /// The odometry says too little of where it is for any likeness to prove something.
    OdometryTooUncertain,
    /// Too little of the scan lies on what the earlier ones saw.
    LittleOverlap,
    /// The scan fits elsewhere nearly as well.
    Ambiguous,
    /// The scan does not tell all of its pose there.
    Undetermined,
    /// No other loop nearby says the same.
    Unconfirmed,
    /// It does not fit the other loops.
    ContradictsLoops,
    /// A person said so.
    ByHand,
}

impl LoopRejection {
    /// All of them.
    pub(super) const ALL: [Self; 8] = [
        Self::ContradictsOdometry,
        Self::OdometryTooUncertain,
        Self::LittleOverlap,
        Self::Ambiguous,
        Self::Undetermined,
        Self::Unconfirmed,
        Self::ContradictsLoops,
        Self::ByHand,
    ];

    /// As lists of loops call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::ContradictsOdometry => "contradicts-odometry",
            Self::OdometryTooUncertain => "odometry-too-uncertain",
            Self::LittleOverlap => "little-overlap",
            Self::Ambiguous => "ambiguous",
            Self::Undetermined => "undetermined",
            Self::Unconfirmed => "unconfirmed",
            Self::ContradictsLoops => "contradicts-loops",
            Self::ByHand => "by-hand",
        }
    }
}

/// What a loop was judged by; absent what was not looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoopScores {
    /// Distance of the two scans' descriptors, from 0 (alike) to 1.
    pub appearance: Option<f64>,
    /// Share of the later scan's points that lie on what the earlier ones saw.
    pub overlap: Option<f64>,
    /// The same at the next best place nearby; 0 where there is none.
    pub rival_overlap: Option<f64>,
    /// Root mean square distance of those points to the earlier planes, metres.
    pub plane_rms_m: Option<f64>,
    /// How far it is from where the odometry has it, in standard deviations of the odometry (a norm over six numbers).
    pub odometry_sigmas: Option<f64>,
}

/// How the scans of a loop lie to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredLoop {
    /// Pose of the rig at the later scan, in the rig's frame at the earlier one.
    pub earlier_from_later: Se3,
    /// Its standard deviation about each axis, radians.
    pub rotation_sigma_rad: f64,
    /// Its standard deviation along each axis, metres.
    pub translation_sigma_m: f64,
}

impl MeasuredLoop {
    /// In the tangent of the later pose.
    pub(crate) fn covariance(&self) -> Matrix6<f64> {
        let (r, t) = (self.rotation_sigma_rad, self.translation_sigma_m);
        let mut covariance = Matrix6::identity() * (r * r);
        covariance.fixed_view_mut::<3, 3>(3, 3).fill_diagonal(t * t);
        covariance
    }
}

/// A loop by the numbers of its keyframes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured {
    pub earlier: usize,
    pub later: usize,
    pub loop_: MeasuredLoop,
}

/// Loops of a walk, accepted and rejected, by the time of the later visit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Loops {
    /// All that were looked at.
    pub all: Vec<Loop>,
}

impl Loops {
    /// Those that are closed.
    pub fn accepted(&self) -> impl Iterator<Item = &Loop> {
        let is_accepted = |l: &&Loop| l.decision == LoopDecision::Accepted;
        self.all.iter().filter(is_accepted)
    }
}
