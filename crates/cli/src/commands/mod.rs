//! The subcommands: arguments, one library call, printing.

pub mod demo;
pub mod eval;
pub mod groundtruth;
pub mod localize;
pub mod map;
pub mod mock;
pub mod odometry;
pub mod scan;
pub mod sim;
#[cfg(feature = "view")]
pub mod view;

use std::path::Path;

use anyhow::Context as _;
use serde::de::DeserializeOwned;

/// A stage's settings from a TOML file; unknown names are refused by the settings themselves.
fn read_config<C: DeserializeOwned>(path: &Path) -> anyhow::Result<C> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    toml::from_str(&text).map_err(|e| {
        anyhow::anyhow!(
            "{}: {}",
            path.display(),
            lsfb_geometry::toml_problem(&text, &e)
        )
    })
}

/// Names the file in an error that does not.
fn about<T, E: Into<anyhow::Error>>(path: &Path, result: Result<T, E>) -> anyhow::Result<T> {
    result.map_err(|error| {
        let error: anyhow::Error = error.into();
        let name = path.display().to_string();
        if error.to_string().contains(&name) {
            error
        } else {
            error.context(name)
        }
    })
}
