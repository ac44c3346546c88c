use lsfb_geometry::{Se3, StampedPose};
use lsfb_types::{Bounds, Image, ProgressFn, Timestamp};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    HdMap, HdMapConfig, KeyframeImage, MapContent, ReconstructionConfig, reconstruct,
    select_keyframes,
};
use crate::Error;
use crate::features::{SiftConfig, detect_all};
use crate::posed_images::PosedImages;

/// Configuration of [`build_map_from_posed_images`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PosedMapConfig {
    /// An image becomes a keyframe this far from the last one, metres …
    pub keyframe_distance_m: f64,
    /// … or turned by this much, degrees.
    pub keyframe_angle_deg: f64,
    /// Features.
    pub sift: SiftConfig,
    /// Matching and triangulation.
    pub reconstruction: ReconstructionConfig,
    /// Descriptors and index.
    pub map: HdMapConfig,
}

impl Default for PosedMapConfig {
    fn default() -> Self {
        Self {
            keyframe_distance_m: 0.08,
            keyframe_angle_deg: 6.0,
            sift: SiftConfig::default(),
            reconstruction: ReconstructionConfig::default(),
            map: HdMapConfig::default(),
        }
    }
}

lsfb_types::bounds! {
    PosedMapConfig {
        keyframe_distance_m: number(Bounds::NOT_NEGATIVE),
        keyframe_angle_deg: number(Bounds::NOT_NEGATIVE),
        sift: section,
        reconstruction: section,
        map: section,
    }
}

/// Builds a map from images with poses. Keyframe `i` carries `i` ns as its time: the list has none.
pub fn build_map_from_posed_images(
    posed: &PosedImages,
    config: &PosedMapConfig,
    progress: ProgressFn,
) -> Result<HdMap, Error> {
    config.check_bounds("posed_map")?;
    let poses: Vec<Se3> = posed.images.iter().map(|i| i.world_from_rig).collect();
    let (distance_m, angle_deg) = (config.keyframe_distance_m, config.keyframe_angle_deg);
    let chosen = select_keyframes(&poses, distance_m, angle_deg);
    let pixels: Vec<Image> = chosen
        .par_iter()
        .map(|i| posed.images[*i].read(&posed.rig))
        .collect::<Result<_, _>>()?;
    let features = detect_all(&pixels.iter().collect::<Vec<_>>(), &config.sift, progress)?;
    let images: Vec<KeyframeImage> = chosen
        .iter()
        .zip(features)
        .enumerate()
        .map(|(keyframe, (i, features))| KeyframeImage {
            keyframe,
            camera: posed.images[*i].camera.clone(),
            features,
        })
        .collect();
    let keyframes: Vec<StampedPose> = chosen
        .iter()
        .enumerate()
        .map(|(keyframe, i)| StampedPose {
            time: Timestamp::from_nanos(keyframe as i64),
            world_from_rig: poses[*i],
        })
        .collect();
    let points = reconstruct(
        &posed.rig,
        &keyframes,
        &images,
        &config.reconstruction,
        progress,
    )?;
    let content = MapContent {
        keyframes: &keyframes,
        images: &images,
        points: &points,
        provenance: &posed.content_hash()?,
    };
    HdMap::build(&content, &config.map, progress)
}
