//! Whether a walk fits the map as well somewhere else.
//!
//! A corridor with the same doors and lamps from either end is found at one end in every image alike, and no image says so: those that are nearer to
//! the map's are found there, whether they were taken there or not. So images of the walk are looked for where they are not said to be, among
//! the map's images that see something else; what several of them find by the same move of the whole walk is its next best place. There as
//! here, points of the map's images around are looked for where each pose has them: how many are found tells the two apart, or does not.

use lsfb_geometry::{Rig, Se3, Vector3};
use rayon::prelude::*;

use super::guided_matching::Query;
use super::localizer::{Localizer, contradict};
use super::matches::MountedCamera;
use super::voting::{Candidates, Vote};
use crate::features::FrameFeatures;

/// Images of one instant of a walk, and where its rig is said to be.
pub(crate) struct PlacedFrame<'a> {
    pub features: &'a [FrameFeatures],
    pub world_from_rig: Se3,
}

/// Where else a walk may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Elsewhere {
    /// From where the walk is said to be to there.
    pub there_from_here: Se3,
    /// Points that are found where the poses have them, in all images together, and if all poses were moved there.
    pub matches_here: usize,
    pub matches_there: usize,
}

/// Places in which an image is looked for elsewhere, those with most votes.
const PLACES: usize = 6;
/// A map image that has this share of its points in common with those around a pose shows the same.
const SAME_VIEW_SHARE: f64 = 0.5;
/// A pose elsewhere counts from so many matches on.
const FEWEST_MATCHES: usize = 8;
/// A move of the walk must come of so many of its images, and so many moves, those that come of most, are tried.
const FEWEST_FRAMES: usize = 2;
const MOVES: usize = 3;
/// Of two images of the map the nearer one; where they look in opposite directions that counts as so many metres, twice.
const DIRECTION_M: f64 = 4.0;

/// The next best place of a walk; `None` where its images are found nowhere else.
pub(crate) fn find_elsewhere(
    localizer: &Localizer,
    rig: &Rig,
    frames: &[PlacedFrame],
) -> Option<Elsewhere> {
    let found: Vec<Vec<Se3>> = frames
        .par_iter()
        .map(|frame| poses_elsewhere(localizer, rig, frame))
        .collect();
    let moved =
        |frame: &PlacedFrame, there_from_here: &Se3| *there_from_here * frame.world_from_rig;
    let near = |k: usize, there_from_here: &Se3| {
        let expected = moved(&frames[k], there_from_here);
        let mut poses = found[k].iter();
        poses.find(|pose| !contradict(pose, &expected)).copied()
    };
    let moves = frames.iter().zip(&found);
    let moves = moves.flat_map(|(frame, poses)| {
        let here = frame.world_from_rig.inverse();
        poses.iter().map(move |pose| *pose * here)
    });
    let mut agreeing: Vec<(usize, Se3)> = moves
        .map(|there_from_here| {
            let frames = 0..frames.len();
            let agree = frames.filter(|k| near(*k, &there_from_here).is_some());
            (agree.count(), there_from_here)
        })
        .collect();
    // The sort is stable: of equals the first.
    agreeing.sort_by_key(|(agree, _)| std::cmp::Reverse(*agree));
    agreeing.retain(|(agree, _)| *agree >= FEWEST_FRAMES);
    let mut tried: Vec<Se3> = Vec::new();
    for (_, there_from_here) in agreeing {
        let middle = frames.get(frames.len() / 2)?;
        let is_new = |t: &Se3| contradict(&moved(middle, t), &moved(middle, &there_from_here));
        if tried.len() < MOVES && tried.iter().all(is_new) {
            tried.push(there_from_here);
        }
    }
    let matches = |pose_of: &(dyn Fn(usize) -> Se3 + Sync)| -> usize {
        let each = (0..frames.len()).into_par_iter();
        each.map(|k| matches_at(localizer, rig, frames[k].features, &pose_of(k)))
            .sum()
    };
    let there = tried.iter().map(|there_from_here| {
        let pose = |k: usize| {
            let expected = moved(&frames[k], there_from_here);
            near(k, there_from_here).unwrap_or(expected)
        };
        (matches(&pose), *there_from_here)
    });
    let (matches_there, there_from_here) = there.rev().max_by_key(|(matches, _)| *matches)?;
    Some(Elsewhere {
        there_from_here,
        matches_here: matches(&|k| frames[k].world_from_rig),
        matches_there,
    })
}

