//! Local points: features followed from frame to frame and between the cameras, and where they lie.

use std::cmp::Reverse;
use std::collections::BTreeSet;

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_types::{ProgressFn, SharedProgress, Stopped};
use rayon::prelude::*;

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::walk::{LocalObservation, LocalPoint, Walk};
use crate::features::Features;
use crate::features::matching::{DescriptorSet, RayFeatures, match_epipolar};
use crate::features::tracks::{ImagePair, Track, TrackedKeypoint, build_tracks};
use crate::features::triangulation::{TriangulatedPoint, TriangulationFailure, View, triangulate};

/// Features of one image, ready to be matched.
pub(super) struct MatchableImage {
    pub descriptors: DescriptorSet,
    pub rays: Vec<Vector3<f64>>,
}

impl MatchableImage {
    /// Rays as the camera would see them were all rows exposed with the middle one: turned by what the rig turned between. A
    /// feature outside the lens model gets a ray of zeros, which matches nothing.
    pub fn new(estimate: &Estimate, frame: usize, camera: usize, features: &Features) -> Self {
        let lens = estimate.cameras[camera].camera();
        let camera_from_world = camera_pose(estimate, frame, camera).rotation.inverse();
        let ray = |pixel: Vector2<f64>| {
            let Some(ray) = lens.unproject(&pixel) else {
                return Vector3::zeros();
            };
            let then = estimate.world_from_camera(frame, camera, pixel.y);
            camera_from_world * (then.rotation * ray)
        };
        Self {
            descriptors: DescriptorSet::new(&features.descriptors),
            rays: features
                .keypoints
                .iter()
                .map(|k| ray(k.pixel_f64()))
                .collect(),
        }
    }
}

/// Features followed through the walk, before it is known where they are.
pub(super) struct LocalTracks(Vec<Track>);

impl LocalTracks {
    /// Matches each image to later ones of its camera and to the other cameras' of its instant, along epipolar lines, and
    /// joins the matches. Images are numbered `frame * cameras + camera`.
    pub fn follow(
        walk: &Walk,
        estimate: &Estimate,
        images: &[MatchableImage],
        config: &GroundTruthConfig,
        progress: ProgressFn<'_>,
    ) -> Result<Self, Stopped> {
        let cameras = walk.cameras.len();
        let pose = |image: usize| camera_pose(estimate, image / cameras, image % cameras);
        let features = |image: usize| RayFeatures {
            descriptors: &images[image].descriptors,
            rays: &images[image].rays,
        };
        let wanted = wanted_pairs(walk, config);
        let done = SharedProgress::new("local tracks", wanted.len(), progress);
        let pairs: Result<Vec<ImagePair>, Stopped> = wanted
            .into_par_iter()
            .map(|(first, second)| {
                let second_from_first = pose(second).inverse() * pose(first);
                let matches = match_epipolar(
                    features(first),
                    features(second),
                    &second_from_first,
                    config.epipolar_tolerance_deg.to_radians(),
                    &config.matching,
                );
                done.one_more()?;
                Ok(ImagePair {
                    first,
                    second,
                    matches,
                })
            })
            .collect();
        let counts: Vec<usize> = images.iter().map(|image| image.rays.len()).collect();
        Ok(Self(build_tracks(
            &counts,
            &pairs?,
            config.min_track_images.max(2),
        )))
    }

    /// Local points: tracks of features that are not in the map, the longest first until their images have enough,
    /// triangulated. Those whose rays do not meet, or hardly differ, give no point.
    pub fn locate(
        &self,
        walk: &Walk,
        estimate: &Estimate,
        features: &[Features],
        config: &GroundTruthConfig,
    ) -> Vec<LocalPoint> {
        locate_all(estimate, &self.select(walk, features, config), config)
    }

