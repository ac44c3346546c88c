//! Whether a walk, or an image of which little is recognised, fits the map as well somewhere else.
//!
//! A corridor with the same doors and lamps from either end is found at one end in every image alike, and no image says so: those that are nearer to
//! the map's are found there, whether they were taken there or not. So images of the walk are looked for where they are not said to be: what
//! fits where they are said to be is taken out of what each feature may show, and of what is left the best places are tried. What several images
//! find by the same move of the whole walk is another place of it, the next of several doors or the other end. A pose that explains the same features by the
//! same points is none: it is the same place, badly seen.

use std::collections::BTreeMap;

use lsfb_geometry::{Rig, Se3};
use rayon::prelude::*;

use super::guided_matching::{GuidedPose, Query};
use super::localizer::{Found, Localizer, MatchedQuery, contradict};
use super::matches::MountedCamera;
use super::outcome::{FeatureMatch, Localization};
use super::voting::Candidates;
use crate::features::FrameFeatures;

/// Images of one instant of a walk, and where its rig is said to be.
pub(crate) struct PlacedFrame<'a> {
    pub features: &'a [FrameFeatures],
    pub world_from_rig: Se3,
}

/// Where else a walk may be.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Elsewhere {
    /// From where the walk is said to be to there.
    pub there_from_here: Se3,
    /// Poses of the instants there, as each of them fits best.
    pub poses: Vec<Se3>,
    /// Points that are found where the poses have them, in all images together, and if all poses were moved there.
    pub matches_here: usize,
    pub matches_there: usize,
}

/// Places in which an image is looked for elsewhere, those with most votes.
const PLACES: usize = 6;
/// What a feature may show fits a pose when it is seen no farther from there, in units of the radius of guided matching.
const FITS_RADII: f64 = 2.0;
/// Points no farther apart are on the same thing, metres.
const SAME_THING_M: f64 = 0.2;
/// A pose elsewhere counts from so many matches on.
const FEWEST_MATCHES: usize = 8;
/// A move of the walk must come of so many of its images, and so many moves, those that come of most, are tried.
const FEWEST_FRAMES: usize = 2;
const MOVES: usize = 3;
/// Where less than this share is found of what is found where the walk is said to be, that is by chance.
const LEAST_SHARE: f64 = 0.1;

