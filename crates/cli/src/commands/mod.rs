//! The subcommands: arguments, one library call, printing.

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
pub mod demo;
pub mod doctor;
pub mod doctor_host;
pub mod eval;
pub mod groundtruth;
pub mod localize;
pub mod map;
pub mod mock;
pub mod odometry;
pub mod recover;
pub mod scan;
pub mod sim;
#[cfg(feature = "view")]
pub mod view;

use std::path::Path;

use anyhow::Context as _;
use lsfb_geometry::Rig;
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, Recording};
use serde::de::DeserializeOwned;

/// A stage's settings: those of a TOML file, or the defaults where none is named.
fn config_or_default<C: DeserializeOwned + Default>(path: Option<&Path>) -> anyhow::Result<C> {
    path.map_or_else(|| Ok(C::default()), read_config)
}

/// A stage's settings from a TOML file; unknown names are refused by the settings themselves.
fn read_config<C: DeserializeOwned>(path: &Path) -> anyhow::Result<C> {
    expect_file(path, "leave the option out to take the defaults")?;
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    toml::from_str(&text).map_err(|e| {
        anyhow::anyhow!(
            "{}: {}",
            path.display(),
            lsfb_geometry::toml_problem(&text, &e)
        )
    })
}

/// Writes a file; an error names it.
pub fn write(path: &Path, contents: impl AsRef<[u8]>) -> anyhow::Result<()> {
    std::fs::write(path, contents).with_context(|| path.display().to_string())
}

/// Fails early, and with what to do, where nothing is at `path`.
pub fn expect_file(path: &Path, remedy: &str) -> anyhow::Result<()> {
    anyhow::ensure!(
        path.exists(),
        "{}: there is no such file or folder: check the path, or {remedy}",
        path.display()
    );
    Ok(())
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

/// An HD map that is there.
fn open_map(folder: &Path) -> anyhow::Result<HdMap> {
    expect_file(folder, "build one with `lsfb map`")?;
    Ok(HdMap::open(folder)?)
}

/// Fails before the work is done where its result could not be written: makes the folder around it and a trial file in it.
fn expect_writable(result: &Path) -> anyhow::Result<()> {
    let folder = match result.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let trial = folder.join(format!(".lsfb-{}", std::process::id()));
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&trial, b""))
        .and_then(|()| std::fs::remove_file(&trial))
        .with_context(|| {
            let result = result.display();
            format!("{result}: cannot be written here: name another place, or change the folder's rights")
        })
}

/// The name of a file without its folder, for pages beside it.
fn name_of(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
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
