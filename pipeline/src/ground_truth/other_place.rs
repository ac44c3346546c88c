//! Whether the walk fits the map as well somewhere else: a place that looks alike in all that it saw.

use lsfb_geometry::Rig;
use serde::{Deserialize, Serialize};

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::in_view::{InView, Search};
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
    /// Share of what points that should be in view if all of the walk were there say that is that they are not there.
    pub absent_share_there: f64,
    /// Whether so much would be absent there that it is not this place.
    pub is_excluded: bool,
    /// Whether enough should be in view there to tell, and is.
    pub is_seen: bool,
}

impl OtherPlace {
    /// How many times as much is found where the walk is said to be.
    pub fn margin(&self) -> f64 {
        self.matches_here as f64 / self.matches_there.max(1) as f64
    }

    /// Whether the walk may be there as well, if so many times as much must be found here.
    pub fn is_possible(&self, margin: f64) -> bool {
        !self.is_excluded && self.margin() < margin
    }
}

/// A solved walk with the features of its frames.
pub(super) struct Placed<'a> {
    pub rig: &'a Rig,
    pub walk: &'a Walk,
    pub estimate: &'a Estimate,
    pub frames: &'a [FeatureFrame],
    pub search: &'a Search<'a>,
    /// What should be in view where the walk is said to be.
    pub here: &'a InView,
}

impl Placed<'_> {
    /// The next best place, and the walk there; `None` where it is found nowhere else.
    pub fn other_place(
        &self,
        localizer: &Localizer,
        config: &GroundTruthConfig,
    ) -> Option<(OtherPlace, Estimate)> {
        let (walk, estimate) = (self.walk, self.estimate);
        let placed: Vec<usize> = (0..walk.frames.len())
            .filter(|k| walk.frames[*k].fixed.len() >= config.min_map_points)
            .collect();
        let step = placed.len().div_ceil(INSTANTS).max(1);
        let chosen: Vec<usize> = placed.into_iter().step_by(step).collect();
        let instants = chosen.iter().map(|k| PlacedFrame {
            features: &self.frames[*k].features,
            world_from_rig: *estimate.pose(*k),
        });
        let instants: Vec<PlacedFrame> = instants.collect();
        let middle = instants.get(instants.len() / 2)?.world_from_rig;
        let found = find_elsewhere(localizer, self.rig, &instants);
        let places = found.into_iter().map(|elsewhere| {
            // A frame moves as the instant that is nearest to it.
            let moved = estimate.clone().moved(|frame| {
                let after = chosen.partition_point(|k| *k < frame);
                let nearest = [after.saturating_sub(1), after.min(chosen.len() - 1)]
                    .into_iter()
                    .min_by_key(|n| chosen[*n].abs_diff(frame));
                let n = nearest.unwrap_or(0);
                elsewhere.poses[n] * instants[n].world_from_rig.inverse()
            });
            let there = InView::of_walk(&self.search.judge(&moved));
            let off = middle.inverse() * (elsewhere.there_from_here * middle);
            let place = OtherPlace {
                away_m: off.translation.norm(),
                turn_deg: off.rotation.angle().to_degrees(),
                matches_here: elsewhere.matches_here as u64,
                matches_there: elsewhere.matches_there as u64,
                absent_share_there: there.absent_share(),
                is_excluded: is_excluded(&there, self.here, config),
                is_seen: there.is_judged() && !there.is_doubtful(config),
            };
            (place, moved)
        });
        // The first of equals is that with most matches.
        places
            .rev()
            .max_by_key(|(place, _)| (!place.is_excluded, place.matches_there))
    }
}

/// How many times as much must be absent at another place as where the walk is said to be.
const CLEARLY: f64 = 2.0;

/// Whether what should be in view at another place speaks against it. Where little is certain to be in view here, and most of what should be is
/// there, a place that has changed since it was mapped is none the less the likelier one.
fn is_excluded(there: &InView, here: &InView, config: &GroundTruthConfig) -> bool {
    there.is_doubtful(config)
        && there.absent_share() > CLEARLY * here.absent_share()
        && here.is_likelier_than(there)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn in_view(there: f64, absent: f64) -> InView {
        InView {
            frames: 0..1,
            points: 100,
            there,
            absent,
            ..InView::default()
        }
    }

    #[test]
    fn another_place_is_excluded_by_what_is_not_there() {
        let config = GroundTruthConfig::default();
        let excluded = |there, here| is_excluded(&there, &here, &config);
        assert!(excluded(in_view(20.0, 80.0), in_view(200.0, 0.0)));
        assert!(
            excluded(in_view(20.0, 80.0), in_view(3.0, 0.0)),
            "little is in view here"
        );
        assert!(
            !excluded(in_view(200.0, 0.0), in_view(200.0, 0.0)),
            "both are alike"
        );
        assert!(
            !excluded(in_view(0.0, 0.0), in_view(200.0, 0.0)),
            "nothing is in view there"
        );
        // A third of what was there has been moved since, and here hardly anything should be in view.
        assert!(!excluded(in_view(80.0, 40.0), in_view(6.0, 0.0)));
        assert!(
            !excluded(in_view(80.0, 20.0), in_view(80.0, 15.0)),
            "both have changed"
        );
    }
}
