mod cameras;
mod kept;
mod poses;
mod report;
mod strangers;

use std::collections::{BTreeMap, BTreeSet};

use lsfb_geometry::{Se3, StampedPose};
use lsfb_types::{Bounds, Image, Progress, ProgressFn, Timestamp};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::reconstruction::{contradiction, depth_of_images, expect_map};
use super::scene_depth::depth_pairs;
use super::{
    HdMap, HdMapConfig, KeyframeImage, MapContent, PlacedImages, ReconstructionConfig, find_tracks,
    select_keyframes, triangulate_tracks,
};
use crate::error::{Error, MIN_MAP_POINTS, MapShortage, Refusal};
use crate::features::{FeatureDetector, Features, LearnedConfig, SiftConfig};
use crate::kept_stages::KeptStages;
use crate::posed_images::PosedImages;
use cameras::{Shown, found_cameras};
pub use poses::PoseRefinement;
use poses::{RefinedPoses, refined_poses};
pub use report::{ListedErrors, PosedMapReport};
use strangers::{Mapped, strangers};

/// Images in memory at once.
const BATCH: usize = 32;

/// Configuration of [`build_map_from_posed_images`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PosedMapConfig {
    /// An image becomes a keyframe this far from the last one, as a share of the depth of the scene …
    pub keyframe_distance_per_depth: f64,
    /// … or turned by this much, degrees.
    pub keyframe_angle_deg: f64,
    /// Whether cameras whose images show surely that they are other than stated are taken as the images show them.
    pub refine_cameras: bool,
    /// Whether, and how far, the poses may be other than listed.
    pub refine_poses: PoseRefinement,
    /// Features.
    pub sift: SiftConfig,
    /// A network that finds features instead.
    pub learned: Option<LearnedConfig>,
    /// Matching and triangulation.
    pub reconstruction: ReconstructionConfig,
    /// Descriptors and index.
    pub map: HdMapConfig,
}

impl Default for PosedMapConfig {
    fn default() -> Self {
        Self {
            keyframe_distance_per_depth: 0.026,
            keyframe_angle_deg: 6.0,
            refine_cameras: true,
            refine_poses: PoseRefinement::default(),
            sift: SiftConfig::default(),
            learned: None,
            reconstruction: ReconstructionConfig::default(),
            map: HdMapConfig::default(),
        }
    }
}

lsfb_types::bounds! {
    PosedMapConfig {
        keyframe_distance_per_depth: number(Bounds::NOT_NEGATIVE),
        keyframe_angle_deg: number(Bounds::NOT_NEGATIVE),
        refine_cameras: any,
        refine_poses: section,
        sift: section,
        learned: any,
        reconstruction: section,
        map: section,
    }
}

/// A map of posed images and how it fits them.
#[derive(Clone, Debug)]
pub struct PosedMap {
    /// The map.
    pub map: HdMap,
    /// What is to be said of it.
    pub report: PosedMapReport,
}

/// Builds a map from images with poses, in the unit of the poses. Images that a rig took at one instant are one keyframe. Keyframe `i`
/// carries `i` ns as its time: the list has none.
///
/// Cameras that the images show to be other than stated are taken as they show them ([`HdMap::stated_cameras`]), and images of the same
/// cameras are localized with those.
///
/// Images that give hardly a point are an error that says what is missing; images that do not show what their poses say are among the
/// map's failures.
pub fn build_map_from_posed_images(
    posed: &PosedImages,
    config: &PosedMapConfig,
    progress: ProgressFn,
) -> Result<HdMap, Error> {
    let stages = KeptStages::none();
    let built = build_map_from_posed_images_in_stages(posed, config, &stages, progress)?;
    Ok(built.map)
}

