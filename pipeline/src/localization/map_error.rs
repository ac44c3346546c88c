//! How far the map's own images are from where its points place them.
//!
//! A map of images whose poses were given is as exact as those, and its points are known relative to one another better than any image
//! is to them. So each image is placed by points that were determined without it, as a query is: how far that is from its given pose is
//! what a query's pose may be off as well. The noise of the matches is in it, and so counted twice.
//!
//! It is too little all the same: a point comes to be only where its images agree on it, so that what the poses are off by is seen only
//! where it hardly matters. Points that other images determine without need of this one show more of it ([`FEWEST_OTHERS`]), and
//! [`UNSEEN`] makes up for the rest.

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix3, Matrix6, Se3, Vector2, Vector3, Vector6};
use lsfb_types::quantile;
use rayon::prelude::*;

use super::matches::{MountedCamera, PointMatch};
use super::refinement::{RefinementConfig, refine_pose};
use crate::hd_map::{HdMap, MapObservation};

/// Standard deviations of the map's poses along each axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct MapError {
    pub rotation_rad: f64,
    pub translation_m: f64,
}

/// Images that are looked at, at most, and points that each must have.
const IMAGES: usize = 200;
pub(super) const FEWEST_POINTS: usize = 15;
/// Other images that must have seen a point: with fewer of them the image had a word in what it is compared with.
const FEWEST_OTHERS: usize = 3;
/// Variance of what a query is off by, in units of what images of the map are seen to be off by. From 2 to 3 the regions of 95 % hold 95 to
/// 97 % of the HoloLens office (every fifth image held out); of a place whose poses are worse the upper end holds more
/// (`docs/figures.md`).
const UNSEEN: f64 = 3.0;
/// The same where the map's images have shown their lens, whose error was most of what they do not show: the office again.
const UNSEEN_OF_FOUND_CAMERAS: f64 = 1.5;
/// Nine of ten are no farther off than a vector of three normal deviates is long in nine of ten cases: a few that are far off leave it
/// as it is, and so many that all of the map is worse in places do not.
const QUANTILE: f64 = 0.9;
const QUANTILE_PER_SIGMA: f64 = 2.500_278;

/// How far an image is by other images' points from its given pose.
struct Offset {
    rotation_rad: f64,
    translation_m: f64,
}

impl MapError {
    /// Of a map; `None` where its images have too few points in common to tell.
    pub fn of(map: &HdMap, config: &RefinementConfig) -> Option<Self> {
        let mut images: BTreeMap<(u32, u16), Vec<MapObservation>> = BTreeMap::new();
        for observation in (0..map.point_count() as u32).flat_map(|p| map.observations(p)) {
            let image = (observation.keyframe, observation.camera);
            images.entry(image).or_default().push(observation);
        }
        let images: Vec<_> = images.into_values().collect();
        let step = images.len().div_ceil(IMAGES).max(1);
        let placed_by = |others: usize| -> Vec<Offset> {
            images
                .par_iter()
                .step_by(step)
                .filter_map(|image| offset(map, image, others, config))
                .collect()
        };
        let mut offsets = placed_by(FEWEST_OTHERS);
        if offsets.is_empty() {
            offsets = placed_by(1);
        }
        let unseen = match map.stated_cameras().is_empty() {
            true => UNSEEN,
            false => UNSEEN_OF_FOUND_CAMERAS,
        };
        let sigma = |length: fn(&Offset) -> f64| {
            let lengths = offsets.iter().map(length).collect();
            Some(unseen.sqrt() * quantile(lengths, QUANTILE)? / QUANTILE_PER_SIGMA)
        };
        Some(Self {
            rotation_rad: sigma(|o| o.rotation_rad)?,
            translation_m: sigma(|o| o.translation_m)?,
        })
    }

    /// This share of it.
    pub fn scaled(self, share: f64) -> Self {
        Self {
            rotation_rad: share * self.rotation_rad,
            translation_m: share * self.translation_m,
        }
    }

    /// Covariance of a pose, tangent `[rotation, translation]`.
    pub fn covariance(&self) -> Matrix6<f64> {
        let (r, t) = (self.rotation_rad.powi(2), self.translation_m.powi(2));
        Matrix6::from_diagonal(&Vector6::new(r, r, r, t, t, t))
    }
}

/// Of an image that is placed by the points that so many others saw at least.
fn offset(
    map: &HdMap,
    image: &[MapObservation],
    fewest_others: usize,
    config: &RefinementConfig,
) -> Option<Offset> {
    let (world_from_camera, mut mounted) = camera_of(map, image.first()?)?;
    mounted.rig_from_camera = Se3::identity();
    let matches: Vec<PointMatch> = image
        .iter()
        .filter_map(|own| {
            let (point_in_world, point_covariance_m2) = without(map, own, fewest_others)?;
            let [x, y] = own.pixel.map(f64::from);
            Some(PointMatch {
                camera: 0,
                pixel: [x, y].into(),
                point_in_world,
                point_covariance_m2,
            })
        })
        .collect();
    if matches.len() < FEWEST_POINTS {
        return None;
    }
    let cameras = [mounted];
    let refined = refine_pose(&cameras, &matches, &world_from_camera, config)?;
    let off = (world_from_camera.inverse() * refined.world_from_rig).log();
    Some(Offset {
        rotation_rad: off.fixed_rows::<3>(0).norm(),
        translation_m: off.fixed_rows::<3>(3).norm(),
    })
}

/// Pose of the camera of an observation, and the camera.
fn camera_of(map: &HdMap, observation: &MapObservation) -> Option<(Se3, MountedCamera)> {
    let name = map.cameras().get(usize::from(observation.camera))?;
    let mounted = map.rig().cameras.get(name)?;
    let keyframe = map.keyframe(observation.keyframe)?;
    let camera = MountedCamera {
        camera: mounted.camera,
        rig_from_camera: mounted.rig_from_camera,
        readout_s: 0.0,
    };
    Some((keyframe.world_from_rig * mounted.rig_from_camera, camera))
}

/// Position and covariance of a point by the other images that saw it; `None` where these are too few.
fn without(
    map: &HdMap,
    own: &MapObservation,
    fewest_others: usize,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let position = map.position(own.point)?;
    let (camera, _) = camera_of(map, own)?;
    // However little the others say, the point is about as far away as it is.
    let distance_m = (position - camera.translation).norm().max(1e-6);
    let mut information = Matrix3::from_diagonal_element(distance_m.powi(-2));
    let mut gradient = Vector3::zeros();
    let mut others = 0;
    let is_other = |o: &MapObservation| (o.keyframe, o.camera) != (own.keyframe, own.camera);
    for other in map.observations(own.point).filter(is_other) {
        others += 1;
        let (world_from_camera, mounted) = camera_of(map, &other)?;
        let camera_from_world = world_from_camera.inverse();
        let in_camera = camera_from_world * position;
        let seen = mounted.camera.project_with_jacobian(&in_camera)?;
        let by_position = seen.pixel_by_point * camera_from_world.rotation_matrix();
        let [x, y] = other.pixel.map(f64::from);
        let residual = seen.pixel - Vector2::new(x, y);
        information += by_position.tr_mul(&by_position);
        gradient += by_position.tr_mul(&residual);
    }
    if others < fewest_others {
        return None;
    }
    let covariance = information.cholesky()?.inverse();
    Some((position - covariance * gradient, covariance))
}
