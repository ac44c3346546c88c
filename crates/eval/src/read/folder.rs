//! The trajectory in a folder of another program.

use std::path::{Path, PathBuf};

use crate::Error;

/// Where folders have one: kapture's, a model of COLMAP's, EuRoC's and TUM-VI's.
const PLACES: [&str; 8] = [
    "sensors/trajectories.txt",
    "trajectories.txt",
    "images.bin",
    "images.txt",
    "mav0/state_groundtruth_estimate0/data.csv",
    "state_groundtruth_estimate0/data.csv",
    "mav0/mocap0/data.csv",
    "mocap0/data.csv",
];

/// `None` of what is no folder.
pub(super) fn trajectory_in(path: &Path) -> Result<Option<PathBuf>, Error> {
    if !path.is_dir() {
        return Ok(None);
    }
    let mut places = PLACES.iter().map(|place| path.join(place));
    let found = places.find(|file| file.is_file());
    found.map(Some).ok_or_else(|| Error::NotATrajectory {
        path: path.to_owned(),
        what: format!(
            "no supported trajectory in this folder ({}): name the file",
            PLACES.join(", ")
        ),
    })
}
