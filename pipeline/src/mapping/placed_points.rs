//! Points of tracks at the poses at hand, without those that can have no place.

use lsfb_geometry::Rig;

use super::MappingConfig;
use super::keyframes::Keyframes;
use crate::error::Error;
use crate::features::tracks::Track;
use crate::features::triangulation::{TriangulationConfig, has_no_place};
use crate::hd_map::{MapPoint, triangulate_tracks};

/// Points at the current poses: of observations far off while the poses are still wrong, of close ones later.
pub(super) fn triangulate_round(
    rig: &Rig,
    keyframes: &Keyframes,
    tracks: &[Track],
    round: usize,
    config: &MappingConfig,
) -> Result<Vec<MapPoint>, Error> {
    let slack = if round == 0 { 3.0 } else { 1.0 };
    let triangulation = TriangulationConfig {
        max_reprojection_px: slack * config.reconstruction.triangulation.max_reprojection_px,
        ..config.reconstruction.triangulation.clone()
    };
    let poses = keyframes.poses();
    let mut points = triangulate_tracks(rig, &poses, &keyframes.images, tracks, &triangulation)?;
    drop_misplaced(rig, keyframes, &mut points, &triangulation);
    Ok(points)
}

/// What stands nearer before a lens is a wrong match, metres: it would count as a measurement of micrometres, and leave the pose of
/// its camera undetermined beside all others.
const LEAST_DEPTH_M: f64 = 0.1;

/// Takes out points before a lens, and those so far away that they have no place.
pub(super) fn drop_misplaced(
    rig: &Rig,
    keyframes: &Keyframes,
    points: &mut Vec<MapPoint>,
    config: &TriangulationConfig,
) {
    points.retain(|point| {
        let cameras = keyframes.cameras_of(rig, point);
        keyframes.nearest_camera_m(rig, point) >= LEAST_DEPTH_M
            && !has_no_place(&point.point_in_world, cameras, config)
    });
}
