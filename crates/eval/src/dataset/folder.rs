//! Where the files of a dataset lie.

use std::path::{Path, PathBuf};

use super::plan::Device;

/// Name of the folder that may be held back.
pub const TRUTH: &str = "truth";

/// A dataset's folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DatasetFolder(PathBuf);

impl DatasetFolder {
    /// The folder; nothing is looked at.
    pub fn new(path: &Path) -> Self {
        Self(path.to_owned())
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// `dataset.toml`.
    pub fn description(&self) -> PathBuf {
        self.0.join("dataset.toml")
    }

    /// The rig of a device.
    pub fn calibration(&self, rig: &str) -> PathBuf {
        self.0.join("calibration").join(format!("{rig}.toml"))
    }

    /// The rig of the device that recorded a walk.
    pub fn calibration_of(&self, device: Device) -> PathBuf {
        self.calibration(device.name())
    }

    /// The scan of an environment.
    pub fn scan(&self, environment: &str) -> PathBuf {
        self.0.join("map").join(environment).join("scan.mcap")
    }

    /// The recording of a walk.
    pub fn walk(&self, sequence: &str) -> PathBuf {
        self.0.join("query").join(sequence).join("walk.mcap")
    }

    /// The folder that may be held back.
    pub fn truth(&self) -> PathBuf {
        self.0.join(TRUTH)
    }

    /// The true trajectory of a scan.
    pub fn scan_truth(&self, environment: &str) -> PathBuf {
        self.truth().join("map").join(format!("{environment}.tum"))
    }

    /// The true trajectory of a walk.
    pub fn walk_truth(&self, sequence: &str) -> PathBuf {
        self.truth().join("query").join(format!("{sequence}.tum"))
    }
}
