//! The surveyed frame in which a map stands.

use serde::{Deserialize, Serialize};

/// The surveyed frame that a map's world is, but for a shift, and the marks that say so.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SiteFrame {
    /// What is to be added to coordinates of the map to have those of the survey, metres: zero, but where these are so large (as those of a national grid) that programs
    /// that read maps with single precision would lose the centimetres.
    pub origin_m: [f64; 3],
    /// The control points that hold the map.
    pub control_points: Vec<String>,
}
