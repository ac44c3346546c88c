//! Trajectory files of any program: TUM text, positions, KITTI pose text, EuRoC csv, any table with names, kapture, COLMAP, poses in MCAP;
//! text gzipped or not. Poses come in order of time; what had to be sorted, guessed or left out is a finding.

mod colmap;
mod columns;
mod decimal;
mod folder;
mod layout;
mod mcap;
mod order;
mod row;
mod stamp_unit;
mod text;
mod times;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use lsfb_geometry::{Matrix6, StampedPose};
use lsfb_types::{Finding, StampUnit, Timestamp, Verdict};
use serde::Serialize;

use crate::Error;
use crate::success::SuccessRate;
use decimal::decimal_nanos;
use layout::{Content, Layout};
use order::{Unordered, put_in_order};
use row::Row;
use stamp_unit::{StampSize, speed_in_milliseconds_m_s};
use text::{Line, shown};

pub use columns::Columns;
pub use row::covariance_in_world;

/// What is understood, in the words of an error.
const UNDERSTOOD: &str = "TUM text, positions, KITTI poses, EuRoC csv, a table with names, kapture, COLMAP's images.txt and images.bin or MCAP";

/// A quaternion that misses the length one by more was not merely rounded.
const LENGTH_TOLERANCE: f64 = 0.01;

/// The code of what is said of a file whose rows have no stamps.
pub(crate) const NO_STAMPS: &str = "no-stamps";

/// Whether poses say how the body is turned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Orientations {
    /// They do.
    #[default]
    Known,
    /// Positions only: rotations are identity, and mean nothing.
    Missing,
}

/// What a file cannot say itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// Unit of the stamps; `None` takes what the file says or what follows from their size.
    pub stamp_unit: Option<StampUnit>,
    /// What the columns of a table are; `None` takes what the file says or what follows from their number.
    pub columns: Option<Columns>,
    /// The device of a kapture file, the topic of a recording; `None` takes the only one there is.
    pub stream: Option<String>,
    /// The file with the stamps of rows that have none (KITTI's matrices), one per line.
    pub times: Option<PathBuf>,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryFile {
    /// In order of time; poses of one stamp stay side by side, as the file has them.
    pub poses: Vec<StampedPose>,
    /// Whether rotations are known.
    pub orientations: Orientations,
    /// Beside the poses, in their tangent (`[rotation, translation]`, rad and metres); empty where not every pose has one.
    pub covariances: Vec<Matrix6<f64>>,
    /// How many frames matched a map, where the rows say it.
    pub success: Option<SuccessRate>,
    /// What had to be sorted, guessed or left out.
    pub findings: Vec<Finding>,
}

impl TrajectoryFile {
    /// Of poses with orientations, in order of time, of which nothing else is known.
    pub fn of_poses(poses: Vec<StampedPose>) -> Self {
        Self {
            poses,
            orientations: Orientations::Known,
            covariances: Vec::new(),
            success: None,
            findings: Vec::new(),
        }
    }
}

