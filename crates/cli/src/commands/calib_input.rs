//! What calibration steps read: images, samples of the IMU, and when they were recorded.

use std::path::Path;

use lsfb_calib::Target;
use lsfb_calib::camera::{CameraViews, views_from_folder, views_from_recording};
use lsfb_calib::camera_imu::read_imu_table;
use lsfb_recording::Recording;
use lsfb_types::{ImuSample, Timestamp};

use crate::context::Context;

/// What a camera saw: `NAME` in the recording, `NAME=FOLDER` or `NAME=FOLDER/PREFIX*`.
pub fn views_of(
    camera: &str,
    recording: Option<&Recording>,
    target: &Target,
    context: &Context,
) -> anyhow::Result<CameraViews> {
    context.check_stop()?;
    let show = |p| context.show(p);
    Ok(match (camera.split_once('='), recording) {
        (Some((name, place)), _) => {
            let (folder, prefix) = folder_and_prefix(place);
            views_from_folder(name, folder, prefix, target, &show)?
        }
        (None, Some(recording)) => views_from_recording(camera, recording, target, &show)?,
        (None, None) => {
            anyhow::bail!("camera {camera} has no images: give NAME=FOLDER, or --recording")
        }
    })
}

/// The IMU's samples: of a table if there is one, else of the recording.
pub fn imu_of(
    table: Option<&Path>,
    recording: Option<&Recording>,
) -> anyhow::Result<Vec<(Timestamp, ImuSample)>> {
    Ok(match (table, recording) {
        (Some(path), _) => read_imu_table(path)?,
        (None, Some(recording)) => recording
            .imu()?
            .map(|s| s.map(|s| (s.time, s.sample)))
            .collect::<Result<_, _>>()?,
        (None, None) => anyhow::bail!("there is no IMU: give --imu or --recording"),
    })
}

/// 1 January 2000 in seconds since 1970: stamps before it count from the start of something.
const YEAR_2000_UNIX_S: i64 = 946_684_800;

/// When the data of a step ended, for `Rig::calibrated_unix_s`: the end of the recording, else the last of `stamps_ns`. `None`
/// where that is no time of day.
pub fn calibrated_unix_s(
    recording: Option<&Recording>,
    stamps_ns: impl Iterator<Item = i64>,
) -> anyhow::Result<Option<i64>> {
    let end_ns = match recording {
        Some(recording) => recording.end_time()?.map(Timestamp::nanos),
        None => stamps_ns.max(),
    };
    let end_s = end_ns.map(|ns| ns.div_euclid(1_000_000_000));
    Ok(end_s.filter(|s| *s >= YEAR_2000_UNIX_S))
}

/// `FOLDER` or `FOLDER/PREFIX*`.
fn folder_and_prefix(place: &str) -> (&Path, &str) {
    let Some(pattern) = place.strip_suffix('*') else {
        return (Path::new(place), "");
    };
    match pattern.rsplit_once('/') {
        Some((folder, prefix)) => (Path::new(folder), prefix),
        None => (Path::new("."), pattern),
    }
}
