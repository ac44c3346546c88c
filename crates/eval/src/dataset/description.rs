//! `dataset.toml`: what a dataset holds.

use std::collections::BTreeSet;
use std::path::Path;

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
        if !(self.rate_hz > 0.0 && self.rate_hz.is_finite()) {
            return Err(format!("rate_hz = {} must be above zero", self.rate_hz));
        }
        let environments = self.environments.iter().map(|e| e.name.as_str());
        named_once("environment", environments)?;
        named_once("query", self.queries.iter().map(|q| q.name.as_str()))?;
        named_once("map", self.maps.iter().map(|m| m.environment.as_str()))?;
        let of_queries = self.queries.iter().map(|q| &q.environment);
        for name in of_queries.chain(self.maps.iter().map(|m| &m.environment)) {
            if self.environment(name).is_none() {
                return Err(format!("no [[environment]] is called '{name}'"));
            }
        }
        Ok(())
    }
}

/// Names become folders: each is plain, and there once.
fn named_once<'a>(kind: &str, names: impl Iterator<Item = &'a str>) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    for name in names {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.+".contains(c);
        if name.is_empty() || name.starts_with('.') || !name.chars().all(is_plain) {
            return Err(format!(
                "{kind} '{name}' is not a valid name: use letters, digits, - _ . and +"
            ));
        }
        if !seen.insert(name) {
            return Err(format!("{kind} '{name}' occurs twice"));
        }
    }
    Ok(())
}