/// Reads a trajectory; the file itself tells its format. Eight columns are TUM's `t x y z qx qy qz qw`; four `t x y z`; twelve or
/// sixteen a pose matrix (row n gets the stamp n s, or that of the file of times); eight or more with commas and whole stamps EuRoC's `t,x,y,z,qw,qx,qy,qz,…`; a row
/// or comment with names overrules all that. Forty-four are TUM's with a covariance of x, y, z and rotations about the world's axes, row
/// by row. A table with a column `matches` or `inliers` is a localization: its success rate is counted, and rows whose column `localized` is 0
/// have no pose. Stamps may be seconds, milliseconds, microseconds or nanoseconds.
pub fn read_trajectory(path: &Path, options: &ReadOptions) -> Result<TrajectoryFile, Error> {
    let folder_file = folder::trajectory_in(path)?;
    let path = folder_file.as_deref().unwrap_or(path);
    if text::is_mcap(path)? {
        times::expect_none(path, options.times.as_deref())?;
        return mcap::read(path, options.stream.as_deref());
    }
    let text = text::with_points(text::read(path)?);
    let (mut rows, comments) = text::lines(&text);
    layout::keep_poses(&mut rows, &comments);
    let bad = |number: usize, what: String| Error::BadLine {
        path: path.to_owned(),
        line: number,
        what,
    };
    let nothing = || Error::NotATrajectory {
        path: path.to_owned(),
        what: format!("it has no poses; expected {UNDERSTOOD}"),
    };
    if rows.is_empty() {
        return Err(nothing());
    }
    let layout = Layout::of(&rows, &comments, options.columns);
    let layout = layout.map_err(|(number, what)| bad(number, what))?;
    let mut read: Vec<(Line<'_>, Row<'_>)> = Vec::with_capacity(rows.len());
    let mut left_out = 0;
    let mut success = layout.frames.map(|_| SuccessRate::default());
    let mut columns = Vec::with_capacity(layout.columns);
    for line in rows.iter().skip(layout.header_rows) {
        layout.separator.split_into(line.text, &mut columns);
        if columns.len() != layout.columns {
            let what = format!(
                "a row of {} columns among rows of {}",
                columns.len(),
                layout.columns
            );
            return Err(bad(line.number, what));
        }
        let row = row::parse(layout.content, &columns).map_err(|what| bad(line.number, what))?;
        let mut is_localized = row.is_some();
        if let (Some(success), Some(at)) = (&mut success, layout.frames) {
            let frame = row::frame(at, &columns).map_err(|what| bad(line.number, what))?;
            is_localized &= frame.is_localized;
            success.add(frame.matches, is_localized);
        }
        match row.filter(|_| is_localized) {
            Some(row) => read.push((*line, row)),
            None => left_out += 1,
        }
    }
    let mut findings = Vec::new();
    let mut warn = |code, what: String, remedy: &str| {
        findings.push(Finding::new(code, Verdict::Warn, name(path), what).remedy(remedy));
    };
    // Of a localization the success rate says it.
    if left_out > 0 && success.is_none() {
        let what = format!(
            "{} left out",
            crate::count(left_out, "row without a pose", "rows without a pose")
        );
        warn("rows-without-pose", what, "");
    }
    let of_poses = rows.get(layout.header_rows..).unwrap_or_default();
    if let Some(number) = text::cut_number(&text, of_poses) {
        let what = format!(
            "the file ends within its last number, '{}': the last pose may be wrong",
            shown(number)
        );
        warn("cut", what, "write it again, or delete its last row");
    }
    if let Some(assumed) = layout.assumed {
        warn(
            "columns",
            assumed.to_owned(),
            "add a header row with the names of the columns",
        );
    }
    let long = read
        .iter()
        .map(|(line, row)| (line.number, row.quaternion_length))
        .filter(|(_, length)| (length - 1.0).abs() > LENGTH_TOLERANCE);
    let worst = long
        .clone()
        .max_by(|a, b| (a.1 - 1.0).abs().total_cmp(&(b.1 - 1.0).abs()));
    if let Some((number, length)) = worst {
        let what = format!(
            "{} with a norm other than 1 (line {number}: {length:.3}), and normalised",
            crate::count(long.count(), "quaternion is", "quaternions are")
        );
        warn(
            "quaternions",
            what,
            "check which columns hold the quaternion",
        );
    }
    choose_device(path, &mut read, options.stream.as_deref())?;
    if read.is_empty() {
        return Err(nothing());
    }
    let is_matrix = layout.content == Content::Matrix;
    // Seconds that nobody said, and that nothing was said of.
    let mut is_guess = false;
    let times = if let (true, Some(times)) = (is_matrix, &options.times) {
        let (times, remark) = times::read(times, path, read.len(), options.stamp_unit)?;
        is_guess = options.stamp_unit.is_none() && remark.is_none();
        if let Some(remark) = remark {
            warn("stamp-unit", remark, "give the unit of the stamps");
        }
        times
    } else if is_matrix {
        let what = "rows without stamps, assumed to be one per second".to_owned();
        let remedy = "give the file with their stamps; without it figures over time (relative errors \
             per second, smoothness, gaps) are meaningless, and all figures are if the rows of \
             estimate and truth belong to different frames";
        warn(NO_STAMPS, what, remedy);
        (0..read.len()).map(whole_secs).collect()
    } else {
        times::expect_none(path, options.times.as_deref())?;
        let stamps: Vec<(usize, &str)> = read
            .iter()
            .map(|(line, row)| (line.number, row.stamp.unwrap_or_default()))
            .collect();
        let said = options.stamp_unit.or(layout.unit);
        let (times, remark) = stamp_times(path, &stamps, said)?;
        is_guess = said.is_none() && remark.is_none();
        if let Some(remark) = remark {
            warn("stamp-unit", remark, "give the unit of the stamps");
        }
        times
    };
    let poses = read.into_iter().zip(times);
    let mut poses: Vec<Unordered> = poses
        .map(|((_, row), time)| Unordered {
            time,
            world_from_rig: row.world_from_rig,
            covariance: row.covariance,
        })
        .collect();
    if layout.content == Content::Colmap {
        // By image number, which is no order of time.
        poses.sort_by_key(|p| p.time);
    }
    let orientations = match layout.content.has_rotation() {
        true => Orientations::Known,
        false => Orientations::Missing,
    };
    let mut file = put_in_order(path, poses, orientations, findings)?;
    if is_guess && let Some(speed_m_s) = speed_in_milliseconds_m_s(&file.poses) {
        let what = format!(
            "the speed is {speed_m_s:.2} mm/s with stamps read as seconds; if they are milliseconds, it is {speed_m_s:.2} m/s"
        );
        file.findings.push(
            Finding::new("stamp-unit", Verdict::Warn, name(path), what)
                .value(speed_m_s, "m/s")
                .remedy("give the unit of the stamps"),
        );
    }
    Ok(TrajectoryFile { success, ..file })
}

