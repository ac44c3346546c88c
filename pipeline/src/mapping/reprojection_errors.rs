//! How far from its keypoints each map point is seen.

use std::collections::HashMap;

use lsfb_geometry::{Rig, Vector3};
use lsfb_perception::statistics::median;
use rayon::prelude::*;

use super::keyframes::Keyframes;
use crate::features::tracks::{Track, TrackedKeypoint};
use crate::hd_map::{MapPoint, PointObservation};

/// Leaves out observations farther than `max_px` from where their point is seen, and points with fewer than two left;
/// brings the points' own errors up to date.
pub(super) fn drop_outliers(
    rig: &Rig,
    keyframes: &Keyframes,
    points: &mut Vec<MapPoint>,
    max_px: f64,
) {
    for point in points.iter_mut() {
        let position = point.point_in_world;
        let error = |o: &PointObservation| reprojection_px(rig, keyframes, o, &position);
        point.observations.retain(|o| error(o) <= max_px);
        let squares: f64 = point.observations.iter().map(|o| error(o).powi(2)).sum();
        point.reprojection_rms_px = (squares / point.observations.len().max(1) as f64).sqrt();
    }
    points.retain(|p| p.observations.len() >= 2);
}

/// How far off one keypoint is.
#[derive(Clone, Copy)]
pub(super) struct KeypointError {
    /// Index of its image.
    pub image: usize,
    pub px: f64,
}

/// Reprojection errors of every keypoint of every track that has a point, in order of the points: of those that the
/// triangulation left out, too. The image's diagonal stands for a point behind the camera.
pub(super) fn track_errors(
    rig: &Rig,
    keyframes: &Keyframes,
    points: &[MapPoint],
    tracks: &[Track],
) -> Vec<KeypointError> {
    let keypoint = |o: &PointObservation| TrackedKeypoint {
        image: o.image as u32,
        keypoint: o.keypoint,
    };
    let track_of: HashMap<TrackedKeypoint, usize> = tracks
        .iter()
        .enumerate()
        .flat_map(|(i, track)| track.keypoints.iter().map(move |k| (*k, i)))
        .collect();
    let errors = points.par_iter().flat_map_iter(|point| {
        let first = point.observations.first().map(keypoint);
        let track = first.and_then(|k| tracks.get(*track_of.get(&k)?));
        let keypoints = track.map(|t| t.keypoints.as_slice()).unwrap_or_default();
        keypoints.iter().map(move |k| {
            let seen = PointObservation {
                image: k.image as usize,
                keypoint: k.keypoint,
            };
            let error_px = reprojection_px(rig, keyframes, &seen, &point.point_in_world);
            KeypointError {
                image: seen.image,
                px: error_px.min(diagonal_px(rig, keyframes, seen.image)),
            }
        })
    });
    errors.collect()
}

fn diagonal_px(rig: &Rig, keyframes: &Keyframes, image: usize) -> f64 {
    let name = keyframes.images.get(image).map(|i| &i.camera);
    let mounted = name.and_then(|name| rig.cameras.get(name));
    mounted.map_or(0.0, |m| {
        f64::from(m.camera.width).hypot(f64::from(m.camera.height))
    })
}

/// Reprojection errors of the observations that take part in Eq. (4), pixels.
pub(super) fn observation_errors_px(
    rig: &Rig,
    keyframes: &Keyframes,
    points: &[MapPoint],
) -> Vec<f64> {
    points
        .iter()
        .flat_map(|p| p.observations.iter().map(move |o| (p, o)))
        .map(|(p, o)| reprojection_px(rig, keyframes, o, &p.point_in_world))
        .collect()
}

/// Root mean square length of a two-dimensional normal error in units of its median length, 1/√(ln 2).
const RMS_PER_MEDIAN: f64 = 1.201_122_408_786_449_8;

/// How reprojection errors spread.
pub(super) struct ErrorSummary {
    /// Root mean square of the normal distribution that has their median.
    pub rms_px: f64,
    pub median_px: f64,
    /// Share beyond the limit.
    pub share_beyond: f64,
}

impl ErrorSummary {
    /// Of all errors. None is left out, and how far off a wrong match is makes no difference: its share does.
    pub fn of(errors_px: &[f64], max_px: f64) -> Self {
        let count = errors_px.len().max(1) as f64;
        let beyond = errors_px.iter().filter(|e| **e > max_px).count();
        let median_px = median(errors_px.to_vec()).unwrap_or(0.0);
        Self {
            rms_px: median_px * RMS_PER_MEDIAN,
            median_px,
            share_beyond: beyond as f64 / count,
        }
    }
}

/// Distance of where a point should be seen from where it is; infinite where it cannot be.
fn reprojection_px(
    rig: &Rig,
    keyframes: &Keyframes,
    observation: &PointObservation,
    point_in_world: &Vector3<f64>,
) -> f64 {
    let error = || {
        let image = keyframes.images.get(observation.image)?;
        let keypoint = image
            .features
            .keypoints
            .get(observation.keypoint as usize)?;
        let mounted = rig.cameras.get(&image.camera)?;
        let world_from_rig = keyframes.frames.get(image.keyframe)?.world_from_rig;
        let camera_from_world = (world_from_rig * mounted.rig_from_camera).inverse();
        let pixel = mounted
            .camera
            .project(&(camera_from_world * *point_in_world))?;
        Some((pixel - keypoint.pixel_f64()).norm())
    };
    error().unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors cut off at 3 px would be 0.5 px rms whatever share of the matches is wrong.
    #[test]
    fn what_is_far_off_counts() {
        // 0.1 to 1.0 px, and as many more that are wrong.
        let mut errors: Vec<f64> = (1..=10).map(|i| 0.1 * f64::from(i)).collect();
        let good = ErrorSummary::of(&errors, 3.0);
        assert!((good.rms_px - 0.6 * RMS_PER_MEDIAN).abs() < 1e-12 && good.share_beyond == 0.0);
        errors.extend([700.0; 3]);
        let some = ErrorSummary::of(&errors, 3.0);
        assert!(some.rms_px > good.rms_px && some.rms_px < 1.0);
        assert!((some.share_beyond - 3.0 / 13.0).abs() < 1e-12);
        errors.extend([700.0; 10]);
        assert!(ErrorSummary::of(&errors, 3.0).rms_px > 700.0);
        assert_eq!(ErrorSummary::of(&[], 3.0).rms_px, 0.0);
    }
}
