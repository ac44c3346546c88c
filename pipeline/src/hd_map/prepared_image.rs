//! Images placed in the world and made ready to be matched.

use lsfb_geometry::{Rig, RigCamera, Se3, StampedPose, Vector3};

use super::reconstruction_config::ReconstructionConfig;
use crate::Error;
use crate::features::matching::{DescriptorSet, Match, RayFeatures, match_epipolar, match_mutual};
use crate::features::tracks::ImagePair;
use crate::features::triangulation::View;
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

/// An image and where it was taken.
pub(super) struct PlacedImage<'a> {
    mounted: &'a RigCamera,
    pub world_from_camera: Se3,
    keypoints: &'a [Keypoint],
}

impl<'a> PlacedImage<'a> {
    /// What it sees at a keypoint; `None` where there is no such keypoint.
    pub fn view(&self, keypoint: u32) -> Option<View<'a>> {
        Some(View {
            camera: &self.mounted.camera,
            world_from_camera: self.world_from_camera,
            pixel: self.keypoints.get(keypoint as usize)?.pixel_f64(),
        })
    }
}

/// An image with everything its matching needs.
pub(super) struct PreparedImage<'a> {
    pub placed: PlacedImage<'a>,
    descriptors: DescriptorSet,
    pub rays: Vec<Vector3<f64>>,
}

/// An image where its keyframe and its rig put it.
pub(super) fn place<'a>(
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

/// The same with descriptors and rays.
pub(super) fn prepare<'a>(
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

/// What two images share along their epipolar lines.
pub(super) fn match_pair(
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

/// Rays that miss one another by less lie where the poses have them, radians: poses are given with errors.
const MEETING_RAD: f64 = 0.02;

/// How many matches two images have by their descriptors alone, and how many of these lie along their epipolar lines.
pub(super) fn compare_pair(
    images: &[PreparedImage],
    first: usize,
    second: usize,
    config: &ReconstructionConfig,
) -> (usize, usize) {
    let (a, b) = (&images[first], &images[second]);
    let second_from_first = b.placed.world_from_camera.inverse() * a.placed.world_from_camera;
    let matches = match_mutual(&a.descriptors, &b.descriptors, &config.matching);
    let meets = |m: &&Match| {
        let (turned, ray) = (
            second_from_first.rotation * a.rays[m.first as usize],
            b.rays[m.second as usize],
        );
        let normal = second_from_first.translation.cross(&turned);
        let along = normal.try_normalize(f64::EPSILON);
        along.is_none_or(|normal| normal.dot(&ray).abs() < MEETING_RAD)
    };
    (matches.len(), matches.iter().filter(meets).count())
}
