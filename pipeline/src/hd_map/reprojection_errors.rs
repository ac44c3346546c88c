//! How far from its keypoints each map point is seen.

use std::collections::{BTreeMap, HashMap};

use lsfb_geometry::{Rig, StampedPose, Vector3};
use lsfb_perception::statistics::median;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{KeyframeImage, MapPoint, PointObservation};
use crate::features::tracks::{Track, TrackedKeypoint};

/// How far keypoints lie from where their points are seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PixelResiduals {
    /// Keypoints of tracks that have a point.
    pub count: u64,
    /// Root mean square error, pixels: of the normal distribution that has the median of all of them, none left out.
    pub rms_px: f64,
    /// Share of them farther off than `max_reprojection_px`.
    pub outlier_share: f64,
}

/// Residuals of the images of one camera.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraResiduals {
    /// The camera.
    pub camera: String,
    /// With the poses of the start.
    pub before: PixelResiduals,
    /// With those of the map.
    pub after: PixelResiduals,
}

/// Images of keyframes, and where their cameras are.
#[derive(Clone, Copy)]
pub(crate) struct PlacedImages<'a> {
    pub rig: &'a Rig,
    pub keyframes: &'a [StampedPose],
    pub images: &'a [KeyframeImage],
}

/// Leaves out observations farther than `max_px` from where their point is seen, and points with fewer than two left;
/// brings the points' own errors up to date.
pub(crate) fn drop_outliers(placed: &PlacedImages, points: &mut Vec<MapPoint>, max_px: f64) {
    for point in points.iter_mut() {
        let position = point.point_in_world;
        let error = |o: &PointObservation| reprojection_px(placed, o, &position);
        point.observations.retain(|o| error(o) <= max_px);
        let squares: f64 = point.observations.iter().map(|o| error(o).powi(2)).sum();
        point.reprojection_rms_px = (squares / point.observations.len().max(1) as f64).sqrt();
    }
    points.retain(|p| p.observations.len() >= 2);
}

/// How far off one keypoint is.
#[derive(Clone, Copy)]
pub(crate) struct KeypointError {
    /// Index of its image.
    pub image: usize,
    pub px: f64,
}

/// Reprojection errors of every keypoint of every track that has a point, in order of the points: of those that the
/// triangulation left out, too. The image's diagonal stands for a point behind the camera.
pub(crate) fn track_errors(
    placed: &PlacedImages,
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
            let error_px = reprojection_px(placed, &seen, &point.point_in_world);
            KeypointError {
                image: seen.image,
                px: error_px.min(diagonal_px(placed, seen.image)),
            }
        })
    });
    errors.collect()
}

fn diagonal_px(placed: &PlacedImages, image: usize) -> f64 {
    let name = placed.images.get(image).map(|i| &i.camera);
    let mounted = name.and_then(|name| placed.rig.cameras.get(name));
    mounted.map_or(0.0, |m| {
        f64::from(m.camera.width).hypot(f64::from(m.camera.height))
    })
}

/// Reprojection errors of the observations that take part in Eq. (4), pixels.
pub(crate) fn observation_errors_px(placed: &PlacedImages, points: &[MapPoint]) -> Vec<f64> {
    points
        .iter()
        .flat_map(|p| p.observations.iter().map(move |o| (p, o)))
        .map(|(p, o)| reprojection_px(placed, o, &p.point_in_world))
        .collect()
}

/// Root mean square length of a two-dimensional normal error in units of its median length, 1/√(ln 2).
const RMS_PER_MEDIAN: f64 = 1.201_122_408_786_449_8;

/// How reprojection errors spread.
pub(crate) struct ErrorSummary {
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

impl PixelResiduals {
    /// Of all errors of one part of the images.
    pub(crate) fn of(errors_px: &[f64], max_px: f64) -> Self {
        let errors = ErrorSummary::of(errors_px, max_px);
        Self {
            count: errors_px.len() as u64,
            rms_px: errors.rms_px,
            outlier_share: errors.share_beyond,
        }
    }
}

/// What is left of the errors of each camera that has images, by its name.
pub(crate) fn residuals_by_camera(
    images: &[KeyframeImage],
    errors: &[KeypointError],
    max_px: f64,
) -> BTreeMap<String, PixelResiduals> {
    let mut of_cameras: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for image in images {
        of_cameras.entry(&image.camera).or_default();
    }
    for error in errors {
        let image = images.get(error.image);
        let of_camera = image.and_then(|image| of_cameras.get_mut(image.camera.as_str()));
        of_camera.into_iter().for_each(|all| all.push(error.px));
    }
    let residuals = of_cameras.into_iter();
    residuals
        .map(|(camera, errors)| (camera.to_owned(), PixelResiduals::of(&errors, max_px)))
        .collect()
}

/// Distance of where a point should be seen from where it is; infinite where it cannot be.
fn reprojection_px(
    placed: &PlacedImages,
    observation: &PointObservation,
    point_in_world: &Vector3<f64>,
) -> f64 {
    let error = || {
        let image = placed.images.get(observation.image)?;
        let keypoint = image
            .features
            .keypoints
            .get(observation.keypoint as usize)?;
        let mounted = placed.rig.cameras.get(&image.camera)?;
        let world_from_rig = placed.keyframes.get(image.keyframe)?.world_from_rig;
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
