//! Points from images whose poses are known: neighbours, matches, tracks, triangulation.

use std::collections::BTreeSet;

use lsfb_geometry::{Rig, RigCamera, Se3, StampedPose, Vector3};
use lsfb_types::{Bounds, Progress, ProgressFn, Stopped};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::Error;
use crate::features::matching::{DescriptorSet, MatchConfig, RayFeatures, match_epipolar};
use crate::features::tracks::{ImagePair, Track, build_tracks};
use crate::features::triangulation::{TriangulationConfig, View, triangulate};
use crate::features::{Features, Keypoint};

/// One camera's image of a keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframeImage {
    /// Index of the keyframe.
    pub keyframe: usize,
    /// Name of the camera on the rig.
    pub camera: String,
    /// Its features.
    pub features: Features,
}

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

/// Configuration of [`reconstruct`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReconstructionConfig {
    /// Images with which each image is matched.
    pub neighbours: usize,
    /// Distance of two cameras that is best for matching, metres.
    pub best_baseline_m: f64,
    /// Cameras nearer than this are not matched, metres.
    pub min_baseline_m: f64,
    /// Cameras farther apart are not matched, metres.
    pub max_baseline_m: f64,
    /// Cameras whose axes differ by more are not matched, degrees.
    pub max_axis_angle_deg: f64,
    /// Largest distance of a match from its epipolar plane, pixels at the image's centre.
    pub max_epipolar_px: f64,
    /// Descriptor matching.
    pub matching: MatchConfig,
    /// Triangulation.
    pub triangulation: TriangulationConfig,
}

impl Default for ReconstructionConfig {
    fn default() -> Self {
        Self {
            neighbours: 10,
            best_baseline_m: 0.4,
            min_baseline_m: 0.04,
            max_baseline_m: 2.5,
            max_axis_angle_deg: 50.0,
            max_epipolar_px: 2.0,
            matching: MatchConfig::default(),
            triangulation: TriangulationConfig::default(),
        }
    }
}

lsfb_types::bounds! {
    ReconstructionConfig {
        neighbours: any,
        best_baseline_m: number(Bounds::POSITIVE),
        min_baseline_m: number(Bounds::NOT_NEGATIVE),
        max_baseline_m: number(Bounds::NOT_NEGATIVE),
        max_axis_angle_deg: number(Bounds::NOT_NEGATIVE),
        max_epipolar_px: number(Bounds::POSITIVE),
        matching: section,
        triangulation: section,
    }
}

/// Indices of poses that differ from the last chosen one by at least `min_distance_m` or `min_angle_deg`; the first is
/// always chosen.
pub fn select_keyframes(poses: &[Se3], min_distance_m: f64, min_angle_deg: f64) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    for (index, pose) in poses.iter().enumerate() {
        let far = chosen.last().is_none_or(|last| {
            let moved = poses[*last].inverse() * *pose;
            moved.translation.norm() >= min_distance_m
                || moved.rotation.angle() >= min_angle_deg.to_radians()
        });
        if far {
            chosen.push(index);
        }
    }
    chosen
}

/// An image and where it was taken.
struct PlacedImage<'a> {
    mounted: &'a RigCamera,
    world_from_camera: Se3,
    keypoints: &'a [Keypoint],
}

/// An image with everything its matching needs.
struct PreparedImage<'a> {
    placed: PlacedImage<'a>,
    descriptors: DescriptorSet,
    rays: Vec<Vector3<f64>>,
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
    let pairs = choose_pairs(&prepared, config);
    let done = AtomicU64::new(0);
    let matched: Result<Vec<ImagePair>, Stopped> = pairs
        .par_iter()
        .map(|&(first, second)| {
            let pair = match_pair(&prepared, first, second, config);
            progress(Progress {
                stage: "image matching",
                done: done.fetch_add(1, Ordering::Relaxed) + 1,
                total: pairs.len() as u64,
            })?;
            Ok(pair)
        })
        .collect();
    let counts: Vec<usize> = images.iter().map(|i| i.features.len()).collect();
    let min_views = config.triangulation.min_views.max(2);
    Ok(build_tracks(&counts, &matched?, min_views))
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
            .map(|k| {
                let image = placed.get(k.image as usize)?;
                Some(View {
                    camera: &image.mounted.camera,
                    world_from_camera: image.world_from_camera,
                    pixel: image.keypoints.get(k.keypoint as usize)?.pixel_f64(),
                })
            })
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

