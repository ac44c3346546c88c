//! Kept images with the points that they and those next to them see.

use std::ops::Range;

use lsfb_geometry::{Matrix6, Vector3};
use lsfb_types::{Progress, ProgressFn};
use rayon::prelude::*;

use super::{Before, WalkView};
use crate::Error;
use crate::features::matching::{DescriptorSet, RayFeatures, match_epipolar};
use crate::features::tracks::{ImagePair, TrackedKeypoint, build_tracks};
use crate::ground_truth::local_points::{MatchableImage, camera_pose, placed};
use crate::ground_truth::walk::LocalObservation;
use crate::loops::Keyframe;

/// Images of a camera that follow one another by no more than so many are searched for the same features.
const STEPS: [usize; 2] = [1, 2];

/// What kept images see.
pub(super) struct PlacedViews {
    /// Images of one moment, by their numbers, in order of time.
    pub places: Vec<Range<usize>>,
    /// What neighbouring images share.
    pub pairs: Vec<ImagePair>,
    /// Points that several images see.
    pub points: Vec<Vector3<f64>>,
    /// For each image its keypoints that show one of the points: keypoint and point.
    pub seen: Vec<Vec<(u32, usize)>>,
    /// For each image.
    pub descriptors: Vec<DescriptorSet>,
}

impl PlacedViews {
    /// Matches neighbouring images along epipolar lines, and triangulates.
    pub fn new(before: &Before<'_>, progress: ProgressFn<'_>) -> Result<Self, Error> {
        let (views, estimate) = (&before.tracked.views, &before.settled.last.estimate);
        let (config, places) = (before.adjustment, places(views));
        let images: Vec<MatchableImage> = views
            .par_iter()
            .map(|v| MatchableImage::new(estimate, v.frame, v.camera, &v.features))
            .collect();
        let wanted = wanted_pairs(views, &places);
        let total = wanted.len() as u64;
        let told = |done: usize| {
            progress(Progress {
                stage: "verifying revisits",
                done: done as u64,
                total,
            })
        };
        let pose = |k: usize| camera_pose(estimate, views[k].frame, views[k].camera);
        let features = |k: usize| RayFeatures {
            descriptors: &images[k].descriptors,
            rays: &images[k].rays,
        };
        let pairs: Result<Vec<ImagePair>, Error> = wanted
            .into_par_iter()
            .enumerate()
            .map(|(done, (first, second))| {
                told(done)?;
                let matches = match_epipolar(
                    features(first),
                    features(second),
                    &(pose(second).inverse() * pose(first)),
                    config.epipolar_tolerance_deg.to_radians(),
                    &config.matching,
                );
                Ok(ImagePair {
                    first,
                    second,
                    matches,
                })
            })
            .collect();
        let pairs = pairs?;
        let counts: Vec<usize> = views.iter().map(|v| v.features.len()).collect();
        let tracks = build_tracks(&counts, &pairs, 2);
        let located: Vec<Option<(Vector3<f64>, Vec<TrackedKeypoint>)>> = tracks
            .par_iter()
            .map(|track| {
                let observations: Vec<LocalObservation> =
                    track.keypoints.iter().map(|k| sight(views, k)).collect();
                let found = placed(estimate, &observations, config).ok()?;
                let keypoints = found.inliers.iter().map(|k| track.keypoints[*k]).collect();
                Some((found.point_in_world, keypoints))
            })
            .collect();
        let mut points = Vec::new();
        let mut seen = vec![Vec::new(); views.len()];
        for (point, keypoints) in located.into_iter().flatten() {
            for k in keypoints {
                seen[k.image as usize].push((k.keypoint, points.len()));
            }
            points.push(point);
        }
        Ok(Self {
            places,
            pairs,
            points,
            seen,
            descriptors: images.into_iter().map(|i| i.descriptors).collect(),
        })
    }

    /// The places as keyframes of a graph: `scan` is the number of the frame.
    pub fn keyframes(&self, before: &Before<'_>) -> Vec<Keyframe> {
        let estimate = &before.settled.last.estimate;
        let position = |k: usize| estimate.pose(k).translation;
        let mut paths_m = vec![0.0];
        for k in 1..before.walk.frames.len() {
            paths_m.push(paths_m[k - 1] + (position(k) - position(k - 1)).norm());
        }
        let of_place = |(place, covariance): (&Range<usize>, &Matrix6<f64>)| {
            let frame = before.tracked.views[place.start].frame;
            Keyframe {
                scan: frame,
                time: before.walk.frames[frame].time,
                world_from_rig: *estimate.pose(frame),
                covariance: *covariance,
                path_m: paths_m[frame],
            }
        };
        let places = self.places.iter().zip(before.covariances);
        places.map(of_place).collect()
    }
}

/// Where an image shows a keypoint.
pub(super) fn sight(views: &[WalkView], k: &TrackedKeypoint) -> LocalObservation {
    let view = &views[k.image as usize];
    LocalObservation {
        frame: view.frame,
        camera: view.camera,
        pixel: view.features.keypoints[k.keypoint as usize].pixel_f64(),
        used: true,
    }
}

fn places(views: &[WalkView]) -> Vec<Range<usize>> {
    let mut places: Vec<Range<usize>> = Vec::new();
    for (k, view) in views.iter().enumerate() {
        match places.last_mut() {
            Some(place) if views[place.start].frame == view.frame => place.end = k + 1,
            _ => places.push(k..k + 1),
        }
    }
    places
}

/// Images of one moment, and of one camera in those next to it.
fn wanted_pairs(views: &[WalkView], places: &[Range<usize>]) -> Vec<(usize, usize)> {
    let mut wanted = Vec::new();
    for (k, place) in places.iter().enumerate() {
        for first in place.clone() {
            wanted.extend((first + 1..place.end).map(|second| (first, second)));
            for later in STEPS.iter().filter_map(|step| places.get(k + step)) {
                let same = later
                    .clone()
                    .filter(|v| views[*v].camera == views[first].camera);
                wanted.extend(same.map(|second| (first, second)));
            }
        }
    }
    wanted
}
