//! Points from images whose poses are known: neighbours, matches, tracks, triangulation.

use std::collections::BTreeSet;

use lsfb_geometry::{Rig, Se3, StampedPose, Vector3};
use lsfb_types::{ProgressFn, SharedProgress, Stopped};
use rayon::prelude::*;

use super::contradicted::contradicted;
use super::prepared_image::{
    KeyframeImage, PlacedImage, PreparedImage, match_pair, place, prepare,
};
use super::reconstruction_config::ReconstructionConfig;
use super::scene_depth::{depth_pairs, scene_depth};
use crate::error::{Error, MIN_MAP_POINTS, Refusal};
use crate::features::tracks::{ImagePair, Track, build_tracks};
use crate::features::triangulation::{TriangulationConfig, View, triangulate};

/// A keypoint that shows a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PointObservation {
    /// Index of the image.
    pub image: usize,
    /// Index of the keypoint in it.
    pub keypoint: u32,
}

/// A triangulated point and where it was seen.
#[derive(Clone, Debug, PartialEq)]
pub struct MapPoint {
    /// Position, metres.
    pub point_in_world: Vector3<f64>,
    /// The keypoints that show it, by image, at most one in each.
    pub observations: Vec<PointObservation>,
    /// Root mean square of its reprojection errors, pixels.
    pub reprojection_rms_px: f64,
}

/// Views that make a point certain: any two meet somewhere by chance, whatever their poses.
pub(crate) const CERTAIN_VIEWS: usize = 3;

/// Indices of poses that differ from the last chosen one by at least `min_distance`, in the unit of the poses, or
/// `min_angle_deg`; the first is always chosen.
pub fn select_keyframes(poses: &[Se3], min_distance: f64, min_angle_deg: f64) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    for (index, pose) in poses.iter().enumerate() {
        let far = chosen.last().is_none_or(|last| {
            let moved = poses[*last].inverse() * *pose;
            moved.translation.norm() >= min_distance
                || moved.rotation.angle() >= min_angle_deg.to_radians()
        });
        if far {
            chosen.push(index);
        }
    }
    chosen
}

/// Matches images whose cameras are near one another, joins the matches into tracks and triangulates them with the
/// keyframes' poses. Points come in order of their first observation.
pub fn reconstruct(
    rig: &Rig,
    keyframes: &[StampedPose],
    images: &[KeyframeImage],
    config: &ReconstructionConfig,
    progress: ProgressFn,
) -> Result<Vec<MapPoint>, Error> {
    let tracks = find_tracks(rig, keyframes, images, config, progress)?;
    triangulate_tracks(rig, keyframes, images, &tracks, &config.triangulation)
}

/// The first half of [`reconstruct`]: keypoints that show the same thing.
pub fn find_tracks(
    rig: &Rig,
    keyframes: &[StampedPose],
    images: &[KeyframeImage],
    config: &ReconstructionConfig,
    progress: ProgressFn,
) -> Result<Vec<Track>, Error> {
    let prepared: Vec<PreparedImage> = images
        .par_iter()
        .map(|image| prepare(rig, keyframes, image))
        .collect::<Result<_, _>>()?;
    let depth = depth_of(&prepared, config)?;
    let pairs = choose_pairs(&prepared, depth, config);
    let done = SharedProgress::new("image matching", pairs.len(), progress);
    let matched: Result<Vec<ImagePair>, Stopped> = pairs
        .par_iter()
        .map(|&(first, second)| {
            let pair = match_pair(&prepared, first, second, config);
            done.one_more()?;
            Ok(pair)
        })
        .collect();
    // Descriptors as they are compared: of a long walk gigabytes.
    drop(prepared);
    let counts: Vec<usize> = images.iter().map(|i| i.features.len()).collect();
    let min_views = config.triangulation.min_views.max(2);
    Ok(build_tracks(&counts, &matched?, min_views))
}

/// How deep the scene is that images show, in the unit of the poses.
pub(super) fn depth_of_images(
    rig: &Rig,
    keyframes: &[StampedPose],
    images: &[KeyframeImage],
    config: &ReconstructionConfig,
) -> Result<f64, Error> {
    let prepared: Vec<PreparedImage> = images
        .par_iter()
        .map(|image| prepare(rig, keyframes, image))
        .collect::<Result<_, _>>()?;
    depth_of(&prepared, config)
}