/// [`build_map_from_posed_images`] that goes on behind the stages that are kept already, and keeps those it finishes: features, tracks, refined
/// poses. The map is the same bit for bit. Stages of other images must not be among them.
pub fn build_map_from_posed_images_in_stages(
    posed: &PosedImages,
    config: &PosedMapConfig,
    stages: &KeptStages,
    progress: ProgressFn,
) -> Result<PosedMap, Error> {
    config.check_bounds("posed_map")?;
    let detector = FeatureDetector::new(&config.sift, config.learned.as_ref())?;
    let mut detected = DetectedImages {
        posed,
        detector: &detector,
        stages,
        features: BTreeMap::new(),
    };
    let sample = depth_sample(posed, &config.reconstruction)?;
    detected.detect("depth", &sample, progress)?;
    let (keyframes, images) = detected.keyframes(&sample);
    let depth = depth_of_images(&posed.rig, &keyframes, &images, &config.reconstruction)?;
    let contradiction = contradiction(&posed.rig, &keyframes, &images, &config.reconstruction)?;
    let distance = config.keyframe_distance_per_depth * depth;
    let chosen = chosen_images(posed, distance, config.keyframe_angle_deg);
    detected.detect("images", &chosen, progress)?;
    let (mut keyframes, images) = detected.keyframes(&chosen);
    drop(detected);
    let reconstruction = &config.reconstruction;
    let tracks = stages.once("tracks", || {
        find_tracks(&posed.rig, &keyframes, &images, reconstruction, progress)
    })?;
    let (rig, stated) = match config.refine_cameras {
        true => {
            let shown = Shown {
                keyframes: &keyframes,
                images: &images,
                tracks: &tracks,
                depth,
                triangulation: &reconstruction.triangulation,
            };
            found_cameras(&posed.rig, &shown, progress)?
        }
        false => (posed.rig.clone(), BTreeMap::new()),
    };
    // Matches lie along other lines where cameras are other than stated.
    let tracks = match stated.is_empty() {
        true => tracks,
        false => stages.once("tracks-found-cameras", || {
            find_tracks(&rig, &keyframes, &images, reconstruction, progress)
        })?,
    };
    let listed = keyframes.clone();
    let mut moved_far = Vec::new();
    let tracks = match config.refine_poses.enabled {
        false => tracks,
        true => {
            let settings = (&config.refine_poses, reconstruction);
            let refined = stages.once("poses", || {
                refined_poses(&rig, &keyframes, &images, depth, settings, progress)
            })?;
            keyframes = refined.keyframes;
            moved_far = refined.far;
            refined.tracks
        }
    };
    let triangulation = &reconstruction.triangulation;
    let points = triangulate_tracks(&rig, &keyframes, &images, &tracks, triangulation)?;
    expect_map(&points, &images)?;
    let placed = PlacedImages {
        rig: &rig,
        keyframes: &keyframes,
        images: &images,
    };
    let listed = PlacedImages {
        rig: &posed.rig,
        keyframes: &listed,
        images: &images,
    };
    let has_others = config.refine_poses.enabled || !stated.is_empty();
    let listed = has_others.then_some(&listed);
    let report = PosedMapReport::of(&placed, listed, &points, &tracks, triangulation)?;
    let content = MapContent {
        rig: &rig,
        keyframes: &keyframes,
        images: &images,
        points: &points,
        feature: &detector.feature(),
        provenance: &posed.content_hash()?,
    };
    let map = HdMap::build(&content, &config.map, progress)?;
    let map = map.with_stated_cameras(stated);
    let mapped = Mapped {
        rig: &rig,
        keyframes: &keyframes,
        images: &images,
        points: &points,
        map: &map,
        config: reconstruction,
        depth,
    };
    let name_of = |image: usize| {
        let path = chosen.get(image).map(|i| &posed.images[*i].path);
        let name = path.and_then(|path| path.file_name()).unwrap_or_default();
        name.to_string_lossy().into_owned()
    };
    let strangers = strangers(&mapped, name_of)?;
    let far = moved_far.first().map(|first| {
        let shows = images.iter().position(|image| image.keyframe == *first);
        format!(
            "{} poses differ from the list by more than their expected error (refine_poses), first that of {}",
            moved_far.len(),
            shows.map_or_else(String::new, name_of)
        )
    });
    let failures = contradiction.into_iter().chain(strangers).chain(far);
    Ok(PosedMap {
        map: map.with_failures(failures.collect()),
        report,
    })
}

/// Number of the instant at which each of some images was taken, from 0 in their order: images of one rig share it.
fn numbered_instants(posed: &PosedImages, images: &[usize]) -> Vec<usize> {
    let mut of_rig: BTreeMap<usize, usize> = BTreeMap::new();
    let mut count = 0;
    let mut next = || {
        count += 1;
        count - 1
    };
    let instants = images.iter().map(|i| match posed.images[*i].instant {
        Some(instant) => *of_rig.entry(instant).or_insert_with(&mut next),
        None => next(),
    });
    instants.collect()
}

