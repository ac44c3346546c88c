use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

use crate::features::matching::MatchConfig;
use crate::features::triangulation::TriangulationConfig;

/// Which images are matched, how, and what becomes a point. No length is fixed: baselines are shares of the depth of the scene,
/// which the images themselves tell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReconstructionConfig {
    /// Images with which each image is matched.
    pub neighbours: usize,
    /// Distance of two cameras that is best for matching, as a share of the depth of the scene.
    pub best_baseline_per_depth: f64,
    /// Cameras nearer than this are not matched, as a share of the depth of the scene.
    pub min_baseline_per_depth: f64,
    /// Cameras farther apart are not matched, as a share of the depth of the scene.
    pub max_baseline_per_depth: f64,
    /// Cameras whose axes differ by more are not matched, degrees.
    pub max_axis_angle_deg: f64,
    /// Largest distance of a match from its epipolar plane, pixels at the image's centre.
    pub max_epipolar_px: f64,
    /// Descriptor matching.
    pub matching: MatchConfig,
    /// Triangulation.
    pub triangulation: TriangulationConfig,
}

impl Default for ReconstructionConfig {
    fn default() -> Self {
        Self {
            neighbours: 10,
            best_baseline_per_depth: 0.13,
            min_baseline_per_depth: 0.013,
            max_baseline_per_depth: 0.8,
            max_axis_angle_deg: 50.0,
            max_epipolar_px: 2.0,
            matching: MatchConfig::default(),
            triangulation: TriangulationConfig {
                // The unit of the poses may be anything.
                min_depth_m: 0.0,
                ..TriangulationConfig::default()
            },
        }
    }
}

lsfb_types::bounds! {
    ReconstructionConfig {
        neighbours: any,
        best_baseline_per_depth: number(Bounds::POSITIVE),
        min_baseline_per_depth: number(Bounds::NOT_NEGATIVE),
        max_baseline_per_depth: number(Bounds::POSITIVE),
        max_axis_angle_deg: number(Bounds::NOT_NEGATIVE),
        max_epipolar_px: number(Bounds::POSITIVE),
        matching: section,
        triangulation: section,
    }
}
