//! EuRoC MAV and TUM-VI: `mav0/` with a folder per sensor, in it `data.csv` and, of EuRoC, `sensor.yaml`. Stamps are nanoseconds.
//!
//! ASL dataset format: <https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets>.

use std::path::{Path, PathBuf};

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, ImuNoiseModel, Rig, RigCamera, RigImu, Se3, Vector3, so3};
use lsfb_types::{ImuSample, Progress, ProgressFn, StampUnit};
use nalgebra::Matrix3;
use serde::Deserialize;

use super::image_file;
use crate::Error;
use crate::import::ImportConfig;
use crate::import::collected::Collected;
use crate::import::format::euroc_folder;
use crate::import::payload::{Kind, Payload};
use crate::import::table::{Row, Table};

/// Columns of `imu0/data.csv`: stamp, angular velocity, specific force.
const IMU_CELLS: usize = 7;
/// A rotation matrix is rounded in a file, by no more than this.
const ROTATION_ROUNDING: f64 = 1e-3;

/// What `sensor.yaml` says, as far as it is used.
#[derive(Deserialize)]
struct Sensor {
    #[serde(rename = "T_BS")]
    body_from_sensor: Option<Matrix>,
    resolution: Option<[u32; 2]>,
    camera_model: Option<String>,
    intrinsics: Option<[f64; 4]>,
    distortion_model: Option<String>,
    distortion_coefficients: Option<Vec<f64>>,
    gyroscope_noise_density: Option<f64>,
    gyroscope_random_walk: Option<f64>,
    accelerometer_noise_density: Option<f64>,
    accelerometer_random_walk: Option<f64>,
}

#[derive(Deserialize)]
struct Matrix {
    data: Vec<f64>,
}

pub(super) fn read(
    source: &Path,
    config: &ImportConfig,
    into: &mut Collected,
    progress: ProgressFn<'_>,
) -> Result<(), Error> {
    let root = euroc_folder(source).ok_or_else(|| Error::Recorded {
        path: source.to_owned(),
        problem: "it has neither imu0/data.csv nor cam0/data.csv, also not in mav0/".to_owned(),
    })?;
    let mut sensors: Vec<PathBuf> = std::fs::read_dir(&root)
        .and_then(|entries| entries.map(|e| Ok(e?.path())).collect())
        .map_err(|e| crate::import::io(&root, e))?;
    sensors.sort();
    let mut rig = Rig::empty(&config.device);
    for (done, sensor) in sensors.iter().enumerate() {
        progress(Progress {
            stage: "reading records",
            done: done as u64,
            total: sensors.len() as u64,
        })?;
        let name = sensor.file_name().unwrap_or_default().to_string_lossy();
        let list = sensor.join("data.csv");
        if !list.is_file() {
            continue;
        }
        if name.starts_with("cam") {
            images(sensor, &name, &list, into)?;
            calibrate(sensor, into, |sensor| add_camera(&mut rig, &name, sensor))?;
        } else if name.starts_with("imu") {
            samples(&name, &list, into)?;
            calibrate(sensor, into, |sensor| add_imu(&mut rig, &name, sensor))?;
        } else {
            let table = into.table(&list)?;
            let records = table.rows(',').count() as u64;
            into.leave_out(
                format!("records of {name}"),
                records,
                "ground truth stays in its file: `lsfb eval --truth` reads it",
            );
        }
    }
    // In a rig the main IMU is the origin, and what is placed is placed on it.
    if let Some(main) = rig.imus.get("imu0").map(|imu| imu.rig_from_imu) {
        let imu_from_body = main.inverse();
        for camera in rig.cameras.values_mut() {
            camera.rig_from_camera = imu_from_body * camera.rig_from_camera;
        }
        for imu in rig.imus.values_mut() {
            imu.rig_from_imu = imu_from_body * imu.rig_from_imu;
        }
    }
    match rig.cameras.is_empty() {
        true => into.notes.push(
            "it has no calibration (sensor.yaml): give one with --rig, or convert camchain.yaml with `lsfb calib import`".to_owned(),
        ),
        false => into.rig = Some(rig),
    }
    Ok(())
}

fn images(sensor: &Path, name: &str, list: &Path, into: &mut Collected) -> Result<(), Error> {
    let table = into.table(list)?;
    let stream = into.stream(
        format!("{name}/data.csv"),
        &format!("{name}/image"),
        Kind::Image,
    );
    let folder = sensor.join("data");
    for (number, row) in table.rows(',').enumerate() {
        let record = row.expect_cells(2..=2).and_then(|()| {
            let time_ns = row.stamp(0, StampUnit::Nanoseconds)?;
            Ok((time_ns, image_file(&folder, row.text(1), number)?))
        });
        into.row(stream, &table, &row, record);
    }
    Ok(())
}