/// Poses of an instant that contradict the one it is said to have, best votes first.
fn poses_elsewhere(localizer: &Localizer, rig: &Rig, frame: &PlacedFrame) -> Vec<Se3> {
    let Ok(cameras) = localizer.mount(frame.features, rig) else {
        return Vec::new();
    };
    let grids = localizer.grids(frame.features, &cameras);
    let query = Query {
        map: localizer.map(),
        frames: frame.features,
        grids: &grids,
        cameras: &cameras,
    };
    let candidates: Vec<Vec<Candidates>> = frame
        .features
        .iter()
        .map(|frame| localizer.look_up(frame))
        .collect();
    let all: Vec<Candidates> = candidates.iter().flatten().cloned().collect();
    let places = &localizer.places;
    let here = points_around(localizer, &cameras, &frame.world_from_rig);
    let shows_the_same = |vote: &Vote| {
        let points = places.points_in(vote.image);
        let shared = points.iter().filter(|p| here.binary_search(p).is_ok());
        shared.count() as f64 >= SAME_VIEW_SHARE * points.len() as f64
    };
    let mut poses: Vec<Se3> = Vec::new();
    let mut tried: Vec<u32> = Vec::new();
    let mut places_tried = 0;
    for vote in places.vote(&all, localizer.config.min_votes) {
        if places_tried == PLACES {
            break;
        }
        if tried.contains(&vote.image) || shows_the_same(&vote) {
            continue;
        }
        places_tried += 1;
        let place = places.neighbourhood(vote.image, localizer.config.place_images);
        let points = places.points_of(&place);
        tried.extend(&place);
        let found = localizer.pose_at(&query, points, &candidates, &vote);
        let found = found.filter(|found| found.pose.matches.len() >= FEWEST_MATCHES);
        let found = found.map(|found| found.pose.world_from_rig);
        poses.extend(found.filter(|pose| contradict(pose, &frame.world_from_rig)));
    }
    poses
}

/// Points of the map's images around that the images of an instant show where this pose has them.
fn matches_at(
    localizer: &Localizer,
    rig: &Rig,
    features: &[FrameFeatures],
    world_from_rig: &Se3,
) -> usize {
    let Ok(cameras) = localizer.mount(features, rig) else {
        return 0;
    };
    let grids = localizer.grids(features, &cameras);
    let query = Query {
        map: localizer.map(),
        frames: features,
        grids: &grids,
        cameras: &cameras,
    };
    let points = points_around(localizer, &cameras, world_from_rig);
    let found = query.guided_pose(&points, world_from_rig, &localizer.guided());
    let found = found.filter(|found| !contradict(&found.world_from_rig, world_from_rig));
    found.map_or(0, |found| found.matches.len())
}

/// Points of the map's images that look most as the cameras of a rig do, ascending.
fn points_around(
    localizer: &Localizer,
    cameras: &[MountedCamera],
    world_from_rig: &Se3,
) -> Vec<u32> {
    let images: Vec<u32> = cameras
        .iter()
        .flat_map(|camera| nearest_images(localizer, &(*world_from_rig * camera.rig_from_camera)))
        .collect();
    localizer.places.points_of(&images)
}

/// Numbers of the map's images that look most as a camera does from a pose.
fn nearest_images(localizer: &Localizer, world_from_camera: &Se3) -> Vec<u32> {
    let ahead = |pose: &Se3| pose.rotation * Vector3::z();
    let away = |pose: &Se3| {
        let apart_m = (pose.translation - world_from_camera.translation).norm();
        apart_m + DIRECTION_M * (1.0 - ahead(pose).dot(&ahead(world_from_camera)))
    };
    let poses = localizer.places.poses(localizer.map());
    let mut images: Vec<(f64, u32)> = poses
        .filter_map(|(image, pose)| Some((away(&pose?), image)))
        .collect();
    images.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    images.truncate(localizer.config.place_images);
    images.into_iter().map(|(_, image)| image).collect()
}