fn place<'a>(
    rig: &'a Rig,
    keyframes: &[StampedPose],
    image: &'a KeyframeImage,
) -> Result<PlacedImage<'a>, Error> {
    let unknown = || Error::UnknownCamera {
        camera: image.camera.clone(),
        rig: rig.name.clone(),
    };
    let mounted = rig.cameras.get(&image.camera).ok_or_else(unknown)?;
    let keyframe = keyframes
        .get(image.keyframe)
        .ok_or(Error::UnknownKeyframe {
            keyframe: image.keyframe,
            count: keyframes.len(),
        })?;
    Ok(PlacedImage {
        mounted,
        world_from_camera: keyframe.world_from_rig * mounted.rig_from_camera,
        keypoints: &image.features.keypoints,
    })
}

fn prepare<'a>(
    rig: &'a Rig,
    keyframes: &[StampedPose],
    image: &'a KeyframeImage,
) -> Result<PreparedImage<'a>, Error> {
    let placed = place(rig, keyframes, image)?;
    let camera = &placed.mounted.camera;
    let ray = |k: &Keypoint| camera.unproject(&k.pixel_f64()).unwrap_or_default();
    Ok(PreparedImage {
        descriptors: DescriptorSet::new(&image.features.descriptors),
        rays: placed.keypoints.iter().map(ray).collect(),
        placed,
    })
}

/// For each image the neighbours most like it in place and direction, as ordered pairs without repetition.
fn choose_pairs(images: &[PreparedImage], config: &ReconstructionConfig) -> Vec<(usize, usize)> {
    let mut pairs = BTreeSet::new();
    for (i, a) in images.iter().enumerate() {
        let mut ranked: Vec<(f64, usize)> = images
            .iter()
            .enumerate()
            .filter_map(|(j, b)| Some((unlikeness(a, b, config)?, j)).filter(|_| j != i))
            .collect();
        ranked.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        let nearest = ranked.iter().take(config.neighbours);
        pairs.extend(nearest.map(|(_, j)| (i.min(*j), i.max(*j))));
    }
    pairs.into_iter().collect()
}

/// How little two images promise for matching; `None` where they should not be matched.
fn unlikeness(a: &PreparedImage, b: &PreparedImage, config: &ReconstructionConfig) -> Option<f64> {
    let second_from_first = b.placed.world_from_camera.inverse() * a.placed.world_from_camera;
    let baseline = second_from_first.translation.norm();
    let axis = second_from_first.rotation * Vector3::z();
    let angle_deg = axis.z.clamp(-1.0, 1.0).acos().to_degrees();
    let usable = baseline >= config.min_baseline_m
        && baseline <= config.max_baseline_m
        && angle_deg <= config.max_axis_angle_deg;
    usable.then(|| (baseline / config.best_baseline_m).ln().abs() + angle_deg / 20.0)
}

fn match_pair(
    images: &[PreparedImage],
    first: usize,
    second: usize,
    config: &ReconstructionConfig,
) -> ImagePair {
    let (a, b) = (&images[first], &images[second]);
    let second_from_first = b.placed.world_from_camera.inverse() * a.placed.world_from_camera;
    let focal = |image: &PreparedImage| {
        let [fx, fy] = image.placed.mounted.camera.focal_px();
        fx.min(fy)
    };
    let max_angle_rad = config.max_epipolar_px / focal(a).min(focal(b)).max(1.0);
    let matches = match_epipolar(
        RayFeatures {
            descriptors: &a.descriptors,
            rays: &a.rays,
        },
        RayFeatures {
            descriptors: &b.descriptors,
            rays: &b.rays,
        },
        &second_from_first,
        max_angle_rad,
        &config.matching,
    );
    ImagePair {
        first,
        second,
        matches,
    }
}
