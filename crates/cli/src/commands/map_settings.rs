//! Settings of `lsfb map` and `lsfb localize`: one file holds those of both.
//!
//! A file with one of the tables `[mapping]`, `[posed_map]` and `[localization]` has nothing beside these, and both commands take it, each its own
//! table; names in the tables of the other are checked too. Any other file holds the settings of one command alone, without a table around them.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_pipeline::hd_map::PosedMapConfig;
use lsfb_pipeline::localization::LocalizerConfig;
use lsfb_pipeline::mapping::MappingConfig;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Names of the tables.
const MAPPING: &str = "mapping";
const POSED_MAP: &str = "posed_map";
const LOCALIZATION: &str = "localization";

/// A file for both commands; tables that are left out are the defaults.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Settings {
    mapping: MappingConfig,
    posed_map: PosedMapConfig,
    localization: LocalizerConfig,
}

/// Settings of a map of a recording.
pub fn mapping(path: Option<&Path>) -> anyhow::Result<MappingConfig> {
    read(path, |settings| settings.mapping)
}

/// Settings of a map of posed images.
pub fn posed_map(path: Option<&Path>) -> anyhow::Result<PosedMapConfig> {
    read(path, |settings| settings.posed_map)
}

/// Settings of localization.
pub fn localization(path: Option<&Path>) -> anyhow::Result<LocalizerConfig> {
    read(path, |settings| settings.localization)
}

fn read<C: DeserializeOwned + Default>(
    path: Option<&Path>,
    own: fn(Settings) -> C,
) -> anyhow::Result<C> {
    let Some(path) = path else {
        return Ok(C::default());
    };
    let text = super::read_config_text(path)?;
    // What is no TOML is told below.
    let tables: toml::Table = toml::from_str(&text).unwrap_or_default();
    let is_shared = [MAPPING, POSED_MAP, LOCALIZATION]
        .iter()
        .any(|name| tables.contains_key(*name));
    match is_shared {
        true => super::parse_config(path, &text).map(own),
        false => super::parse_config(path, &text),
    }
}

/// All settings of `lsfb map` with their defaults.
pub fn help_of_map() -> String {
    let of_recording = table::<MappingConfig>(MAPPING);
    let of_images = table::<PosedMapConfig>(POSED_MAP);
    format!(
        "{FILES}\n\nSettings of --config and their defaults, for a recording:\n\n{of_recording}\n\
         Settings of --config and their defaults, with --posed-images:\n\n{of_images}"
    )
}

/// All settings of `lsfb localize` with their defaults.
pub fn help_of_localize() -> String {
    let settings = table::<LocalizerConfig>(LOCALIZATION);
    format!("{FILES}\n\nSettings of --config and their defaults:\n\n{settings}")
}

const FILES: &str = "\
One file of --config may hold the settings of `lsfb map` and `lsfb localize` in the tables [mapping],
[posed_map] and [localization]. Settings of one of these alone may also stand without their table around
them.";

fn table<C: Serialize + Default>(name: &str) -> String {
    toml::to_string(&BTreeMap::from([(name, C::default())])).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_file_holds_the_settings_of_both_commands() {
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("settings.toml");
        let holding = |text: &str| {
            std::fs::write(&file, text).expect("a file");
            Some(file.as_path())
        };
        let both = holding(
            "[mapping]\nclose_loops = true\n[mapping.map.index]\nseed = 7\n\
             [localization]\nmin_probability = 0.9\n",
        );
        let of_map = mapping(both).expect("settings");
        assert!(of_map.close_loops && of_map.map.index.seed == 7);
        let of_images = posed_map(both).expect("settings");
        assert_eq!(of_images, PosedMapConfig::default());
        let localizer = localization(both).expect("settings");
        assert!((localizer.min_probability - 0.9).abs() < 1e-12);

        // As they were before: of one command, without a table around them.
        let alone = holding("close_loops = true\n[map.index]\nseed = 7\n");
        assert_eq!(mapping(alone).expect("settings"), of_map);
        assert!(localization(alone).is_err());
        assert_eq!(mapping(None).expect("none"), MappingConfig::default());

        // A name that nobody knows is refused by both, in whichever table it is, and settings of one beside the tables.
        for (text, words) in [
            (
                "[mapping]\n[localization]\nmin_probabilty = 0.9\n",
                ["line 3", "min_probabilty"],
            ),
            (
                "close_loops = true\n[localization]\n",
                ["close_loops", "`mapping`"],
            ),
            ("[mapping]\n[odometry]\n", ["odometry", "`localization`"]),
        ] {
            let path = holding(text);
            for refused in [
                mapping(path).err().map(|e| e.to_string()),
                localization(path).err().map(|e| e.to_string()),
            ] {
                let refused = refused.unwrap_or_default();
                assert!(words.iter().all(|w| refused.contains(w)), "{refused}");
            }
        }
    }
}
