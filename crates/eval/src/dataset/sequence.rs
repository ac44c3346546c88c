//! All that is measured of one sequence.

use lsfb_geometry::{Rig, StampedPose, Trajectory, Vector3};
use lsfb_recording::{Recording, message};
use lsfb_types::{ProgressFn, Timestamp, median, quantile};
use serde::Serialize;

use super::description::QueryEntry;
use super::folder::DatasetFolder;
use super::images::{ImageFigures, image_figures};
use super::motion::{MotionFigures, motion_figures};
use crate::{Error, read_poses};

/// All that is measured of one sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SequenceFigures {
    /// As it was planned.
    pub planned: QueryEntry,
    /// What was recorded.
    pub images: ImageFigures,
    /// Inertial samples.
    pub inertial_samples: u64,
    /// Readings of access points.
    pub wifi_readings: u64,
    /// Readings of beacons.
    pub ble_readings: u64,
    /// How it moved; absent where the truth is held back.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<MotionFigures>,
    /// Blur by turning during the exposure, median and 95 %, pixels; absent where the truth is held back or exposure times are not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blur_px: Option<[f64; 2]>,
}

/// Measures the recording of a sequence; its truth, where it is there.
pub fn measure(
    folder: &DatasetFolder,
    planned: &QueryEntry,
    recording: &Recording,
    progress: ProgressFn<'_>,
) -> Result<SequenceFigures, Error> {
    let rig = recording.rig().ok();
    let images = image_figures(recording, rig.as_ref(), progress)?;
    let count = |schema: &str| {
        let topics = recording.topics().iter();
        topics
            .filter(|t| t.schema == schema)
            .map(|t| t.messages)
            .sum()
    };
    let truth = folder.walk_truth(&planned.name);
    let poses = match truth.exists() {
        true => read_poses(&truth)?,
        false => Vec::new(),
    };
    let view = rig.as_ref().map_or(Vector3::x(), view_in_rig);
    Ok(SequenceFigures {
        planned: planned.clone(),
        inertial_samples: count(message::IMU.name),
        wifi_readings: count(message::WIFI_READING.name),
        ble_readings: count(message::BLE_ADVERT.name),
        motion: motion_figures(&poses, &view),
        blur_px: rig.as_ref().and_then(|rig| blur_px(&images, &poses, rig)),
        images,
    })
}

/// Where the cameras look together: ahead where they look all around.
fn view_in_rig(rig: &Rig) -> Vector3<f64> {
    let axes = rig
        .cameras
        .values()
        .map(|c| c.rig_from_camera.rotation * Vector3::z());
    let sum: Vector3<f64> = axes.sum();
    match sum.norm() > 0.1 * rig.cameras.len() as f64 && !rig.cameras.is_empty() {
        true => sum.normalize(),
        false => Vector3::x(),
    }
}

/// How far the middle of the image moves while it is exposed, by turning alone.
fn blur_px(images: &ImageFigures, poses: &[StampedPose], rig: &Rig) -> Option<[f64; 2]> {
    let focal_px = rig.cameras.values().next()?.camera.focal_px()[0];
    let trajectory = Trajectory::new(poses.to_vec());
    let blurs: Vec<f64> = images
        .exposures
        .iter()
        .filter(|(_, exposure_ns)| *exposure_ns > 0)
        .filter_map(|(time, exposure_ns)| {
            let half_ns = i64::from(*exposure_ns) / 2;
            let at = |ns: i64| trajectory.at(Timestamp::from_nanos(time.nanos() + ns));
            let (before, after) = (at(-half_ns)?, at(half_ns)?);
            Some(before.rotation.angle_to(&after.rotation) * focal_px)
        })
        .collect();
    Some([median(blurs.clone())?, quantile(blurs, 0.95)?])
}
