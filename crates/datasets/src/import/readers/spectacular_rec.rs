//! Spectacular Rec: `data.jsonl` with one object per event, `data.mkv` (`data2.mkv` …), `calibration.json`.
//!
//! Format: SpectacularAI/docs, `other/DATA_FORMAT.md`. Stamps are seconds from any zero.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, CameraTiming, Rig, RigCamera};
use serde::Deserialize;
use serde_json::Value;

use super::euroc::pose_of_rows;
use super::{TESLA_PER_MICROTESLA, frame};
use crate::Error;
use crate::import::ImportConfig;
use crate::import::collected::{Collected, StreamId, measured};
use crate::import::payload::{Kind, Payload};
use crate::import::table::find;

/// Endings of videos.
const ENDINGS: [&str; 4] = ["mkv", "mp4", "mov", "avi"];
/// Stamps that an `f64` holds to the nanosecond and a recording takes, seconds.
const POSSIBLE_S: std::ops::Range<f64> = 0.0..2_147_483_648.0;

/// Types of sensors, topics, and what a recording's unit is in theirs.
const SENSORS: [(&str, &str, Kind, f64); 3] = [
    ("accelerometer", "accel", Kind::Vector, 1.0),
    ("gyroscope", "gyro", Kind::Vector, 1.0),
    ("magnetometer", "mag", Kind::Magnetic, TESLA_PER_MICROTESLA),
];

pub(super) fn read(
    source: &Path,
    config: &ImportConfig,
    into: &mut Collected,
) -> Result<(), Error> {
    let path = find(source, "data.jsonl").ok_or_else(|| Error::Recorded {
        path: source.to_owned(),
        problem: "it has no data.jsonl".to_owned(),
    })?;
    let table = into.table(&path)?;
    let sensors = SENSORS.map(|(what, topic, kind, _)| into.stream(what, topic, kind));
    let mut cameras: BTreeMap<usize, Option<(StreamId, usize)>> = BTreeMap::new();
    let mut frames: BTreeMap<usize, u64> = BTreeMap::new();
    let mut others: BTreeMap<String, u64> = BTreeMap::new();
    for (index, line) in table.text().lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let place = || format!("{}: line {}", table.name(), index + 1);
        let event: Value = match serde_json::from_str(line) {
            Ok(event) => event,
            Err(error) => {
                // Which kind it was is not known: it counts with the first.
                into.take(sensors[0], place, Err(format!("not JSON: {error}")));
                continue;
            }
        };
        let kind = event
            .get("sensor")
            .and_then(|s| s.get("type"))
            .and_then(Value::as_str);
        if let Some(which) = SENSORS.iter().position(|(name, ..)| kind == Some(name)) {
            let (_, _, kind, scale) = SENSORS[which];
            let record = sensor(&event, kind, scale).map(|(t, p)| measured(t, p));
            into.take(sensors[which], place, record);
        } else if let Some(list) = event.get("frames").and_then(Value::as_array) {
            for taken in list {
                let camera = taken.get("cameraInd").and_then(Value::as_u64).unwrap_or(0);
                let camera = usize::try_from(camera).unwrap_or(usize::MAX);
                let number = frames.entry(camera).or_default();
                let this = u32::try_from(*number).unwrap_or(u32::MAX);
                *number += 1;
                let open = cameras
                    .entry(camera)
                    .or_insert_with(|| open(source, camera, into));
                if let Some((stream, video)) = *open {
                    // A camera may have a stamp of its own.
                    let time = stamp(taken).or_else(|_| stamp(&event));
                    let image = Payload::Image(Box::new(frame(video, this)));
                    into.take(stream, place, time.map(|t| measured(t, image)));
                }
            }
        } else {
            let name = kind.map_or_else(
                || {
                    event
                        .as_object()
                        .and_then(|o| o.keys().find(|k| *k != "time"))
                        .cloned()
                        .unwrap_or_default()
                },
                str::to_owned,
            );
            *others.entry(name).or_default() += 1;
        }
    }
    into.combine(sensors[1], sensors[0]);
    for (camera, open) in cameras {
        if open.is_none() {
            let count = frames.get(&camera).copied().unwrap_or(0);
            into.leave_out(
                format!("frames of camera {camera}"),
                count,
                "their video is missing",
            );
        }
    }
    for (name, records) in others {
        let why = match name.as_str() {
            "groundTruth" => "ground truth stays in its file",
            _ => "cannot be held by a recording",
        };
        into.leave_out(format!("events `{name}`"), records, why);
    }
    match find(source, "calibration.json") {
        Some(path) => calibrate(&path, &config.device, into),
        None => Ok(()),
    }
}