/// Indices of the images that become keyframes: those of an instant together.
fn chosen_images(posed: &PosedImages, min_distance: f64, min_angle_deg: f64) -> Vec<usize> {
    let all: Vec<usize> = (0..posed.images.len()).collect();
    let instants = numbered_instants(posed, &all);
    let mut poses: Vec<Se3> = Vec::new();
    for (image, instant) in posed.images.iter().zip(&instants) {
        if *instant == poses.len() {
            poses.push(image.world_from_rig);
        }
    }
    let chosen = select_keyframes(&poses, min_distance, min_angle_deg);
    let is_chosen = |i: &usize| chosen.binary_search(&instants[*i]).is_ok();
    all.into_iter().filter(is_chosen).collect()
}

/// Indices of the images that say how deep the scene is.
fn depth_sample(posed: &PosedImages, config: &ReconstructionConfig) -> Result<Vec<usize>, Error> {
    let cameras: Vec<Se3> = posed
        .images
        .iter()
        .map(|image| {
            let mounted = posed.rig.cameras.get(&image.camera);
            let mounted = mounted.ok_or_else(|| Error::UnknownCamera {
                camera: image.camera.clone(),
                rig: posed.rig.name.clone(),
            })?;
            Ok(image.world_from_rig * mounted.rig_from_camera)
        })
        .collect::<Result<_, Error>>()?;
    let pairs = depth_pairs(&cameras, config);
    let sample: BTreeSet<usize> = pairs.iter().flat_map(|(a, b)| [*a, *b]).collect();
    if sample.is_empty() {
        let images = cameras.len();
        let reason = MapShortage::NoBaseline { images };
        return Err(Refusal::TooFewPoints {
            points: 0,
            needed: MIN_MAP_POINTS,
            reason,
        }
        .into());
    }
    Ok(sample.into_iter().collect())
}

/// Images whose features are known.
struct DetectedImages<'a> {
    posed: &'a PosedImages,
    detector: &'a FeatureDetector,
    stages: &'a KeptStages,
    features: BTreeMap<usize, Features>,
}

impl DetectedImages<'_> {
    /// Detects the features of those of `wanted` whose features are not known yet: a stage of this name.
    fn detect(&mut self, name: &str, wanted: &[usize], progress: ProgressFn) -> Result<(), Error> {
        let is_new = |i: &&usize| !self.features.contains_key(i);
        let missing: Vec<usize> = wanted.iter().filter(is_new).copied().collect();
        let found = self
            .stages
            .once(name, || self.features_of(&missing, progress))?;
        self.features.extend(missing.into_iter().zip(found));
        Ok(())
    }

    /// The features of these images, in their order.
    fn features_of(&self, missing: &[usize], progress: ProgressFn) -> Result<Vec<Features>, Error> {
        let mut found: Vec<Features> = Vec::with_capacity(missing.len());
        for batch in missing.chunks(BATCH) {
            let pixels: Vec<Image> = batch
                .par_iter()
                .map(|i| self.posed.images[*i].read(&self.posed.rig))
                .collect::<Result<_, _>>()?;
            let borrowed: Vec<&Image> = pixels.iter().collect();
            let before = found.len() as u64;
            found.extend(self.detector.detect_all(&borrowed, &|p| {
                progress(Progress {
                    done: before + p.done,
                    total: missing.len() as u64,
                    ..p
                })
            })?);
        }
        Ok(found)
    }

    /// These images, whose features are known, and their instants as keyframes.
    fn keyframes(&self, chosen: &[usize]) -> (Vec<StampedPose>, Vec<KeyframeImage>) {
        let instants = numbered_instants(self.posed, chosen);
        let mut keyframes: Vec<StampedPose> = Vec::new();
        let images = chosen.iter().zip(instants).filter_map(|(i, keyframe)| {
            let image = &self.posed.images[*i];
            if keyframe == keyframes.len() {
                keyframes.push(StampedPose {
                    time: Timestamp::from_nanos(keyframe as i64),
                    world_from_rig: image.world_from_rig,
                });
            }
            Some(KeyframeImage {
                keyframe,
                camera: image.camera.clone(),
                features: self.features.get(i)?.clone(),
            })
        });
        let images = images.collect();
        (keyframes, images)
    }
}

#[cfg(test)]
mod tests;
