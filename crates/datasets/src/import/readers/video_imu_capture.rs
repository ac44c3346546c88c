//! VideoIMUCapture (DavidGillsjo): `video_recording.mp4` and `video_meta.pb3`, one protobuf message `VideoCaptureData` with all
//! samples and what is known of each frame. Stamps are nanoseconds since the phone was started.

use std::path::Path;

use lsfb_types::ImuSample;

use super::frame;
use super::protobuf::{Value, field};
use crate::Error;
use crate::import::collected::{Collected, StreamId, measured};
use crate::import::payload::{ImageRecord, Kind, Payload};

/// Fields of `VideoCaptureData`.
const CAMERA: u64 = 2;
const IMU: u64 = 4;
const FRAME: u64 = 5;

pub(super) fn read(source: &Path, into: &mut Collected) -> Result<(), Error> {
    let path = source.join("video_meta.pb3");
    let bytes = std::fs::read(&path).map_err(|e| crate::import::io(&path, e))?;
    into.used.insert(path);
    let video = source.join("video_recording.mp4");
    let imu = into.stream("imu of video_meta.pb3", "imu", Kind::Imu);
    let images = video
        .is_file()
        .then(|| into.stream("video_meta of video_meta.pb3", "cam0/image", Kind::Image));
    let [mut samples, mut frames] = [0_u64; 2];
    let mut rest = bytes.as_slice();
    while !rest.is_empty() {
        let at = bytes.len() - rest.len();
        let Ok((number, value, behind)) = field(rest) else {
            lose(
                into,
                imu,
                format!("video_meta.pb3: breaks off at byte {at}"),
            );
            break;
        };
        rest = behind;
        let Value::Bytes(message) = value else {
            continue;
        };
        let place = || format!("video_meta.pb3: byte {at}");
        match (number, images) {
            (IMU, _) => {
                samples += 1;
                into.take(imu, place, sample(message).map(|(t, p)| measured(t, p)));
            }
            (FRAME, Some(stream)) => {
                let record = image(message, into.videos.len(), frames);
                frames += 1;
                into.take(stream, place, record.map(|(t, p)| measured(t, p)));
            }
            (FRAME, None) => frames += 1,
            (CAMERA, _) => into.notes.push(
                "Android's lens calibration is left out because it is rarely right: calibrate it, or give --rig".to_owned(),
            ),
            _ => {}
        }
    }
    match images {
        Some(_) => into.videos.push(video),
        None => into.leave_out(
            "frames of video_meta.pb3",
            frames,
            "video_recording.mp4 is missing",
        ),
    }
    if samples > 0 {
        into.notes
            .push("imu: raw sensor values; Android's bias corrections are left out".to_owned());
    }
    Ok(())
}

fn lose(into: &mut Collected, stream: StreamId, why: String) {
    if let Some(stream) = into.streams.get_mut(stream) {
        stream.counts.read += 1;
        stream.lose(1, || why);
    }
}

fn sample(message: &[u8]) -> Result<(i64, Payload), String> {
    let (mut time_ns, mut gyro, mut accel) = (0, Vec::new(), Vec::new());
    each(message, |number, value| match number {
        1 => time_ns = value.int().unwrap_or_default(),
        2 => value.append_floats(&mut gyro),
        4 => value.append_floats(&mut accel),
        _ => {}
    })?;
    let axes = |values: &[f64], name: &str| match *values {
        [x, y, z] if [x, y, z].iter().all(|v| v.is_finite()) => Ok([x, y, z]),
        _ => Err(format!("{name} has not three finite numbers")),
    };
    let sample = ImuSample {
        angular_velocity_rad_s: axes(&gyro, "gyro")?,
        specific_force_m_s2: axes(&accel, "accel")?,
    };
    Ok((time_ns, Payload::Imu(sample)))
}

/// The phone stamps when the first row begins to be exposed; a recording the middle of the middle row.
fn image(message: &[u8], video: usize, number: u64) -> Result<(i64, Payload), String> {
    let [mut began_ns, mut exposure_ns, mut readout_ns] = [0; 3];
    each(message, |number, value| {
        let value = value.int().unwrap_or_default();
        match number {
            1 => began_ns = value,
            3 => exposure_ns = value,
            5 => readout_ns = value,
            _ => {}
        }
    })?;
    let known =
        |ns: i64| u32::try_from(ns).map_err(|_| format!("an exposure or readout of {ns} ns"));
    let middle_ns = (i64::from(known(exposure_ns)?) + i64::from(known(readout_ns)?)) / 2;
    let number = u32::try_from(number).map_err(|e| e.to_string())?;
    let image = ImageRecord {
        exposure_ns: known(exposure_ns)?,
        device_ns: began_ns.unsigned_abs(),
        ..frame(video, number)
    };
    Ok((
        began_ns.saturating_add(middle_ns),
        Payload::Image(Box::new(image)),
    ))
}

/// All fields of a message.
fn each(message: &[u8], mut take: impl FnMut(u64, Value<'_>)) -> Result<(), String> {
    let mut rest = message;
    while !rest.is_empty() {
        let (number, value, behind) = field(rest).map_err(|_| "a truncated message".to_owned())?;
        take(number, value);
        rest = behind;
    }
    Ok(())
}
