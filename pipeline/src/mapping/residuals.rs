//! What is left of the residuals of Eq. (4), as a report has it.

use serde::{Deserialize, Serialize};

use crate::hd_map::PixelResiduals;

/// How far LiDAR features lie from what they correspond to in other keyframes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LidarResiduals {
    /// Plane correspondences.
    pub plane_matches: u64,
    /// Root mean square distance from planes, metres.
    pub plane_rms_m: f64,
    /// Edge correspondences.
    pub edge_matches: u64,
    /// Root mean square distance from edges, metres.
    pub edge_rms_m: f64,
}

/// Residuals of the keyframes of one region: those whose start lies in one cube of 5 m.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RegionResiduals {
    /// Mean place of its keyframes, metres, in the world of the map.
    pub center_m: [f64; 3],
    /// Its keyframes.
    pub keyframes: u64,
    /// Observations of map points of that keyframe that has fewest.
    pub fewest_observations: u64,
    /// Median of them.
    pub median_observations: f64,
    /// Of its images with the poses of the start.
    pub before: PixelResiduals,
    /// With those of the map.
    pub after: PixelResiduals,
    /// Of its scans against others, with the poses of the start.
    pub lidar_before: LidarResiduals,
    /// With those of the map.
    pub lidar_after: LidarResiduals,
}