/// What images say against their poses, in words; `None` where they agree.
pub(super) fn contradiction(
    rig: &Rig,
    keyframes: &[StampedPose],
    images: &[KeyframeImage],
    config: &ReconstructionConfig,
) -> Result<Option<String>, Error> {
    let prepared: Vec<PreparedImage> = images
        .par_iter()
        .map(|image| prepare(rig, keyframes, image))
        .collect::<Result<_, _>>()?;
    Ok(contradicted(&prepared, config))
}

/// Refuses what is no map. Only certain points count.
pub(crate) fn expect_map(points: &[MapPoint], images: &[KeyframeImage]) -> Result<(), Error> {
    let is_certain = |p: &&MapPoint| p.observations.len() >= CERTAIN_VIEWS;
    let confirmed = points.iter().filter(is_certain).count();
    if confirmed >= MIN_MAP_POINTS {
        return Ok(());
    }
    let features = images.iter().map(|i| i.features.len()).sum();
    Err(Refusal::too_few_points(confirmed, images.len(), features, false).into())
}

fn depth_of(images: &[PreparedImage], config: &ReconstructionConfig) -> Result<f64, Error> {
    let poses: Vec<Se3> = images.iter().map(|i| i.placed.world_from_camera).collect();
    let pairs = depth_pairs(&poses, config);
    scene_depth(images, &pairs, config).ok_or_else(|| {
        let features: usize = images.iter().map(|i| i.rays.len()).sum();
        Refusal::too_few_points(0, images.len(), features, pairs.is_empty()).into()
    })
}

/// The second half of [`reconstruct`], to be repeated when the keyframes have moved. Tracks must be those of these images.
pub fn triangulate_tracks(
    rig: &Rig,
    keyframes: &[StampedPose],
    images: &[KeyframeImage],
    tracks: &[Track],
    config: &TriangulationConfig,
) -> Result<Vec<MapPoint>, Error> {
    let placed: Vec<PlacedImage> = images
        .iter()
        .map(|image| place(rig, keyframes, image))
        .collect::<Result<_, _>>()?;
    let points = tracks.par_iter().filter_map(|track| {
        let views: Vec<View> = track
            .keypoints
            .iter()
            .map(|k| placed.get(k.image as usize)?.view(k.keypoint))
            .collect::<Option<_>>()?;
        let found = triangulate(&views, config).ok()?;
        let observation = |index: &usize| {
            let k = &track.keypoints[*index];
            PointObservation {
                image: k.image as usize,
                keypoint: k.keypoint,
            }
        };
        Some(MapPoint {
            point_in_world: found.point_in_world,
            observations: found.inliers.iter().map(observation).collect(),
            reprojection_rms_px: found.reprojection_rms_px,
        })
    });
    Ok(points.collect())
}

/// For each image the neighbours most like it in place and direction, as ordered pairs without repetition.
fn choose_pairs(
    images: &[PreparedImage],
    depth: f64,
    config: &ReconstructionConfig,
) -> Vec<(usize, usize)> {
    let mut pairs = BTreeSet::new();
    for (i, a) in images.iter().enumerate() {
        let mut ranked: Vec<(f64, usize)> = images
            .iter()
            .enumerate()
            .filter_map(|(j, b)| Some((unlikeness(a, b, depth, config)?, j)).filter(|_| j != i))
            .collect();
        ranked.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        let nearest = ranked.iter().take(config.neighbours);
        pairs.extend(nearest.map(|(_, j)| (i.min(*j), i.max(*j))));
    }
    pairs.into_iter().collect()
}

/// How little two images promise for matching; `None` where they should not be matched.
fn unlikeness(
    a: &PreparedImage,
    b: &PreparedImage,
    depth: f64,
    config: &ReconstructionConfig,
) -> Option<f64> {
    let second_from_first = b.placed.world_from_camera.inverse() * a.placed.world_from_camera;
    let baseline_per_depth = second_from_first.translation.norm() / depth;
    let axis = second_from_first.rotation * Vector3::z();
    let angle_deg = axis.z.clamp(-1.0, 1.0).acos().to_degrees();
    let usable = baseline_per_depth >= config.min_baseline_per_depth
        && baseline_per_depth <= config.max_baseline_per_depth
        && angle_deg <= config.max_axis_angle_deg;
    usable.then(|| {
        (baseline_per_depth / config.best_baseline_per_depth)
            .ln()
            .abs()
            + angle_deg / 20.0
    })
}
