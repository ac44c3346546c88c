//! A folder of point clouds → Recording, for datasets that keep scans as files.

use std::path::{Path, PathBuf};

use lsfb_geometry::{MAIN_LIDAR, Rig, RigLidar, Se3};
use lsfb_recording::{Summary, Writer, WriterConfig, read_pcd};
use lsfb_types::{Progress, ProgressFn, Stamped, Timestamp};

use crate::Error;
use crate::recorder::make_folder;

/// What a folder of clouds does not say of itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudsConfig {
    /// Scans per second; the files carry no time.
    pub rate_hz: f64,
    /// Standard deviation of one range, metres.
    pub range_noise_m: f64,
}

impl Default for CloudsConfig {
    fn default() -> Self {
        Self {
            rate_hz: 10.0,
            range_noise_m: 0.02,
        }
    }
}

/// Records the PCD files of `folder`, in order of name, as scans of a rig that is its LiDAR. After an error `out` is gone.
pub fn import_clouds(
    folder: &Path,
    config: &CloudsConfig,
    out: &Path,
    progress: ProgressFn<'_>,
) -> Result<Summary, Error> {
    let files = cloud_files(folder)?;
    make_folder(out)?;
    let writer = Writer::create(out, &WriterConfig::default())?;
    let written = write_clouds(&files, config, writer, progress);
    if written.is_err() {
        // Half an import looks whole; what matters is the error above.
        let _ = std::fs::remove_file(out);
    }
    written
}

fn write_clouds(
    files: &[PathBuf],
    config: &CloudsConfig,
    mut writer: Writer,
    progress: ProgressFn<'_>,
) -> Result<Summary, Error> {
    writer.attach_rig(&Rig {
        lidars: RigLidar {
            rig_from_lidar: Se3::identity(),
            range_noise_m: config.range_noise_m,
        }
        .alone(),
        ..Rig::empty("clouds")
    })?;
    for (index, path) in files.iter().enumerate() {
        progress(Progress {
            stage: "reading clouds",
            done: index as u64,
            total: files.len() as u64,
        })?;
        let time = Timestamp::from_secs_f64(index as f64 / config.rate_hz);
        let scan = Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: read_pcd(path)?,
        };
        writer.write_scan(MAIN_LIDAR, &scan)?;
    }
    Ok(writer.finish()?)
}

fn cloud_files(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let io = |cause| Error::Io {
        path: folder.to_owned(),
        cause,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("pcd"))
        {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(Error::Cloud {
            path: folder.to_owned(),
            message: "no .pcd file in this folder".to_owned(),
        });
    }
    Ok(files)
}
