//! What a recording holds of each of its cameras.

use lsfb_geometry::{Rig, RigCamera, Vector2};
use lsfb_recording::{Recording, message};
use lsfb_types::{Progress, ProgressFn, Timestamp};
use serde::Serialize;

use crate::Error;
use crate::slam_bench::camera_name;

/// Steps longer than this many medians are gaps.
const GAP: f64 = 1.5;

/// Images of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImageFigures {
    /// Each camera.
    pub cameras: Vec<CameraFigures>,
    /// Stamps and exposure times, nanoseconds, of the first camera.
    #[serde(skip)]
    pub exposures: Vec<(Timestamp, u32)>,
}

/// Images of one camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraFigures {
    /// Its topic.
    pub topic: String,
    /// Number of images.
    pub frames: u64,
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    /// Images per second, by the median step.
    pub rate_hz: f64,
    /// Steps longer than one and a half medians.
    pub gaps: u64,
    /// Images whose stamp is not behind that of the image before.
    pub not_rising: u64,
    /// The longest step, seconds.
    pub longest_gap_s: f64,
    /// Angle of view along x and y, degrees; absent where no rig is known.
    pub view_deg: Option<[f64; 2]>,
    /// Whether rows are read one after another; absent where no rig is known.
    pub is_rolling: Option<bool>,
}

/// Looks at every image.
pub fn image_figures(
    recording: &Recording,
    rig: Option<&Rig>,
    progress: ProgressFn<'_>,
) -> Result<ImageFigures, Error> {
    let topics = recording.topics().iter();
    let topics: Vec<_> = topics
        .filter(|t| t.schema == message::IMAGE.name && t.messages > 0)
        .collect();
    let mut found = ImageFigures {
        cameras: Vec::new(),
        exposures: Vec::new(),
    };
    for topic in topics {
        let mut exposures = Vec::new();
        let mut size_px = [0; 2];
        for image in recording.images(&topic.topic)? {
            let image = image?;
            size_px = [image.sample.width, image.sample.height];
            exposures.push((image.time, image.sample.exposure_ns));
            progress(Progress {
                stage: "measuring images",
                done: exposures.len() as u64,
                total: topic.messages,
            })?;
        }
        let mounted = rig.and_then(|rig| rig.cameras.get(camera_name(&topic.topic)));
        found
            .cameras
            .push(of_camera(&topic.topic, &exposures, size_px, mounted));
        if found.exposures.is_empty() {
            found.exposures = exposures;
        }
    }
    Ok(found)
}

fn of_camera(
    topic: &str,
    exposures: &[(Timestamp, u32)],
    size_px: [u32; 2],
    mounted: Option<&RigCamera>,
) -> CameraFigures {
    let steps = exposures.windows(2).map(|w| w[1].0.secs_since(w[0].0));
    let mut steps: Vec<f64> = steps.collect();
    steps.sort_by(f64::total_cmp);
    let median_s = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    CameraFigures {
        topic: topic.to_owned(),
        frames: exposures.len() as u64,
        size_px,
        rate_hz: if median_s > 0.0 { 1.0 / median_s } else { 0.0 },
        gaps: steps.iter().filter(|s| **s > GAP * median_s).count() as u64,
        not_rising: steps.iter().filter(|s| **s <= 0.0).count() as u64,
        longest_gap_s: steps.last().copied().unwrap_or(0.0),
        view_deg: mounted.and_then(view_deg),
        is_rolling: mounted.map(|m| m.timing.readout_s != 0.0),
    }
}

/// Angles between the rays of opposite borders' middles.
fn view_deg(mounted: &RigCamera) -> Option<[f64; 2]> {
    let camera = &mounted.camera;
    let [width, height] = [camera.width, camera.height].map(|side| f64::from(side) - 1.0);
    let [cx, cy] = camera.principal_px();
    let between = |a: [f64; 2], b: [f64; 2]| {
        let ray = |pixel: [f64; 2]| camera.unproject(&Vector2::from(pixel));
        Some(ray(a)?.angle(&ray(b)?).to_degrees())
    };
    Some([
        between([0.0, cy], [width, cy])?,
        between([cx, 0.0], [cx, height])?,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By the median and the longest step nothing is wrong with it.
    #[test]
    fn a_stamp_that_goes_back_or_stands_is_counted() {
        let figures = |millis: &[i64]| {
            let at = |ms: &i64| (Timestamp::from_nanos(ms * 1_000_000), 0);
            let exposures: Vec<_> = millis.iter().map(at).collect();
            of_camera("/cam0/image", &exposures, [64, 48], None)
        };
        let right = figures(&[0, 33, 66, 100, 133, 166]);
        assert_eq!(right.not_rising, 0);
        let back = figures(&[0, 33, 66, 40, 73, 106]);
        assert_eq!((back.not_rising, back.longest_gap_s), (1, 0.033));
        assert_eq!(back.rate_hz, right.rate_hz);
        assert_eq!(figures(&[0, 33, 33, 66, 100]).not_rising, 1);
    }
}