/// Other places of a walk, those where most of it is found first; none where its images are found nowhere else.
pub(crate) fn find_elsewhere(
    localizer: &Localizer,
    rig: &Rig,
    frames: &[PlacedFrame],
) -> Vec<Elsewhere> {
    let found: Vec<(usize, Vec<Se3>)> = frames
        .par_iter()
        .map(|frame| poses_elsewhere(localizer, rig, frame))
        .collect();
    let matches_here = found.iter().map(|(here, _)| here).sum();
    let moved =
        |frame: &PlacedFrame, there_from_here: &Se3| *there_from_here * frame.world_from_rig;
    let near = |k: usize, there_from_here: &Se3| {
        let expected = moved(&frames[k], there_from_here);
        let mut poses = found[k].1.iter();
        poses.find(|pose| !contradict(pose, &expected)).copied()
    };
    let moves = frames.iter().zip(&found);
    let moves = moves.flat_map(|(frame, (_, poses))| {
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
        let Some(middle) = frames.get(frames.len() / 2) else {
            break;
        };
        let is_new = |t: &Se3| contradict(&moved(middle, t), &moved(middle, &there_from_here));
        if tried.len() < MOVES && tried.iter().all(is_new) {
            tried.push(there_from_here);
        }
    }
    let there = tried.into_iter().map(|there_from_here| {
        let each = frames.par_iter().enumerate().map(|(k, frame)| {
            let expected = moved(frame, &there_from_here);
            let start = near(k, &there_from_here).unwrap_or(expected);
            match pose_near(localizer, rig, frame.features, &start) {
                Some(found) => (found.world_from_rig, found.matches.len()),
                None => (start, 0),
            }
        });
        let (poses, matches): (Vec<Se3>, Vec<usize>) = each.collect();
        Elsewhere {
            there_from_here,
            poses,
            matches_here,
            matches_there: matches.iter().sum(),
        }
    });
    let is_found = |there: &Elsewhere| {
        there.matches_there as f64 >= LEAST_SHARE * there.matches_here.max(1) as f64
    };
    let mut there: Vec<Elsewhere> = there.filter(is_found).collect();
    there.sort_by_key(|there| std::cmp::Reverse(there.matches_there));
    there
}

/// How many points an instant shows where it is said to be, and poses of it that contradict that one, best votes first.
fn poses_elsewhere(localizer: &Localizer, rig: &Rig, frame: &PlacedFrame) -> (usize, Vec<Se3>) {
    let found = with_query(localizer, rig, frame.features, |query| {
        let here = &frame.world_from_rig;
        let found_here = pose_near(localizer, rig, frame.features, here);
        let matches_here = found_here.map_or_else(Vec::new, |found| found.matches);
        let candidates = frame.features.iter().map(|f| localizer.look_up(f));
        let candidates: Vec<Vec<Candidates>> = candidates.collect();
        let there = localizer.poses_elsewhere(query, &candidates, here, &matches_here);
        let there = there.iter().map(|pose| pose.world_from_rig);
        Some((matches_here.len(), there.collect()))
    });
    found.unwrap_or_default()
}

impl Localizer {
    /// Poses of a query that contradict the one at which it shows `matches_here`, best votes first: by what else its features may show.
    pub(super) fn poses_elsewhere(
        &self,
        query: &Query,
        candidates: &[Vec<Candidates>],
        here: &Se3,
        matches_here: &[FeatureMatch],
    ) -> Vec<GuidedPose> {
        let shown_here: BTreeMap<(usize, u32), u32> = matches_here
            .iter()
            .map(|m| ((m.frame, m.keypoint), m.point))
            .collect();
        let is_same_thing = |m: &&FeatureMatch| {
            let here = shown_here.get(&(m.frame, m.keypoint));
            let position = |point: u32| self.map().position(point);
            let both = here.and_then(|here| Some((position(*here)?, position(m.point)?)));
            both.is_some_and(|(here, there)| (here - there).norm() <= SAME_THING_M)
        };
        let shows_the_same = |pose: &GuidedPose| {
            let matches = || pose.matches.iter();
            let in_both = |m: &&FeatureMatch| shown_here.contains_key(&(m.frame, m.keypoint));
            2 * matches().filter(is_same_thing).count() > matches().filter(in_both).count()
        };
        let frames = query.frames.iter().zip(query.cameras).zip(candidates);
        let candidates: Vec<Vec<Candidates>> = frames
            .map(|((features, camera), candidates)| {
                what_does_not_fit(self, features, camera, candidates, here)
            })
            .collect();
        let all: Vec<Candidates> = candidates.iter().flatten().cloned().collect();
        let places = &self.places;
        let mut poses: Vec<GuidedPose> = Vec::new();
        let mut tried: Vec<u32> = Vec::new();
        let mut places_tried = 0;
        for vote in places.vote(&all, self.config.min_votes) {
            if places_tried == PLACES {
                break;
            }
            if tried.contains(&vote.image) {
                continue;
            }
            places_tried += 1;
            let place = places.neighbourhood(vote.image, self.config.place_images);
            let points = places.points_of(&place);
            tried.extend(&place);
            let seen = MatchedQuery::alone(query, &candidates);
            let found = self.pose_at(&seen, points, vote.votes);
            let found = found.map(|found| found.pose);
            poses.extend(found.filter(|pose| {
                pose.matches.len() >= FEWEST_MATCHES
                    && contradict(&pose.world_from_rig, here)
                    && !shows_the_same(pose)
            }));
        }
        poses
    }
}

/// Points that each feature of an image may show but those that it shows where the rig is said to be.
fn what_does_not_fit(
    localizer: &Localizer,
    features: &FrameFeatures,
    mounted: &MountedCamera,
    candidates: &[Candidates],
    world_from_rig: &Se3,
) -> Vec<Candidates> {
    let camera_from_world = (*world_from_rig * mounted.rig_from_camera).inverse();
    let radius_px = FITS_RADII * localizer.config.projection_radius_px;
    let keypoints = features.features.keypoints.iter();
    let mut candidates = candidates.to_vec();
    for (candidates, keypoint) in candidates.iter_mut().zip(keypoints) {
        let fits = |point: u32| {
            let position = localizer.map().position(point);
            let pixel = position.and_then(|p| mounted.camera.project(&(camera_from_world * p)));
            pixel.is_some_and(|pixel| (pixel - keypoint.pixel_f64()).norm() <= radius_px)
        };
        candidates.retain(|candidate| !fits(candidate.point));
    }
    candidates
}

/// What is made of the images of an instant before the map; `None` where they are not of the rig's cameras.
fn with_query<T>(
    localizer: &Localizer,
    rig: &Rig,
    frames: &[FrameFeatures],
    made: impl FnOnce(&Query) -> Option<T>,
) -> Option<T> {
    let cameras = localizer.mount(frames, rig).ok()?;
    let grids = localizer.grids(frames, &cameras);
    made(&Query {
        map: localizer.map(),
        frames,
        grids: &grids,
        cameras: &cameras,
    })
}

/// The pose near `world_from_rig` at which most points of the map's images around are found in the images of an instant.
fn pose_near(
    localizer: &Localizer,
    rig: &Rig,
    features: &[FrameFeatures],
    world_from_rig: &Se3,
) -> Option<GuidedPose> {
    with_query(localizer, rig, features, |query| {
        let points = localizer.points_around(query.cameras, world_from_rig);
        let found = query.guided_pose(&points, world_from_rig, &localizer.guided());
        found.filter(|found| !contradict(&found.world_from_rig, world_from_rig))
    })
}

/// The pose of an instant near one, by the map's images around there alone; `None` where it does not fit there.
pub(crate) fn localize_near(
    localizer: &Localizer,
    rig: &Rig,
    features: &[FrameFeatures],
    near: &Se3,
) -> Option<Localization> {
    with_query(localizer, rig, features, |query| {
        let candidates = features.iter().map(|f| localizer.look_up(f));
        let candidates: Vec<Vec<Candidates>> = candidates.collect();
        let points = localizer.points_around(query.cameras, near);
        let seen = MatchedQuery::alone(query, &candidates);
        let hypothesis = localizer.pose_at(&seen, points, 0)?;
        let found = Found {
            hypothesis,
            places: 1,
            rival_inliers: 0,
            known_decades: 0.0,
        };
        let found = localizer.judge(found, query)?;
        let is_found = found.probability >= localizer.min_probability()
            && !contradict(&found.world_from_rig, near);
        is_found.then_some(found)
    })
}
