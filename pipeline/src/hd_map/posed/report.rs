//! What is said of a map of posed images.

use serde::{Deserialize, Serialize};

use super::super::{
    CameraResiduals, ErrorSummary, KeypointError, MapPoint, PlacedImages, residuals_by_camera,
    track_errors, triangulate_tracks,
};
use crate::Error;
use crate::features::tracks::Track;
use crate::features::triangulation::TriangulationConfig;

/// How a map of posed images fits them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PosedMapReport {
    /// Keyframes.
    pub keyframes: u64,
    /// Images of the keyframes.
    pub images: u64,
    /// Features in those images.
    pub features: u64,
    /// Tracks before triangulation.
    pub tracks: u64,
    /// Points in the map.
    pub points: u64,
    /// Observations of those points.
    pub observations: u64,
    /// Observations left out of the map because their point is seen elsewhere; they count in the reprojection error.
    pub dropped_observations: u64,
    /// Root mean square reprojection error as [`PixelResiduals::rms_px`](super::super::PixelResiduals::rms_px) has it, of every
    /// observation of every track that has a point, those left out of the map among them.
    pub reprojection_rms_px: f64,
    /// Median reprojection error of the same observations, pixels.
    pub reprojection_median_px: f64,
    /// Share of them farther off than `triangulation.max_reprojection_px`.
    pub outlier_share: f64,
    /// The same with the cameras and poses of the list; absent where the map has these.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub as_listed: Option<ListedErrors>,
    /// Reprojection errors by camera; those before with the cameras and poses of the list, of no observation where the map has these.
    pub by_camera: Vec<CameraResiduals>,
    /// Reprojection error of each observation, pixels; the image's diagonal where a point lies behind the camera.
    #[serde(skip)]
    pub reprojection_errors_px: Vec<f64>,
}

/// Reprojection errors of the same tracks, with points as cameras and poses of the list give them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ListedErrors {
    /// Root mean square, pixels.
    pub reprojection_rms_px: f64,
    /// Median, pixels.
    pub reprojection_median_px: f64,
    /// Share beyond `triangulation.max_reprojection_px`.
    pub outlier_share: f64,
}

impl PosedMapReport {
    /// Of points as the map has them, of these tracks; `listed` are the images with the cameras and poses of the list, where the map has others.
    pub(super) fn of(
        placed: &PlacedImages,
        listed: Option<&PlacedImages>,
        points: &[MapPoint],
        tracks: &[Track],
        config: &TriangulationConfig,
    ) -> Result<Self, Error> {
        let max_px = config.max_reprojection_px;
        let errors = track_errors(placed, points, tracks);
        let before = listed.map(|listed| {
            let points =
                triangulate_tracks(listed.rig, listed.keyframes, listed.images, tracks, config)?;
            Ok::<_, Error>(track_errors(listed, &points, tracks))
        });
        let before = before.transpose()?;
        let none = Vec::new();
        let of_cameras = |errors: &[KeypointError]| {
            residuals_by_camera(placed.images, errors, max_px).into_iter()
        };
        let by_camera = of_cameras(before.as_ref().unwrap_or(&none)).zip(of_cameras(&errors));
        let by_camera = by_camera.map(|((camera, before), (_, after))| CameraResiduals {
            camera,
            before,
            after,
        });
        let of_all = |errors: &[KeypointError]| ErrorSummary::of(&pixels(errors), max_px);
        let after = of_all(&errors);
        let observations = points.iter().map(|p| p.observations.len()).sum::<usize>();
        Ok(Self {
            keyframes: placed.keyframes.len() as u64,
            images: placed.images.len() as u64,
            features: placed.images.iter().map(|i| i.features.len() as u64).sum(),
            tracks: tracks.len() as u64,
            points: points.len() as u64,
            observations: observations as u64,
            dropped_observations: errors.len().saturating_sub(observations) as u64,
            reprojection_rms_px: after.rms_px,
            reprojection_median_px: after.median_px,
            outlier_share: after.share_beyond,
            as_listed: before.map(|errors| {
                let before = of_all(&errors);
                ListedErrors {
                    reprojection_rms_px: before.rms_px,
                    reprojection_median_px: before.median_px,
                    outlier_share: before.share_beyond,
                }
            }),
            by_camera: by_camera.collect(),
            reprojection_errors_px: pixels(&errors),
        })
    }
}

fn pixels(errors: &[KeypointError]) -> Vec<f64> {
    errors.iter().map(|error| error.px).collect()
}
