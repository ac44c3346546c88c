//! What can be set about light.

use std::path::PathBuf;

use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

/// The light of a place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightConfig {
    /// Whether light is traced from true lamps, sky and sun, by way of all surfaces, and glossy surfaces reflect. Without, every point has the light
    /// of the lamps around it and an even light from everywhere.
    pub baked: bool,
    /// Distance between the points of a surface at which light is computed, metres; 0 takes 5 to 10 cm by the size of the place.
    pub spacing_m: f64,
    /// Paths that are followed from each of these points.
    pub paths: u32,
    /// Folder in which computed light is kept, so that the next simulation of the same place need not compute it; empty keeps none.
    /// It changes no result, and is not written with the settings.
    #[serde(skip_serializing)]
    pub cache: PathBuf,
}

impl LightConfig {
    /// Whether nothing of this is used, and it need not be written.
    pub(super) fn is_off(&self) -> bool {
        !self.baked
    }
}

impl Default for LightConfig {
    fn default() -> Self {
        Self {
            baked: false,
            spacing_m: 0.0,
            paths: 128,
            cache: PathBuf::new(),
        }
    }
}

lsfb_types::bounds! {
    LightConfig {
        baked: any,
        spacing_m: number(Bounds::ZeroOr(0.02, 1.0)),
        paths: number(Bounds::Within(8.0, 65536.0)),
        cache: any,
    }
}
