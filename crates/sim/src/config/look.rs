//! How surfaces are painted.

use serde::{Deserialize, Serialize};

/// How surfaces are painted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Look {
    /// Speckles and shapes of all sizes on everything: more texture than real surfaces have, letters that say nothing.
    #[default]
    Plain,
    /// Each material in its own way: grain, weave, pores, scratches; signs, books, screens and papers with words; a view out of the
    /// windows that lies far away. The demo's place and scenes of the user's have no such look.
    Detailed,
}

impl Look {
    /// Whether it need not be written with the settings.
    pub(crate) fn is_plain(&self) -> bool {
        *self == Self::Plain
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Device, Place, SimConfig};

    #[test]
    fn the_look_is_refused_where_it_would_be_left_aside() {
        let with = |place: Place| SimConfig {
            look: Look::Detailed,
            ..SimConfig::for_place(place, Device::Glasses)
        };
        assert!(with(Place::Stairs).check().is_ok() && with(Place::Demo).check().is_ok());
        let error = with(Place::Imported)
            .check()
            .expect_err("it has a look of its own");
        assert!(error.to_string().contains("look"), "{error}");
        let written = serde_json::to_string(&SimConfig::default()).expect("written");
        assert!(!written.contains("look"), "settings of old recordings stay");
    }
}
