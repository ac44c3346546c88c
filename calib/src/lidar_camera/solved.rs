//! What an adjustment gives, and which patch of each scan it used.

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix6, Se3, Vector3};

use super::Scene;
use super::candidates::Patch;
use super::plane::{Chord, PlaneFit};

/// One pose in the adjustment.
#[derive(Clone)]
pub(super) struct Used {
    pub scene: usize,
    pub patch: usize,
    /// Returns on the board, less the offsets of their beams and of dark parts.
    pub chords: Vec<Chord>,
    pub fit: PlaneFit,
    pub camera_from_board: Se3,
    pub edges_used: usize,
}

/// By how much ranges to dark parts are longer than those to bright ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DarkExcess {
    pub excess_m: f64,
    pub sigma_m: f64,
}

pub(super) struct Solved {
    pub camera_from_lidar: Se3,
    pub covariance: Matrix6<f64>,
    /// Excess of half the width, half the height, and of every range, metres.
    pub apparent_m: Vector3<f64>,
    pub apparent_sigma_m: Vector3<f64>,
    pub used: Vec<Used>,
    /// Scenes left out, and why.
    pub rejected: Vec<(usize, String)>,
    pub range_noise_m: f64,
    pub beam_noise_m: f64,
    pub beam_offsets_m: BTreeMap<u16, f64>,
    pub dark: Option<DarkExcess>,
    pub spread: [f64; 3],
}

/// The LiDAR's part of a pose, for reports.
pub(super) fn patch<'a>(scenes: &'a [Scene], used: &Used) -> &'a Patch {
    &scenes[used.scene].in_lidar[used.patch]
}
