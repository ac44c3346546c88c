//! Points of the HD map that were recognised before or after, looked for where the poses say they must be.

use std::collections::BTreeMap;

use lsfb_geometry::Vector3;
use rayon::prelude::*;

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::walk::{FixedObservation, Walk};
use crate::features::matching::{Prediction, match_projected};
use crate::features::{Descriptor, Features, KeypointGrid};

/// A point of the map as this walk saw it.
struct Candidate {
    point_in_world: Vector3<f64>,
    descriptors: Vec<Descriptor>,
}

/// Sights of one candidate that are compared; more add time, not matches.
const LOOKS: usize = 4;

/// Adds observations to the walk: each frame looks for the points that its neighbours in time have and it has not. What they
/// look like is taken from those neighbours, which are closer to this frame than the map's own images. `features` are
/// numbered `frame * cameras + camera`. Returns how many were added.
pub(super) fn match_again(
    walk: &mut Walk,
    estimate: &Estimate,
    features: &[Features],
    config: &GroundTruthConfig,
) -> usize {
    let found: Vec<Vec<FixedObservation>> = (0..walk.frames.len())
        .into_par_iter()
        .map(|frame| {
            let candidates = candidates(walk, features, frame, config);
            (0..walk.cameras.len())
                .flat_map(|camera| {
                    search_image(walk, estimate, features, frame, camera, &candidates, config)
                })
                .collect()
        })
        .collect();
    let mut added = 0;
    for (frame, observations) in walk.frames.iter_mut().zip(found) {
        added += observations.len();
        frame.recognised.extend(&observations);
        frame.fixed.extend(observations);
    }
    added
}

fn candidates(
    walk: &Walk,
    features: &[Features],
    frame: usize,
    config: &GroundTruthConfig,
) -> BTreeMap<u32, Candidate> {
    let cameras = walk.cameras.len();
    let time = walk.frames[frame].time;
    let near = |k: &usize| {
        walk.frames[*k].time.secs_since(time).abs() <= config.guided_matching_window_secs
    };
    // Nearest in time first: their looks count.
    let mut neighbours: Vec<usize> = (0..walk.frames.len()).filter(near).collect();
    neighbours.sort_by_key(|k| (k.abs_diff(frame), *k));
    let mut candidates: BTreeMap<u32, Candidate> = BTreeMap::new();
    for k in neighbours {
        for seen in &walk.frames[k].fixed {
            let image = &features[k * cameras + seen.camera];
            let Some(look) = image.descriptors.get(seen.keypoint as usize) else {
                continue;
            };
            let candidate = candidates.entry(seen.point).or_insert_with(|| Candidate {
                point_in_world: seen.point_in_world,
                descriptors: Vec::new(),
            });
            if candidate.descriptors.len() < LOOKS {
                candidate.descriptors.push(*look);
            }
        }
    }
    candidates
}

fn search_image(
    walk: &Walk,
    estimate: &Estimate,
    features: &[Features],
    frame: usize,
    camera: usize,
    candidates: &BTreeMap<u32, Candidate>,
    config: &GroundTruthConfig,
) -> Vec<FixedObservation> {
    let image = &features[frame * walk.cameras.len() + camera];
    let lens = walk.cameras[camera].camera();
    let have: Vec<&FixedObservation> = walk.frames[frame]
        .fixed
        .iter()
        .filter(|seen| seen.camera == camera)
        .collect();
    let (mut points, mut predictions) = (Vec::new(), Vec::new());
    for (point, candidate) in candidates {
        if have.iter().any(|seen| seen.point == *point) {
            continue;
        }
        if let Some(pixel) = estimate.project(frame, camera, &candidate.point_in_world)
            && lens.contains(&pixel, 0.0)
        {
            points.push((*point, candidate.point_in_world));
            predictions.push(Prediction {
                pixel,
                descriptors: &candidate.descriptors,
            });
        }
    }
    let radius_px = config.guided_matching_radius_px;
    let grid = KeypointGrid::new(&image.keypoints, lens.width, lens.height, 2.0 * radius_px);
    match_projected(
        &predictions,
        &grid,
        &image.descriptors,
        radius_px,
        &config.matching,
    )
    .into_iter()
    .filter(|found| have.iter().all(|seen| seen.keypoint != found.second))
    .map(|found| {
        let (point, point_in_world) = points[found.first as usize];
        FixedObservation {
            camera,
            keypoint: found.second,
            pixel: image.keypoints[found.second as usize].pixel_f64(),
            point,
            point_in_world,
        }
    })
    .collect()
}
