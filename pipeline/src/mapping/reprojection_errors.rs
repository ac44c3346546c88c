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

/// Reprojection errors of every keypoint of every track that has a point, in order of the points: of those that the
/// triangulation left out, too. The image's diagonal stands for a point behind the camera.
pub(super) fn track_errors_px(
    rig: &Rig,
    keyframes: &Keyframes,
    points: &[MapPoint],
    tracks: &[Track],
) -> Vec<f64> {
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
            error_px.min(diagonal_px(rig, keyframes, seen.image))
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

/// How reprojection errors spread.
pub(super) struct ErrorSummary {
    /// Root mean square, each error counted with the limit at most.
    pub rms_px: f64,
    pub median_px: f64,
    /// Share beyond the limit.
    pub share_beyond: f64,
}

impl ErrorSummary {
    /// Of all errors: what is beyond `max_px` counts with that much, so that nothing is left out and a wrong match is no more than
    /// that.
    pub fn of(errors_px: &[f64], max_px: f64) -> Self {
        let count = errors_px.len().max(1) as f64;
        let squares: f64 = errors_px.iter().map(|e| e.min(max_px).powi(2)).sum();
        let beyond = errors_px.iter().filter(|e| **e > max_px).count();
        Self {
            rms_px: (squares / count).sqrt(),
            median_px: median(errors_px.to_vec()).unwrap_or(0.0),
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
        let good = ErrorSummary::of(&[0.5; 10], 3.0);
        assert!((good.rms_px - 0.5).abs() < 1e-12 && good.share_beyond == 0.0);
        let errors = [0.5, 0.5, 0.5, 700.0];
        let mixed = ErrorSummary::of(&errors, 3.0);
        assert!((mixed.rms_px - (9.75f64 / 4.0).sqrt()).abs() < 1e-12);
        assert_eq!((mixed.median_px, mixed.share_beyond), (0.5, 0.25));
        assert_eq!(ErrorSummary::of(&[], 3.0).rms_px, 0.0);
    }
}
