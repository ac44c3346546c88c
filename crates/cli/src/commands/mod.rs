//! The subcommands: arguments, one library call, printing.

pub mod align;
pub mod bench;
pub mod calib;
mod calib_board;
mod calib_camera;
mod calib_camera_imu;
mod calib_exchange;
mod calib_imu_noise;
mod calib_input;
mod calib_joint;
mod calib_lidar_camera;
mod calib_refine;
mod calib_result;
mod calib_target;
mod calib_verify;
pub mod clock;
pub mod completions;
pub mod convert;
mod covariance_file;
pub mod dataset;
pub mod demo;
pub mod doctor;
pub mod doctor_host;
pub mod eval;
pub mod groundtruth;
pub mod groundtruth_page;
pub mod import;
mod inertial;
pub mod localize;
pub mod map;
mod map_control;
mod map_coverage;
mod map_depth;
mod map_distances;
mod map_folder;
mod map_keyframes;
mod map_posed;
mod map_prune;
mod map_report;
mod map_scans;
mod map_settings;
mod map_surface;
mod map_tools;
#[cfg(feature = "view")]
mod map_view;
pub mod mock;
pub mod models;
mod motion_file;
pub mod odometry;
mod odometry_input;
pub mod recover;
pub mod report;
pub mod scan;
pub mod sidecar;
mod sidecar_walks;
pub mod sim;
mod surroundings;
pub mod survey;
#[cfg(feature = "view")]
pub mod view;
pub mod vio;
mod walk_files;

use std::path::Path;

use anyhow::Context as _;
use lsfb_geometry::Rig;
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, Recording};
use serde::de::DeserializeOwned;

use crate::bad_argument::BadArgument;
use crate::files::{about, expect_file, name_of, write};

/// A seed, which is no negative number.
fn seed(text: &str) -> Result<u64, String> {
    text.parse()
        .map_err(|_| format!("expected a whole number from 0 to {}", u64::MAX))
}

/// A stage's settings: those of a TOML file, or the defaults where none is named.
fn config_or_default<C: DeserializeOwned + Default>(path: Option<&Path>) -> anyhow::Result<C> {
    path.map_or_else(|| Ok(C::default()), read_config)
}

/// A stage's settings from a TOML file; unknown names are refused by the settings themselves.
fn read_config<C: DeserializeOwned>(path: &Path) -> anyhow::Result<C> {
    parse_config(path, &read_config_text(path)?)
}

/// The text of a file of settings.
fn read_config_text(path: &Path) -> anyhow::Result<String> {
    expect_file(path, "omit the option to use the defaults")?;
    std::fs::read_to_string(path).with_context(|| path.display().to_string())
}

/// Settings from the text of the file at `path`.
fn parse_config<C: DeserializeOwned>(path: &Path, text: &str) -> anyhow::Result<C> {
    toml::from_str(text).map_err(|e| {
        anyhow::anyhow!(
            "{}: {}",
            path.display(),
            lsfb_geometry::toml_problem(text, &e)
        )
    })
}

/// The rig that was named, else the recording's own; the provenance names it.
fn rig_for(
    recording: &Recording,
    named: Option<&Path>,
    provenance: &mut Provenance,
) -> anyhow::Result<Rig> {
    let rig = match named {
        Some(path) => {
            provenance.add_input(path)?;
            Rig::read(path)?
        }
        None => recording.rig()?,
    };
    provenance.add_rig(&rig);
    Ok(rig)
}

/// The rig with the cameras that were named, or with all of its own.
fn with_cameras(mut rig: Rig, names: &[String]) -> anyhow::Result<Rig> {
    for name in names {
        let known = || rig.cameras.keys().cloned().collect::<Vec<_>>().join(", ");
        anyhow::ensure!(
            rig.cameras.contains_key(name),
            BadArgument::new(format!(
                "--camera {name}: rig {} has no such camera: it has {}",
                rig.name,
                known()
            ))
        );
    }
    if !names.is_empty() {
        rig.cameras.retain(|name, _| names.contains(name));
    }
    Ok(rig)
}

/// An HD map that is there.
fn open_map(folder: &Path) -> anyhow::Result<HdMap> {
    expect_file(folder, "build one with `lsfb map`")?;
    Ok(HdMap::open(folder)?)
}
