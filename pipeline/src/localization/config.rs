use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

use super::ransac::RansacConfig;
use crate::features::matching::MatchConfig;

/// Configuration of [`Localizer`](super::Localizer).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LocalizerConfig {
    /// Map descriptors looked up for each feature.
    pub nearest: usize,
    /// Inverted lists of the index searched for each feature.
    pub probes: usize,
    /// Map descriptors that are compared with each feature to find the nearest, chosen by their codes in the index.
    pub compared: usize,
    /// Largest descriptor distance of a candidate, in units of the descriptor's norm.
    pub max_distance: f32,
    /// A candidate may be this much farther than the nearest one.
    pub max_candidate_ratio: f32,
    /// Places with fewer votes are dropped.
    pub min_votes: u32,
    /// Places tried, most votes first.
    pub max_places: usize,
    /// Places tried while none of them gives a pose that chance surely does not.
    pub max_places_in_doubt: usize,
    /// Map images taken together as one place: those that share most points.
    pub place_images: usize,
    /// The pose search.
    pub ransac: RansacConfig,
    /// Radius around a projected point in which its feature is looked for, pixels.
    pub projection_radius_px: f64,
    /// Matching of projected points.
    pub projection_matching: MatchConfig,
    /// Least probability with which a pose that counts as found is right: see [`Evidence`](super::Evidence).
    pub min_probability: f64,
}

impl Default for LocalizerConfig {
    fn default() -> Self {
        Self {
            nearest: 25,
            // Of the 25 nearest of real images 95 % are found so (`docs/descriptor-index.md`).
            probes: 32,
            compared: 150,
            max_distance: 0.75,
            max_candidate_ratio: 1.15,
            min_votes: 6,
            max_places: 3,
            max_places_in_doubt: 10,
            place_images: 12,
            ransac: RansacConfig::default(),
            projection_radius_px: 10.0,
            projection_matching: MatchConfig {
                max_ratio: 0.9,
                max_distance: 0.75,
            },
            min_probability: 0.99,
        }
    }
}

lsfb_types::bounds! {
    LocalizerConfig {
        nearest: number(Bounds::AT_LEAST_ONE),
        probes: number(Bounds::AT_LEAST_ONE),
        compared: number(Bounds::AT_LEAST_ONE),
        max_distance: number(Bounds::NOT_NEGATIVE),
        max_candidate_ratio: number(Bounds::NOT_NEGATIVE),
        min_votes: any,
        max_places: any,
        max_places_in_doubt: any,
        place_images: any,
        ransac: section,
        projection_radius_px: number(Bounds::POSITIVE),
        projection_matching: section,
        min_probability: number(Bounds::Within(0.0, 1.0)),
    }
}