fn samples(name: &str, list: &Path, into: &mut Collected) -> Result<(), Error> {
    let table: Table = into.table(list)?;
    // The main one is the device's.
    let topic = if name == "imu0" { "imu" } else { name };
    let stream = into.stream(format!("{name}/data.csv"), topic, Kind::Imu);
    for row in table.rows(',') {
        into.row(stream, &table, &row, sample(&row));
    }
    Ok(())
}

fn sample(row: &Row<'_>) -> Result<(i64, Payload), String> {
    row.expect_cells(IMU_CELLS..=IMU_CELLS)?;
    let sample = ImuSample {
        angular_velocity_rad_s: row.numbers(1)?,
        specific_force_m_s2: row.numbers(4)?,
    };
    Ok((row.stamp(0, StampUnit::Nanoseconds)?, Payload::Imu(sample)))
}

/// Reads `sensor.yaml`, where there is one.
fn calibrate(
    sensor: &Path,
    into: &mut Collected,
    add: impl FnOnce(&Sensor) -> Result<(), String>,
) -> Result<(), Error> {
    let path = sensor.join("sensor.yaml");
    if !path.is_file() {
        return Ok(());
    }
    let table = into.table(&path)?;
    // OpenCV's head is no YAML directive.
    let text: Vec<&str> = table
        .text()
        .lines()
        .filter(|l| !l.starts_with('%'))
        .collect();
    let parsed: Result<Sensor, String> =
        serde_norway::from_str(&text.join("\n")).map_err(|e| e.to_string());
    parsed
        .and_then(|sensor| add(&sensor))
        .map_err(|problem| Error::Recorded { path, problem })
}

fn add_camera(rig: &mut Rig, name: &str, sensor: &Sensor) -> Result<(), String> {
    let [width, height] = sensor.resolution.ok_or("no resolution")?;
    let [fx, fy, cx, cy] = sensor
        .intrinsics
        .ok_or("it has no pinhole intrinsics: fu, fv, cu, cv")?;
    let (focal_px, principal_px) = ([fx, fy], [cx, cy]);
    let coefficients = sensor
        .distortion_coefficients
        .as_deref()
        .unwrap_or_default();
    let camera_model = sensor.camera_model.as_deref().unwrap_or("pinhole");
    let distortion_model = sensor
        .distortion_model
        .as_deref()
        .unwrap_or("radial-tangential");
    let lens = match (camera_model, distortion_model, coefficients) {
        ("pinhole", "radial-tangential" | "radtan", [k1, k2, p1, p2]) => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [*k1, *k2, *p1, *p2, 0.0],
        },
        ("pinhole", "equidistant", [k1, k2, k3, k4]) => Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [*k1, *k2, *k3, *k4],
        },
        _ => {
            return Err(format!(
                "{camera_model} with {distortion_model} of {} coefficients is not supported",
                coefficients.len()
            ));
        }
    };
    let camera = RigCamera {
        camera: Camera {
            width,
            height,
            lens,
        },
        rig_from_camera: body_from_sensor(sensor)?,
        timing: lsfb_geometry::CameraTiming::default(),
        sigmas: Default::default(),
    };
    rig.cameras.insert(name.to_owned(), camera);
    Ok(())
}

fn add_imu(rig: &mut Rig, name: &str, sensor: &Sensor) -> Result<(), String> {
    let noise = ImuNoiseModel {
        gyro_noise_density: sensor
            .gyroscope_noise_density
            .ok_or("no gyroscope_noise_density")?,
        accel_noise_density: sensor
            .accelerometer_noise_density
            .ok_or("no accelerometer_noise_density")?,
        gyro_bias_walk: sensor
            .gyroscope_random_walk
            .ok_or("no gyroscope_random_walk")?,
        accel_bias_walk: sensor
            .accelerometer_random_walk
            .ok_or("no accelerometer_random_walk")?,
    };
    let imu = RigImu {
        rig_from_imu: body_from_sensor(sensor)?,
        noise,
    };
    rig.imus.insert(name.to_owned(), imu);
    Ok(())
}

fn body_from_sensor(sensor: &Sensor) -> Result<Se3, String> {
    let matrix = sensor.body_from_sensor.as_ref().ok_or("no T_BS")?;
    pose_of_rows(&matrix.data).map_err(|why| format!("T_BS {why}"))
}

/// A rigid transform of sixteen numbers, row by row.
pub(super) fn pose_of_rows(rows: &[f64]) -> Result<Se3, &'static str> {
    let &[a, b, c, x, d, e, f, y, g, h, i, z, ..] = rows else {
        return Err("has not sixteen numbers");
    };
    let rotation = Matrix3::new(a, b, c, d, e, f, g, h, i);
    let rotation = so3::from_rounded(&rotation, ROTATION_ROUNDING)
        .filter(|_| rows.len() == 16)
        .ok_or("is not a rigid transform")?;
    if ![x, y, z].iter().all(|v| v.is_finite()) {
        return Err("is not finite");
    }
    Ok(Se3::new(rotation, Vector3::new(x, y, z)))
}
