//! Trajectories in the files of other programs: what [`crate::read_trajectory`] reads, it writes.

mod mcap;
mod text;

use std::path::{Path, PathBuf};

use lsfb_geometry::{Matrix6, StampedPose, Trajectory};
use lsfb_recording::write_tum;
use serde::Serialize;

use crate::{Error, Orientations, TrajectoryFile};

pub use text::euroc_text;

/// Whose files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrajectoryFormat {
    /// Text: `t x y z qx qy qz qw`, seconds and metres.
    Tum,
    /// A csv with the stamp in nanoseconds and w first, as `state_groundtruth_estimate0` has it, without velocities and biases.
    Euroc,
    /// A pose matrix a row, three rows of four; its stamps in a file beside it, `NAME_times.txt`, seconds.
    Kitti,
    /// A table with a row of names; positions alone where no rotations are known.
    Csv,
    /// A folder with `sensors/trajectories.txt`, whose poses are those of the world in the device `rig`, and `sensors/sensors.txt`.
    Kapture,
    /// A ROS 2 bag: `geometry_msgs/PoseStamped` on `/pose`, or `PoseWithCovarianceStamped` where every pose has a covariance.
    Mcap,
}

impl TrajectoryFormat {
    /// All of them, by the names that they are called for.
    pub const NAMED: [(&'static str, Self); 6] = [
        ("tum", Self::Tum),
        ("euroc", Self::Euroc),
        ("kitti", Self::Kitti),
        ("csv", Self::Csv),
        ("kapture", Self::Kapture),
        ("mcap", Self::Mcap),
    ];

    /// The files that are written where `out` is asked for.
    pub fn files(self, out: &Path) -> Vec<PathBuf> {
        match self {
            Self::Tum | Self::Euroc | Self::Csv | Self::Mcap => vec![out.to_owned()],
            Self::Kitti => {
                let stem = out.file_stem().unwrap_or_default().to_string_lossy();
                vec![
                    out.to_owned(),
                    out.with_file_name(format!("{stem}_times.txt")),
                ]
            }
            Self::Kapture => ["sensors.txt", "trajectories.txt"]
                .map(|name| out.join("sensors").join(name))
                .to_vec(),
        }
    }
}

/// What became of a trajectory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Written {
    /// The files.
    pub files: Vec<PathBuf>,
    /// Poses in them.
    pub poses: usize,
    /// Poses that were left out because they repeat the stamp of the one before them.
    pub repeated_stamps: usize,
    /// Covariances that the format has no place for.
    pub covariances_left_out: usize,
}

/// Writes a trajectory. Of poses with one stamp the first is kept. A format that has rotations is refused where none are known, and a ROS
/// bag where stamps are before 1970.
pub fn write_trajectory(
    trajectory: &TrajectoryFile,
    format: TrajectoryFormat,
    out: &Path,
) -> Result<Written, Error> {
    if trajectory.orientations == Orientations::Missing && format != TrajectoryFormat::Csv {
        return Err(Error::NeedsOrientation {
            purpose: "files of all formats but csv",
        });
    }
    let (poses, covariances) = without_repeated(trajectory);
    if poses.is_empty() {
        return Err(Error::Empty { role: "converted" });
    }
    let files = format.files(out);
    let texts = match format {
        TrajectoryFormat::Tum => {
            write_tum(out, &Trajectory::new(poses.clone()))?;
            Vec::new()
        }
        TrajectoryFormat::Mcap => {
            mcap::write(&poses, &covariances, out)?;
            Vec::new()
        }
        TrajectoryFormat::Euroc => vec![euroc_text(&poses)],
        TrajectoryFormat::Kitti => vec![text::kitti(&poses), text::times(&poses)],
        TrajectoryFormat::Csv => vec![text::csv(&poses, trajectory.orientations)],
        TrajectoryFormat::Kapture => vec![text::kapture_sensors(), text::kapture(&poses)],
    };
    for (path, text) in files.iter().zip(texts) {
        put(path, &text)?;
    }
    Ok(Written {
        files,
        poses: poses.len(),
        repeated_stamps: trajectory.poses.len() - poses.len(),
        covariances_left_out: match format {
            TrajectoryFormat::Mcap => 0,
            _ => covariances.len(),
        },
    })
}

/// One pose per stamp, and its covariance where all have one.
fn without_repeated(trajectory: &TrajectoryFile) -> (Vec<StampedPose>, Vec<Matrix6<f64>>) {
    let all = &trajectory.poses;
    let is_new = |i: usize| {
        let before = i.checked_sub(1).and_then(|before| all.get(before));
        before.map(|p| p.time) != all.get(i).map(|p| p.time)
    };
    let kept = || (0..all.len()).filter(|i| is_new(*i));
    let poses = kept().filter_map(|i| all.get(i).copied()).collect();
    let covariances = kept().filter_map(|i| trajectory.covariances.get(i).copied());
    (poses, covariances.collect())
}

fn put(path: &Path, text: &str) -> Result<(), Error> {
    let around = path.parent().unwrap_or(Path::new("."));
    let written = match around.as_os_str().is_empty() {
        true => Ok(()),
        false => std::fs::create_dir_all(around),
    };
    written
        .and_then(|()| std::fs::write(path, text))
        .map_err(|source| Error::Io {
            path: path.to_owned(),
            source,
        })
}

#[cfg(test)]
mod tests;
