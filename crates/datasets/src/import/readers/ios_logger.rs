//! ios_logger (PyojinKim): a text per sensor, seconds since 1970 first. Apple's accelerations are in g and point against specific
//! force: a phone at rest on its back says z = −1.

use std::path::Path;

use lsfb_geometry::{Se3, Vector3};
use lsfb_recording::message::{GnssFix, GnssReading};
use lsfb_types::STANDARD_GRAVITY_M_S2;
use lsfb_types::StampUnit::Seconds;
use nalgebra::{Quaternion, UnitQuaternion};

use super::{TESLA_PER_MICROTESLA, frame};
use crate::Error;
use crate::import::collected::{Collected, StreamId};
use crate::import::payload::{Kind, Payload};
use crate::import::table::{Row, find};

/// Names that a video may have beside the texts.
const VIDEOS: [&str; 4] = ["Frames.m4v", "Frames.mp4", "Frames.mov", "Frames.MOV"];
/// Columns of `GPS.txt`: stamp, latitude, longitude, horizontal accuracy, altitude, vertical accuracy, floor, course, speed.
const GPS_CELLS: usize = 9;
/// Variance of an axis by the square of the radius that holds 68 % of a normal distribution in a plane.
const VARIANCE_BY_RADIUS: f64 = 1.0 / 2.279;

pub(super) fn read(source: &Path, into: &mut Collected) -> Result<(), Error> {
    let accel = file(source, "Accel.txt", "accel", Kind::Vector, into, |row| {
        row.expect_cells(4..=4)?;
        let g: [f64; 3] = row.numbers(1)?;
        Ok(Payload::Vector(g.map(|a| -a * STANDARD_GRAVITY_M_S2)))
    })?;
    let gyro = file(source, "Gyro.txt", "gyro", Kind::Vector, into, |row| {
        row.expect_cells(4..=4)?;
        Ok(Payload::Vector(row.numbers(1)?))
    })?;
    if let (Some(gyro), Some(accel)) = (gyro, accel) {
        into.combine(gyro, accel);
    }
    let tesla = |row: &Row<'_>, cells| {
        row.expect_cells(cells..=cells)?;
        let field: [f64; 3] = row.numbers(1)?;
        Ok(Payload::Magnetic(field.map(|v| v * TESLA_PER_MICROTESLA)))
    };
    file(source, "Magnet.txt", "mag", Kind::Magnetic, into, |row| {
        tesla(row, 4)
    })?;
    file(
        source,
        "MotMagnFull.txt",
        "mag_calibrated",
        Kind::Magnetic,
        into,
        |row| tesla(row, 5),
    )?;
    file(
        source,
        "Motion.txt",
        "orientation",
        Kind::Orientation,
        into,
        |row| {
            row.expect_cells(5..=5)?;
            let [w, x, y, z] = row.numbers(1)?;
            rotation([w, x, y, z])?;
            Ok(Payload::Orientation([x, y, z, w]))
        },
    )?;
    file(source, "ARposes.txt", "pose", Kind::Pose, into, |row| {
        row.expect_cells(8..=8)?;
        let translation = Vector3::from(row.numbers::<3>(1)?);
        let pose = Se3::new(rotation(row.numbers(4)?)?, translation);
        Ok(Payload::Pose(Box::new(pose)))
    })?;
    file(source, "GPS.txt", "gnss", Kind::Gnss, into, |row| {
        row.expect_cells(GPS_CELLS..=GPS_CELLS)?;
        Ok(Payload::Gnss(Box::new(gnss(row)?)))
    })?;
    frames(source, into)?;
    for (name, why) in [
        (
            "MotARH.txt",
            "the device computes it from the gyroscope and the accelerometer",
        ),
        ("Head.txt", "a recording cannot hold a heading"),
    ] {
        if let Some(path) = find(source, name) {
            let table = into.table(&path)?;
            into.leave_out(
                format!("records of {name}"),
                table.rows(',').count() as u64,
                why,
            );
        }
    }
    Ok(())
}

/// Reads a file, where there is one, line by line.
fn file(
    source: &Path,
    name: &str,
    topic: &str,
    kind: Kind,
    into: &mut Collected,
    payload: impl Fn(&Row<'_>) -> Result<Payload, String>,
) -> Result<Option<StreamId>, Error> {
    let Some(path) = find(source, name) else {
        into.notes.push(format!("it has no {name}"));
        return Ok(None);
    };
    let table = into.table(&path)?;
    let stream = into.stream(name, topic, kind);
    for row in table.rows(',') {
        let record = row.stamp(0, Seconds).and_then(|t| Ok((t, payload(&row)?)));
        into.row(stream, &table, &row, record);
    }
    Ok(Some(stream))
}

/// A rotation of w x y z.
pub(super) fn rotation([w, x, y, z]: [f64; 4]) -> Result<UnitQuaternion<f64>, String> {
    let quaternion = Quaternion::new(w, x, y, z);
    match (0.99..1.01).contains(&quaternion.norm()) {
        true => Ok(UnitQuaternion::new_normalize(quaternion)),
        false => Err(format!("a quaternion with norm {:.3}", quaternion.norm())),
    }
}

/// Apple's horizontal accuracy is the radius of a circle that holds the place with 68 %; negative where there is none.
fn gnss(row: &Row<'_>) -> Result<GnssReading, String> {
    let [
        latitude_deg,
        longitude_deg,
        horizontal_m,
        altitude_m,
        vertical_m,
    ] = row.numbers(1)?;
    if !(-90.0..=90.0).contains(&latitude_deg) || !(-180.0..=180.0).contains(&longitude_deg) {
        return Err(format!(
            "latitude {latitude_deg}, longitude {longitude_deg} do not exist"
        ));
    }
    let is_fix = horizontal_m >= 0.0 && vertical_m > 0.0;
    let (plane_m2, up_m2) = (
        horizontal_m.powi(2) * VARIANCE_BY_RADIUS,
        vertical_m.powi(2),
    );
    Ok(GnssReading {
        fix: is_fix.then_some(GnssFix {
            latitude_deg,
            longitude_deg,
            altitude_m,
            covariance_enu_m2: [plane_m2, 0.0, 0.0, 0.0, plane_m2, 0.0, 0.0, 0.0, up_m2],
        }),
    })
}

/// `Frames.txt`: stamp, number, focal lengths and principal point of each frame of the video.
fn frames(source: &Path, into: &mut Collected) -> Result<(), Error> {
    let Some(path) = find(source, "Frames.txt") else {
        return Ok(());
    };
    let table = into.table(&path)?;
    let video = VIDEOS
        .iter()
        .map(|name| source.join(name))
        .find(|p| p.is_file());
    let Some(video) = video else {
        let records = table.rows(',').count() as u64;
        into.leave_out("stamps of Frames.txt", records, "their video is missing");
        return Ok(());
    };
    into.videos.push(video);
    into.notes.push(
        "cam0: ARKit's focal length of each frame is left out: a recording has one lens per camera; calibrate it, or give --rig".to_owned(),
    );
    let number_of_video = into.videos.len() - 1;
    let stream = into.stream("Frames.txt", "cam0/image", Kind::Image);
    for (number, row) in table.rows(',').enumerate() {
        let record = row.expect_cells(6..=6).and_then(|()| {
            let number = u32::try_from(number).map_err(|e| e.to_string())?;
            Ok((
                row.stamp(0, Seconds)?,
                Payload::Image(Box::new(frame(number_of_video, number))),
            ))
        });
        into.row(stream, &table, &row, record);
    }
    Ok(())
}
