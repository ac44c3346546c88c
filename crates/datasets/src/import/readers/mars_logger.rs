//! MARSLogger (OSUPCVLab): `gyro_accel.csv`, `movie.mp4`, `frame_timestamps.txt`, and `movie_metadata.csv` with exposures.
//!
//! Names of columns carry their unit in brackets; without names stamps are nanoseconds, then rad/s, then m/s². Stamps count from the
//! start of the phone.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_types::{ImuSample, STANDARD_GRAVITY_M_S2, StampUnit};

use super::frame;
use crate::Error;
use crate::import::collected::Collected;
use crate::import::payload::{Kind, Payload};
use crate::import::table::{Row, Table, find};

/// Videos of Android and of iOS.
const VIDEOS: [&str; 3] = ["movie.mp4", "movie.MP4", "movie.MOV"];
/// Columns of `gyro_accel.csv`: stamp, angular velocity, acceleration, and the time of day in later versions.
const IMU_CELLS: std::ops::RangeInclusive<usize> = 7..=8;
/// `movie_metadata.csv`: exposure and readout.
const EXPOSURE_CELL: usize = 4;
const READOUT_CELL: usize = 6;

pub(super) fn read(source: &Path, into: &mut Collected) -> Result<(), Error> {
    let path = find(source, "gyro_accel.csv").ok_or_else(|| Error::Recorded {
        path: source.to_owned(),
        problem: "it has no gyro_accel.csv".to_owned(),
    })?;
    let table = into.table(&path)?;
    samples(&table, into)?;
    let Some(stamps) = find(source, "frame_timestamps.txt") else {
        into.notes
            .push("it has no frame_timestamps.txt: no images".to_owned());
        return Ok(());
    };
    let exposures = match find(source, "movie_metadata.csv") {
        Some(path) => exposures(&into.table(&path)?),
        None => BTreeMap::new(),
    };
    let table = into.table(&stamps)?;
    let video = VIDEOS
        .iter()
        .map(|name| source.join(name))
        .find(|p| p.is_file());
    let Some(video) = video else {
        let frames = data_rows(&table).count() as u64;
        into.leave_out(
            "stamps of frame_timestamps.txt",
            frames,
            "the video movie.mp4 is missing",
        );
        return Ok(());
    };
    let number_of_video = into.videos.len();
    into.videos.push(video);
    let unit = unit(&table);
    let stream = into.stream("frame_timestamps.txt", "cam0/image", Kind::Image);
    let mut without = 0_u64;
    for (number, row) in data_rows(&table).enumerate() {
        let record = row.expect_cells(1..=2).and_then(|()| {
            let began_ns = row.stamp(0, unit)?;
            let mut image = frame(
                number_of_video,
                u32::try_from(number).map_err(|e| e.to_string())?,
            );
            let exposed = exposures.get(&began_ns);
            without += u64::from(exposed.is_none());
            let middle_ns = exposed.map_or(0, |e| {
                image.exposure_ns = e.exposure_ns;
                image.device_ns = began_ns.unsigned_abs();
                e.to_middle_ns
            });
            Ok((
                began_ns.saturating_add(middle_ns),
                Payload::Image(Box::new(image)),
            ))
        });
        into.row(stream, &table, &row, record);
    }
    if without > 0 {
        into.notes.push(format!(
            "{without} frames have no exposure in movie_metadata.csv: they are stamped at the start of the exposure of the first row, not in the middle"
        ));
    }
    Ok(())
}

/// Lines behind the names of the columns.
fn data_rows(table: &Table) -> impl Iterator<Item = Row<'_>> {
    table.rows(',').filter(|row| !is_head(row))
}

fn is_head(row: &Row<'_>) -> bool {
    row.text(0).to_lowercase().contains("timestamp")
}

/// The unit in the first column's name.
fn unit(table: &Table) -> StampUnit {
    let head = table.rows(',').find(is_head);
    let name = head.map_or_else(String::new, |row| row.text(0).to_lowercase());
    match name.contains("[sec") || name.contains("[s]") {
        true => StampUnit::Seconds,
        false => StampUnit::Nanoseconds,
    }
}

fn samples(table: &Table, into: &mut Collected) -> Result<(), Error> {
    let stamp_unit = unit(table);
    let head = table.rows(',').find(is_head);
    let named = |cell: usize| head.as_ref().map_or("", |row| row.text(cell));
    // Apple's accelerations are in g and point against specific force.
    let scale = match named(4) {
        name if name.contains("[g]") => -STANDARD_GRAVITY_M_S2,
        name if name.is_empty() || name.contains("m/s") || !name.contains('[') => 1.0,
        name => {
            return Err(Error::Recorded {
                path: table.path.clone(),
                problem: format!("column `{name}`: the unit of accelerations must be m/s^2 or g"),
            });
        }
    };
    if named(1).contains("deg") {
        return Err(Error::Recorded {
            path: table.path.clone(),
            problem: format!(
                "column `{}`: the unit of angular rates must be rad/s",
                named(1)
            ),
        });
    }
    let stream = into.stream("gyro_accel.csv", "imu", Kind::Imu);
    for row in data_rows(table) {
        let record = row.expect_cells(IMU_CELLS).and_then(|()| {
            let sample = ImuSample {
                angular_velocity_rad_s: row.numbers(1)?,
                specific_force_m_s2: row.numbers::<3>(4)?.map(|a| a * scale),
            };
            Ok((row.stamp(0, stamp_unit)?, Payload::Imu(sample)))
        });
        into.row(stream, table, &row, record);
    }
    Ok(())
}

/// Of a frame.
#[derive(Clone, Copy)]
struct Exposure {
    exposure_ns: u32,
    /// From the beginning of the first row's exposure to the middle of the middle row's.
    to_middle_ns: i64,
}

/// Exposures by the stamp of their frame; a line that says none has none.
fn exposures(table: &Table) -> BTreeMap<i64, Exposure> {
    let unit = unit(table);
    let exposure = |row: Row<'_>| {
        let exposure_ns: u32 = row.whole(EXPOSURE_CELL).ok()?;
        let readout_ns: u32 = row.whole(READOUT_CELL).ok()?;
        let to_middle_ns = (i64::from(exposure_ns) + i64::from(readout_ns)) / 2;
        let exposure = Exposure {
            exposure_ns,
            to_middle_ns,
        };
        Some((row.stamp(0, unit).ok()?, exposure))
    };
    data_rows(table).filter_map(exposure).collect()
}
