//! A folder of point clouds → Recording, for datasets that keep scans as files.

use std::path::{Path, PathBuf};

use lsfb_geometry::{MAIN_LIDAR, Rig, RigLidar, Se3};
use lsfb_recording::{PointTimes, Summary, Writer, WriterConfig, read_pcd, sort_naturally};
use lsfb_types::{Progress, ProgressFn, Stamped, Timestamp};

use crate::Error;
use crate::recorder::make_folder;

/// What a folder of clouds does not say of itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudsConfig {
    /// Scans per second, where the files carry no time since an epoch.
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

/// What was read of a folder of clouds.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedClouds {
    /// The recording.
    pub summary: Summary,
    /// Files read.
    pub clouds: u64,
    /// Files whose points carry times that could be used.
    pub timed: u64,
    /// The field of times, as the first file that has one calls it.
    pub time_field: Option<String>,
}

/// Records the PCD files of `folder`, in order of name with numbers by value, as scans of a rig that is its LiDAR. Their points keep
/// the times of whatever field holds them. After an error `out` is gone.
pub fn import_clouds(
    folder: &Path,
    config: &CloudsConfig,
    out: &Path,
    progress: ProgressFn<'_>,
) -> Result<ImportedClouds, Error> {
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
) -> Result<ImportedClouds, Error> {
    writer.attach_rig(&Rig {
        lidars: RigLidar {
            rig_from_lidar: Se3::identity(),
            range_noise_m: config.range_noise_m,
        }
        .alone(),
        ..Rig::empty("clouds")
    })?;
    let mut found = Noted::default();
    let mut last: Option<Timestamp> = None;
    for (index, path) in files.iter().enumerate() {
        progress(Progress {
            stage: "reading clouds",
            done: index as u64,
            total: files.len() as u64,
        })?;
        let cloud = read_pcd(path)?;
        let by_rate = Timestamp::from_secs_f64(index as f64 / config.rate_hz);
        let time = found.note(&cloud.times).unwrap_or(by_rate);
        if last.is_some_and(|last| time <= last) {
            return Err(Error::Cloud {
                path: path.clone(),
                message: "its points are not later than those of the file before it: names are not in order of time, or some files carry times since an epoch and some do not".to_owned(),
            });
        }
        last = Some(time);
        let scan = Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: cloud.scan,
        };
        writer.write_scan(MAIN_LIDAR, &scan)?;
    }
    Ok(ImportedClouds {
        summary: writer.finish()?,
        clouds: found.clouds,
        timed: found.timed,
        time_field: found.time_field,
    })
}

/// What was found of times so far.
#[derive(Default)]
struct Noted {
    clouds: u64,
    timed: u64,
    time_field: Option<String>,
}

impl Noted {
    /// When the cloud's first point was measured, where its file says so.
    fn note(&mut self, times: &PointTimes) -> Option<Timestamp> {
        self.clouds += 1;
        let (name, first) = match times {
            PointTimes::Absent => return None,
            PointTimes::Unusable { name } => (name, None),
            PointTimes::Field { name, first } => {
                self.timed += 1;
                (name, *first)
            }
        };
        self.time_field.get_or_insert_with(|| name.clone());
        first
    }
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
    sort_naturally(&mut files);
    if files.is_empty() {
        return Err(Error::Cloud {
            path: folder.to_owned(),
            message: "no .pcd file in this folder".to_owned(),
        });
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_recording::Recording;
    use lsfb_types::no_progress;

    /// Records clouds of one point at x = number, with a time field of the given values.
    fn imported(names: &[(&str, u32, [&str; 2])]) -> Result<(ImportedClouds, Vec<f32>), Error> {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, x, [from, to]) in names {
            let text = format!(
                "VERSION 0.7\nFIELDS x y z time\nSIZE 4 4 4 8\nTYPE F F F F\nPOINTS 2\nDATA ascii\n\
                 {x} 1 2 {from}\n{x} 2 2 {to}\n"
            );
            std::fs::write(folder.path().join(name), text).expect("a cloud");
        }
        let out = folder.path().join("scans.mcap");
        let config = CloudsConfig::default();
        let found = import_clouds(folder.path(), &config, &out, &no_progress)?;
        let recording = Recording::open(&out).expect("a recording");
        let scans = recording.scans().expect("scans");
        let first = scans.map(|s| s.expect("a scan").sample.points[0].position_m[0]);
        Ok((found, first.collect()))
    }

    #[test]
    fn files_are_read_in_the_order_of_their_numbers() {
        let times = ["0", "0.1"];
        let names = [
            ("10.pcd", 10, times),
            ("2.pcd", 2, times),
            ("0.pcd", 0, times),
            ("1.pcd", 1, times),
        ];
        let (found, order) = imported(&names).expect("imported");
        assert_eq!(order, [0.0, 1.0, 2.0, 10.0]);
        assert_eq!((found.clouds, found.timed), (4, 4));
        assert_eq!(found.time_field.as_deref(), Some("time"));
    }

    #[test]
    fn times_that_are_none_are_counted_and_times_that_go_back_refused() {
        let (found, _) = imported(&[("0.pcd", 0, ["7", "7"])]).expect("imported");
        assert_eq!(
            (found.timed, found.time_field.as_deref()),
            (0, Some("time"))
        );
        let names = [
            ("0.pcd", 0, ["1700000000.2", "1700000000.3"]),
            ("1.pcd", 1, ["1700000000.1", "1700000000.2"]),
        ];
        let error = imported(&names).expect_err("out of order").to_string();
        assert!(error.contains("1.pcd"), "{error}");
    }
}
