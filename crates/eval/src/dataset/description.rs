//! `dataset.toml`: what a dataset holds.

use std::path::Path;

use lsfb_types::{Bounds, Names, OutOfBounds};
use serde::{Deserialize, Serialize};

use super::folder::DatasetFolder;
use super::plan::{Device, Environment, Gait, Gaze};
use crate::Error;

/// Larger files describe no dataset.
const MAX_BYTES: u64 = 4 << 20;
/// What this program writes.
const FORMAT: u32 = 1;

/// What a dataset holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// Version of this file's format.
    pub format: u32,
    /// Title of the dataset.
    pub title: String,
    /// Images per second.
    pub rate_hz: f64,
    /// Share of the planned durations that was recorded, percent.
    pub scale_percent: f64,
    /// SHA-256 of `truth/SHA256SUMS`: a truth that is held back can be shown to be the one that was there from the beginning.
    pub truth_sums_sha256: String,
    /// Where it was recorded.
    #[serde(rename = "environment", default)]
    pub environments: Vec<Environment>,
    /// Scans, for maps.
    #[serde(rename = "map", default)]
    pub maps: Vec<MapEntry>,
    /// Walks, to be localized.
    #[serde(rename = "query", default)]
    pub queries: Vec<QueryEntry>,
}

/// A scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapEntry {
    /// The environment, which gives it its name.
    pub environment: String,
}

/// A walk, as it was planned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QueryEntry {
    /// `C3-android`.
    pub name: String,
    /// Name of the motion, `C3`.
    pub motion: String,
    /// Name of its environment.
    pub environment: String,
    /// What it was recorded with.
    pub device: Device,
    /// How one moved.
    pub gait: Gait,
    /// Where one looked.
    pub gaze: Gaze,
    /// Images of a camera.
    pub frames: u32,
    /// Length of the path, metres.
    pub length_m: f64,
    /// What it shows.
    pub description: String,
}

lsfb_types::bounds! {
    Description {
        format: any,
        title: any,
        rate_hz: number(Bounds::POSITIVE),
        scale_percent: any,
        truth_sums_sha256: any,
        environments as "environment": any,
        maps as "map": any,
        queries as "query": any,
    }
    also is_named
}

/// Names become folders.
const NAMES: Names = Names {
    holds: |c| c.is_ascii_alphanumeric() || "-_.+".contains(c),
    letters: "letters, digits, - _ . and +",
};

impl Description {
    /// One that holds nothing yet.
    pub fn new(title: &str, rate_hz: f64, scale_percent: f64) -> Self {
        Self {
            format: FORMAT,
            title: title.to_owned(),
            rate_hz,
            scale_percent,
            truth_sums_sha256: String::new(),
            environments: Vec::new(),
            maps: Vec::new(),
            queries: Vec::new(),
        }
    }

    /// Reads the description of a dataset; its names are safe to be used in paths.
    pub fn read(folder: &DatasetFolder) -> Result<Self, Error> {
        let path = folder.description();
        let io = |source| Error::Io {
            path: path.clone(),
            source,
        };
        let bad = |what: String| Error::BadDataset {
            path: path.clone(),
            what,
        };
        if std::fs::metadata(&path).map_err(io)?.len() > MAX_BYTES {
            return Err(bad("too large for a dataset description".to_owned()));
        }
        let text = std::fs::read_to_string(&path).map_err(io)?;
        let description: Self =
            toml::from_str(&text).map_err(|e| bad(lsfb_geometry::toml_problem(&text, &e)))?;
        description.check().map_err(bad)?;
        Ok(description)
    }

    /// The file's text.
    pub fn to_toml(&self, path: &Path) -> Result<String, Error> {
        toml::to_string(self).map_err(|e| Error::BadDataset {
            path: path.to_owned(),
            what: e.to_string(),
        })
    }

    /// The environment of a name.
    pub fn environment(&self, name: &str) -> Option<&Environment> {
        self.environments.iter().find(|e| e.name == name)
    }

    /// The walk of a name.
    pub fn query(&self, name: &str) -> Option<&QueryEntry> {
        self.queries.iter().find(|q| q.name == name)
    }

    fn check(&self) -> Result<(), String> {
        if self.format != FORMAT {
            return Err(format!(
                "format {} is not supported, only {FORMAT}",
                self.format
            ));
        }
        self.check_bounds("").map_err(|e| e.to_string())
    }

    /// Names are there once, and those of environments are names of one.
    fn is_named(&self, _section: &str) -> Result<(), OutOfBounds> {
        let environments = self.environments.iter().map(|e| e.name.as_str());
        NAMES.check(environments.map(|name| ("environment.name", name)))?;
        NAMES.check(self.queries.iter().map(|q| ("query.name", &*q.name)))?;
        NAMES.check(
            self.maps
                .iter()
                .map(|m| ("map.environment", &*m.environment)),
        )?;
        let of_queries = self.queries.iter();
        let of_queries = of_queries.map(|q| ("query", &q.environment));
        let of_maps = self.maps.iter().map(|m| ("map", &m.environment));
        for (section, name) in of_queries.chain(of_maps) {
            if self.environment(name).is_none() {
                let bounds = "the name of an [[environment]]";
                return Err(OutOfBounds::new(section, "environment", name, &bounds));
            }
        }
        Ok(())
    }
}
