//! Whether the walk fits the map as well somewhere else: a place that looks alike in all that it saw.

use lsfb_geometry::Rig;
use serde::{Deserialize, Serialize};

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::walk::Walk;
use crate::frames::FeatureFrame;
use crate::localization::{Localizer, PlacedFrame, find_elsewhere};

/// Instants of a walk that are looked for elsewhere, evenly taken among those that see enough of the map.
const INSTANTS: usize = 24;

/// The next best place of a walk.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OtherPlace {
    /// How far from where the walk is said to be, at its middle, metres.
    pub away_m: f64,
    /// How far it would be turned, degrees.
    pub turn_deg: f64,
    /// Points of the map that some of its instants show where they are said to be.
    pub matches_here: u64,
    /// The same if all of them were there.
    pub matches_there: u64,
}

impl OtherPlace {
    /// How many times as much is found where the walk is said to be.
    pub fn margin(&self) -> f64 {
        self.matches_here as f64 / self.matches_there.max(1) as f64
    }
}

/// Looks for it; `None` where the walk is found nowhere else. `frames` are those of the walk, with their features.
pub(super) fn other_place(
    localizer: &Localizer,
    rig: &Rig,
    frames: &[FeatureFrame],
    walk: &Walk,
    estimate: &Estimate,
    config: &GroundTruthConfig,
) -> Option<OtherPlace> {
    let placed: Vec<PlacedFrame> = (0..walk.frames.len())
        .filter(|k| walk.frames[*k].fixed.len() >= config.min_map_points)
        .map(|k| PlacedFrame {
            features: &frames[k].features,
            world_from_rig: *estimate.pose(k),
        })
        .collect();
    let step = placed.len().div_ceil(INSTANTS).max(1);
    let chosen: Vec<PlacedFrame> = placed.into_iter().step_by(step).collect();
    let middle = chosen.get(chosen.len() / 2)?.world_from_rig;
    let found = find_elsewhere(localizer, rig, &chosen)?;
    let off = middle.inverse() * (found.there_from_here * middle);
    Some(OtherPlace {
        away_m: off.translation.norm(),
        turn_deg: off.rotation.angle().to_degrees(),
        matches_here: found.matches_here as u64,
        matches_there: found.matches_there as u64,
    })
}