/// The poses of a file that says what it holds, in order of time, where every pose has a rotation.
pub fn read_poses(path: &Path) -> Result<Vec<StampedPose>, Error> {
    let file = read_trajectory(path, &ReadOptions::default())?;
    match file.orientations {
        Orientations::Known => Ok(file.poses),
        Orientations::Missing => Err(Error::NeedsOrientation { purpose: "poses" }),
    }
}

/// Leaves the rows of one device of a kapture file.
fn choose_device(
    path: &Path,
    read: &mut Vec<(Line<'_>, Row<'_>)>,
    wanted: Option<&str>,
) -> Result<(), Error> {
    let devices: BTreeSet<&str> = read.iter().filter_map(|(_, row)| row.device).collect();
    let chosen = match wanted {
        Some(wanted) => devices.get(wanted).copied(),
        None if devices.len() <= 1 => return Ok(()),
        None => None,
    };
    let Some(chosen) = chosen else {
        let names: Vec<String> = devices.iter().map(|d| shown(d)).collect();
        return Err(Error::NoSuchDevice {
            path: path.to_owned(),
            devices: match names.is_empty() {
                true => "no names".to_owned(),
                false => names.join(", "),
            },
        });
    };
    read.retain(|(_, row)| row.device == Some(chosen));
    Ok(())
}

/// Stamps as times, and what is to be said where their unit was guessed or is doubtful.
fn stamp_times(
    path: &Path,
    stamps: &[(usize, &str)],
    said: Option<StampUnit>,
) -> Result<(Vec<Timestamp>, Option<String>), Error> {
    let bad = |number: usize, text: &str| Error::BadLine {
        path: path.to_owned(),
        line: number,
        what: format!("'{}' is not a stamp", shown(text)),
    };
    let mut sizes = Vec::with_capacity(stamps.len());
    for (number, text) in stamps {
        let size: Option<f64> = text.parse().ok().filter(|v: &f64| v.is_finite());
        sizes.push(size.ok_or_else(|| bad(*number, text))?);
    }
    let size = StampSize::of(&sizes);
    let unit = match said {
        Some(unit) => unit,
        None => size.unit().map_err(|possible| Error::UnknownStampUnit {
            path: path.to_owned(),
            step: size.step,
            possible: match possible.is_empty() {
                true => "no plausible one".to_owned(),
                false => possible
                    .iter()
                    .map(StampUnit::to_string)
                    .collect::<Vec<_>>()
                    .join(" or "),
            },
        })?,
    };
    let remark = match size.doubtful_step_secs(unit) {
        Some(step_secs) => Some(format!(
            "the median interval between poses is {step_secs:.3e} s, with stamps read as {unit}"
        )),
        None if said.is_none() && unit != StampUnit::Seconds && size.largest < 1e11 => {
            Some(format!(
                "stamps read as {unit}, because the median interval between poses is {}",
                size.step
            ))
        }
        None => None,
    };
    let times = stamps.iter().map(|(number, text)| {
        decimal_nanos(text, unit.exponent().into()).ok_or_else(|| bad(*number, text))
    });
    Ok((times.collect::<Result<_, _>>()?, remark))
}

fn whole_secs(index: usize) -> Timestamp {
    // A file below 1 GiB has fewer rows than seconds fit 64 bits of nanoseconds.
    Timestamp::from_nanos(index as i64 * 1_000_000_000)
}

/// A file as findings call it.
fn name(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests;