/// The stream and the video of a camera: `data.mkv`, `data2.mkv`, ….
fn open(source: &Path, camera: usize, into: &mut Collected) -> Option<(StreamId, usize)> {
    let stem = match camera {
        0 => "data".to_owned(),
        n => format!("data{}", n.saturating_add(1)),
    };
    let names = ENDINGS
        .iter()
        .map(|ending| source.join(format!("{stem}.{ending}")));
    let video: PathBuf = names.into_iter().find(|path| path.is_file())?;
    into.videos.push(video);
    let stream = into.stream(
        format!("frames of camera {camera}"),
        &format!("cam{camera}/image"),
        Kind::Image,
    );
    Some((stream, into.videos.len() - 1))
}

fn stamp(event: &Value) -> Result<i64, String> {
    let time = event.get("time").and_then(Value::as_f64).ok_or("no time")?;
    match POSSIBLE_S.contains(&time) {
        true => Ok((time * 1e9).round() as i64),
        false => Err(format!("time {time} s: expected 0 to 2147483648 s")),
    }
}

fn sensor(event: &Value, kind: Kind, scale: f64) -> Result<(i64, Payload), String> {
    let values = event.get("sensor").and_then(|s| s.get("values"));
    let values: Vec<f64> = values
        .and_then(Value::as_array)
        .map(|list| list.iter().filter_map(Value::as_f64).collect())
        .unwrap_or_default();
    let [x, y, z] = values[..] else {
        return Err("not three numbers in values".to_owned());
    };
    let axes = [x, y, z].map(|v| v * scale);
    let payload = match kind {
        Kind::Magnetic => Payload::Magnetic(axes),
        _ => Payload::Vector(axes),
    };
    Ok((stamp(event)?, payload))
}

#[derive(Deserialize)]
struct Calibration {
    cameras: Vec<Calibrated>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Calibrated {
    focal_length_x: f64,
    focal_length_y: f64,
    principal_point_x: f64,
    principal_point_y: f64,
    #[serde(default)]
    model: String,
    #[serde(default)]
    distortion_coefficients: Vec<f64>,
    #[serde(alias = "imuToCameraMatrix")]
    imu_to_camera: Option<Vec<Vec<f64>>>,
    image_width: Option<u32>,
    image_height: Option<u32>,
}

fn calibrate(path: &Path, device: &str, into: &mut Collected) -> Result<(), Error> {
    let fail = |problem: String| Error::Recorded {
        path: path.to_owned(),
        problem,
    };
    let table = into.table(path)?;
    let calibration: Calibration =
        serde_json::from_str(table.text()).map_err(|e| fail(e.to_string()))?;
    let mut rig = Rig::empty(device);
    for (number, found) in calibration.cameras.iter().enumerate() {
        match camera(found) {
            Ok(camera) => {
                rig.cameras.insert(format!("cam{number}"), camera);
            }
            Err(why) => into
                .notes
                .push(format!("cam{number}: its calibration is left out: {why}")),
        }
    }
    if !rig.cameras.is_empty() {
        into.rig = Some(rig);
    }
    Ok(())
}

fn camera(found: &Calibrated) -> Result<RigCamera, String> {
    let (Some(width), Some(height)) = (found.image_width, found.image_height) else {
        return Err("it does not give the image size".to_owned());
    };
    let focal_px = [found.focal_length_x, found.focal_length_y];
    let principal_px = [found.principal_point_x, found.principal_point_y];
    let lens = match (
        found.model.as_str(),
        found.distortion_coefficients.as_slice(),
    ) {
        ("" | "pinhole", []) => Camera::pinhole(width, height, focal_px, principal_px).lens,
        ("" | "pinhole", &[k1, k2, k3]) => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [k1, k2, 0.0, 0.0, k3],
        },
        ("kannala-brandt4", &[k1, k2, k3, k4]) => Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [k1, k2, k3, k4],
        },
        ("brown-conrady", &[k1, k2, p1, p2, k3]) => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [k1, k2, p1, p2, k3],
        },
        (model, coefficients) => {
            return Err(format!(
                "{model} of {} coefficients is not supported",
                coefficients.len()
            ));
        }
    };
    let rows = found.imu_to_camera.as_ref().ok_or("no imuToCamera")?;
    let camera_from_imu =
        pose_of_rows(&rows.concat()).map_err(|why| format!("imuToCamera {why}"))?;
    Ok(RigCamera {
        camera: Camera {
            width,
            height,
            lens,
        },
        rig_from_camera: camera_from_imu.inverse(),
        timing: CameraTiming::default(),
        sigmas: Default::default(),
    })
}
