//! StrayScanner: `rgb.mp4`, `odometry.csv` with a line per frame, `imu.csv`, `camera_matrix.csv`; depth and confidence as PNG.
//!
//! Stamps are seconds since the phone was started. Format: strayrobots/scanner, README.

use std::path::Path;

use lsfb_geometry::{Camera, CameraTiming, Rig, RigCamera, Se3, Vector3};
use lsfb_types::StampUnit::Seconds;
use lsfb_types::{ImuSample, STANDARD_GRAVITY_M_S2, median};

use super::frame;
use super::ios_logger::rotation;
use crate::Error;
use crate::import::ImportConfig;
use crate::import::collected::Collected;
use crate::import::payload::{Kind, Payload};
use crate::import::table::{Row, Table, find};
use crate::import::video::Frames;

/// Columns of `imu.csv`: stamp, acceleration, angular velocity.
const IMU_CELLS: usize = 7;
/// Columns of `odometry.csv`: stamp, frame, position, quaternion; later versions add intrinsics.
const POSE_CELLS: std::ops::RangeInclusive<usize> = 9..=15;
/// Median acceleration of a phone that is carried, in g; versions of the app differ in the unit.
const IN_G: std::ops::Range<f64> = 0.8..1.2;
/// The same in m/s².
const IN_M_S2: std::ops::Range<f64> = 7.8..11.8;

pub(super) fn read(
    source: &Path,
    config: &ImportConfig,
    into: &mut Collected,
) -> Result<(), Error> {
    if let Some(path) = find(source, "imu.csv") {
        let table = into.table(&path)?;
        samples(&table, into);
    }
    let path = find(source, "odometry.csv").ok_or_else(|| Error::Recorded {
        path: source.to_owned(),
        problem: "it has no odometry.csv".to_owned(),
    })?;
    let table = into.table(&path)?;
    let video = source.join("rgb.mp4");
    let poses = into.stream("poses in odometry.csv", "pose", Kind::Pose);
    for row in data_rows(&table) {
        into.row(poses, &table, &row, pose(&row));
    }
    into.notes
        .push("pose: in the app's axes, unchanged".to_owned());
    if !video.is_file() {
        let frames = data_rows(&table).count() as u64;
        into.leave_out(
            "frames of odometry.csv",
            frames,
            "their video rgb.mp4 is missing",
        );
        return Ok(());
    }
    let images = into.stream("frames in odometry.csv", "cam0/image", Kind::Image);
    for row in data_rows(&table) {
        let record = row.expect_cells(POSE_CELLS).and_then(|()| {
            let image = frame(into.videos.len(), row.whole(1)?);
            Ok((row.stamp(0, Seconds)?, Payload::Image(Box::new(image))))
        });
        into.row(images, &table, &row, record);
    }
    if let Some(path) = find(source, "camera_matrix.csv") {
        calibrate(&path, &video, &config.device, into)?;
    }
    into.videos.push(video);
    Ok(())
}

/// Lines behind the names of the columns.
fn data_rows(table: &Table) -> impl Iterator<Item = Row<'_>> {
    table.rows(',').filter(|row| row.text(0) != "timestamp")
}

fn pose(row: &Row<'_>) -> Result<(i64, Payload), String> {
    row.expect_cells(POSE_CELLS)?;
    let [qx, qy, qz, qw] = row.numbers(5)?;
    let translation = Vector3::from(row.numbers::<3>(2)?);
    let pose = Se3::new(rotation([qw, qx, qy, qz])?, translation);
    Ok((row.stamp(0, Seconds)?, Payload::Pose(Box::new(pose))))
}

/// Accelerations point against specific force, as Apple's do; their unit is told by gravity, which is most of them.
fn samples(table: &Table, into: &mut Collected) {
    let stream = into.stream("imu.csv", "imu", Kind::Imu);
    let acceleration = |row: &Row<'_>| row.numbers::<3>(1);
    let norms = data_rows(table).filter_map(|row| {
        let [x, y, z] = acceleration(&row).ok()?;
        Some((x * x + y * y + z * z).sqrt())
    });
    let usual = median(norms.collect()).unwrap_or(0.0);
    let m_s2_per_unit = if IN_G.contains(&usual) {
        Ok(STANDARD_GRAVITY_M_S2)
    } else if IN_M_S2.contains(&usual) {
        Ok(1.0)
    } else {
        Err(format!(
            "the median acceleration is {usual:.3}, neither 1 g nor 9.81 m/s²: gravity was removed"
        ))
    };
    for row in data_rows(table) {
        let record = row.expect_cells(IMU_CELLS..=IMU_CELLS).and_then(|()| {
            let scale = m_s2_per_unit.clone()?;
            let sample = ImuSample {
                angular_velocity_rad_s: row.numbers(4)?,
                specific_force_m_s2: acceleration(&row)?.map(|a| -a * scale),
            };
            Ok((row.stamp(0, Seconds)?, Payload::Imu(sample)))
        });
        into.row(stream, table, &row, record);
    }
}

/// `camera_matrix.csv` is a pinhole's; its pixel (0, 0) is the middle of the first, as Apple says.
fn calibrate(matrix: &Path, video: &Path, device: &str, into: &mut Collected) -> Result<(), Error> {
    let table = into.table(matrix)?;
    let rows: Result<Vec<[f64; 3]>, String> = table.rows(',').map(|r| r.numbers(0)).collect();
    let [[fx, _, cx], [_, fy, cy], _] = rows.as_deref().unwrap_or_default() else {
        return Err(Error::Recorded {
            path: matrix.to_owned(),
            problem: "not a matrix of three lines of three numbers".to_owned(),
        });
    };
    // What is wrong with the video is told of its frames.
    let Ok(first) = Frames::open(video).and_then(|mut frames| frames.read(0)) else {
        return Ok(());
    };
    let mut rig = Rig::empty(device);
    let camera = RigCamera {
        camera: Camera::pinhole(first.width, first.height, [*fx, *fy], [*cx, *cy]),
        rig_from_camera: Se3::identity(),
        timing: CameraTiming::default(),
        sigmas: Default::default(),
    };
    rig.cameras.insert("cam0".to_owned(), camera);
    into.rig = Some(rig);
    into.notes.push(
        "rig: one lens without distortion, from camera_matrix.csv; its pose on the IMU is unknown"
            .to_owned(),
    );
    Ok(())
}