    fn select(
        &self,
        walk: &Walk,
        features: &[Features],
        config: &GroundTruthConfig,
    ) -> Vec<Vec<LocalObservation>> {
        let cameras = walk.cameras.len();
        let mut in_map: Vec<BTreeSet<u32>> = vec![BTreeSet::new(); features.len()];
        for (frame, entry) in walk.frames.iter().enumerate() {
            for seen in &entry.fixed {
                in_map[frame * cameras + seen.camera].insert(seen.keypoint);
            }
        }
        let mut local: Vec<&Track> = self
            .0
            .iter()
            .filter(|track| {
                let known = |k: &TrackedKeypoint| in_map[k.image as usize].contains(&k.keypoint);
                !track.keypoints.iter().any(known)
            })
            .collect();
        // The sort is stable: tracks of one length stay in the order of their first keypoint.
        local.sort_by_key(|track| Reverse(track.keypoints.len()));
        let mut used = vec![0usize; features.len()];
        let mut selected = Vec::new();
        for track in local {
            let wanted =
                |k: &TrackedKeypoint| used[k.image as usize] < config.local_points_per_image;
            if !track.keypoints.iter().any(wanted) {
                continue;
            }
            let mut observations = Vec::with_capacity(track.keypoints.len());
            for k in &track.keypoints {
                let image = k.image as usize;
                used[image] += 1;
                observations.push(LocalObservation {
                    frame: image / cameras,
                    camera: image % cameras,
                    pixel: features[image].keypoints[k.keypoint as usize].pixel_f64(),
                    used: true,
                });
            }
            selected.push(observations);
        }
        selected
    }
}

/// Pairs of images in which the same features are looked for.
fn wanted_pairs(walk: &Walk, config: &GroundTruthConfig) -> Vec<(usize, usize)> {
    let cameras = walk.cameras.len();
    let mut wanted = Vec::new();
    for frame in 0..walk.frames.len() {
        for camera in 0..cameras {
            let image = frame * cameras + camera;
            wanted.extend((camera + 1..cameras).map(|other| (image, frame * cameras + other)));
            for step in config.track_steps.iter().filter(|step| **step > 0) {
                if frame + step < walk.frames.len() {
                    wanted.push((image, (frame + step) * cameras + camera));
                }
            }
        }
    }
    wanted
}

/// Pose of a camera when it exposed its middle row.
pub(super) fn camera_pose(estimate: &Estimate, frame: usize, camera: usize) -> Se3 {
    let height = estimate.cameras[camera].camera().height;
    estimate.world_from_camera(frame, camera, 0.5 * (f64::from(height) - 1.0))
}

/// The points of some tracks. Those whose rays do not meet, or hardly differ, give none.
pub(super) fn locate_all(
    estimate: &Estimate,
    tracks: &[Vec<LocalObservation>],
    config: &GroundTruthConfig,
) -> Vec<LocalPoint> {
    tracks
        .par_iter()
        .map(|track| locate_one(estimate, track, config))
        .collect::<Vec<Option<LocalPoint>>>()
        .into_iter()
        .flatten()
        .collect()
}

/// Share of the sights of some tracks that fit no point: those of tracks whose rays are too parallel to tell are left out of it.
pub(super) fn contradicted_share(
    estimate: &Estimate,
    tracks: &[Vec<LocalObservation>],
    config: &GroundTruthConfig,
) -> f64 {
    let counts = tracks
        .par_iter()
        .map(|track| match placed(estimate, track, config) {
            Ok(found) => [track.len() - found.inliers.len(), track.len()],
            Err(TriangulationFailure::TooLittleParallax) => [0, 0],
            Err(_) => [track.len(); 2],
        });
    let [contradicted, all] = counts.reduce(|| [0, 0], |a, b| [a[0] + b[0], a[1] + b[1]]);
    contradicted as f64 / all.max(1) as f64
}

fn locate_one(
    estimate: &Estimate,
    track: &[LocalObservation],
    config: &GroundTruthConfig,
) -> Option<LocalPoint> {
    let found = placed(estimate, track, config).ok()?;
    Some(LocalPoint {
        point_in_world: found.point_in_world,
        observations: found.inliers.iter().map(|k| track[*k]).collect(),
    })
}

/// Where a track is, with those of its sights that agree.
pub(super) fn placed(
    estimate: &Estimate,
    track: &[LocalObservation],
    config: &GroundTruthConfig,
) -> Result<TriangulatedPoint, TriangulationFailure> {
    let views: Vec<View> = track
        .iter()
        .map(|seen| View {
            camera: estimate.cameras[seen.camera].camera(),
            world_from_camera: estimate.world_from_camera(seen.frame, seen.camera, seen.pixel.y),
            pixel: seen.pixel,
        })
        .collect();
    triangulate(&views, &config.triangulation)
}
