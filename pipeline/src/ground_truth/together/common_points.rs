//! Local points of several walks that are one.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_types::{ProgressFn, SharedProgress};
use rayon::prelude::*;

use super::Member;
use crate::Error;
use crate::features::matching::{RayFeatures, match_epipolar};
use crate::frames::times_apart;
use crate::ground_truth::GroundTruthConfig;
use crate::ground_truth::estimate::Estimate;
use crate::ground_truth::local_points::{MatchableImage, camera_pose};
use crate::ground_truth::walk::LocalPoint;

/// Images that are compared are at least so far apart, seconds.
const VIEW_SECS: f64 = 0.3;
/// Images of two walks see the same alike when they are taken from no farther apart than this, metres, and in directions no farther apart.
const NEAR_M: f64 = 1.5;
const NEAR_RAD: f64 = 0.6;
/// Images of another walk that each is compared with, the nearest.
const COMPARED: usize = 3;
/// Pairs of images that must show two points as one.
const VOTES: usize = 2;

/// Two points, each by the number of its walk and its index there.
type Pair = [(usize, usize); 2];

/// A point that several walks see.
pub(super) struct CommonPoint {
    /// By the number of the walk the index of its own point.
    pub own: BTreeMap<usize, usize>,
}

impl CommonPoint {
    /// Where it is by the walk that sees it most.
    pub fn position(&self, members: &[Member<'_>]) -> Vector3<f64> {
        let own = self
            .own
            .iter()
            .map(|(m, p)| &members[*m].solved.last.points[*p]);
        let most = own.max_by_key(|point| used_sights(point));
        most.map_or_else(Vector3::zeros, |point| point.point_in_world)
    }

    /// Whether two walks still see where it is.
    pub fn is_seen_by_two(&self, members: &[Member<'_>]) -> bool {
        let own = self
            .own
            .iter()
            .map(|(m, p)| &members[*m].solved.last.points[*p]);
        own.filter(|point| point.is_determined()).count() >= 2
    }
}

fn used_sights(point: &LocalPoint) -> usize {
    point.observations.iter().filter(|seen| seen.used).count()
}

/// An image of a walk, ready to be matched.
struct View {
    member: usize,
    image: MatchableImage,
    world_from_camera: Se3,
    /// For each keypoint the local point that it shows.
    points: Vec<Option<usize>>,
}

/// Joins local points where images of two walks show them as one.
pub(super) fn common_points(
    members: &[Member<'_>],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Vec<CommonPoint>, Error> {
    let views: Vec<View> = members
        .iter()
        .enumerate()
        .flat_map(|(number, member)| views_of(number, member))
        .collect();
    let pairs = near_pairs(&views);
    let done = SharedProgress::new("common points", pairs.len(), progress);
    let votes: Result<Vec<Vec<Pair>>, Error> = pairs
        .into_par_iter()
        .map(|(a, b)| {
            done.one_more()?;
            Ok(votes_of(&views[a], &views[b], config))
        })
        .collect();
    let mut counts: BTreeMap<Pair, usize> = BTreeMap::new();
    for vote in votes?.into_iter().flatten() {
        *counts.entry(vote).or_default() += 1;
    }
    let mut joins: Vec<(Pair, usize)> = counts.into_iter().collect();
    joins.retain(|(pair, votes)| *votes >= VOTES && fit(pair, members, config));
    // Those that most images show first; the order of equals is that of their numbers.
    joins.sort_by_key(|(pair, votes)| (Reverse(*votes), *pair));
    Ok(joined(&joins))
}

/// Groups in which each walk has one point at most: what contradicts a pair that more images show is left out.
fn joined(joins: &[(Pair, usize)]) -> Vec<CommonPoint> {
    let mut group_of: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    let mut groups: Vec<BTreeMap<usize, usize>> = Vec::new();
    for ([a, b], _) in joins {
        let [of_a, of_b] = [a, b].map(|end| {
            *group_of.entry(*end).or_insert_with(|| {
                groups.push(BTreeMap::from([*end]));
                groups.len() - 1
            })
        });
        let is_free = groups[of_b].keys().all(|m| !groups[of_a].contains_key(m));
        if of_a != of_b && is_free {
            let moved = std::mem::take(&mut groups[of_b]);
            for end in &moved {
                group_of.insert((*end.0, *end.1), of_a);
            }
            groups[of_a].extend(moved);
        }
    }
    groups.retain(|group| group.len() >= 2);
    groups.into_iter().map(|own| CommonPoint { own }).collect()
}

/// Images of what is given of a walk, each a while after the one before.
fn views_of(number: usize, member: &Member<'_>) -> Vec<View> {
    let (walk, last) = (&member.walk, &member.solved.last);
    let cameras = walk.cameras.len();
    let mut shown: BTreeMap<(usize, usize, [u64; 2]), usize> = BTreeMap::new();
    for (index, point) in last.points.iter().enumerate() {
        if !point.is_determined() {
            continue;
        }
        for seen in point.observations.iter().filter(|seen| seen.used) {
            let pixel = [seen.pixel.x.to_bits(), seen.pixel.y.to_bits()];
            shown.insert((seen.frame, seen.camera, pixel), index);
        }
    }
    let times: Vec<_> = walk.frames.iter().map(|f| f.time).collect();
    let chosen = times_apart(&times, VIEW_SECS);
    let given = chosen.into_iter().filter(|k| member.is_given(times[*k]));
    let images: Vec<(usize, usize)> = given
        .flat_map(|frame| (0..cameras).map(move |camera| (frame, camera)))
        .collect();
    images
        .into_par_iter()
        .map(|(frame, camera)| {
            let features = &member.features[frame * cameras + camera];
            let keypoints = features.keypoints.iter().map(|k| k.pixel_f64());
            let point = |pixel: Vector2<f64>| {
                let pixel = [pixel.x.to_bits(), pixel.y.to_bits()];
                shown.get(&(frame, camera, pixel)).copied()
            };
            View {
                member: number,
                image: MatchableImage::new(&last.estimate, frame, camera, features),
                world_from_camera: camera_pose(&last.estimate, frame, camera),
                points: keypoints.map(point).collect(),
            }
        })
        .collect()
}

/// Pairs of images of two walks that are taken from nearly the same place in nearly the same direction: with each image the nearest of each other
/// walk, so that the order of walks does not matter.
fn near_pairs(views: &[View]) -> Vec<(usize, usize)> {
    let members = views.last().map_or(0, |view| view.member + 1);
    let pairs = views.par_iter().enumerate().map(|(here, view)| {
        let apart = |other: &View| {
            let (from, to) = (&view.world_from_camera, &other.world_from_camera);
            let distance_m = (from.translation - to.translation).norm();
            let looks = |pose: &Se3| pose.rotation * Vector3::z();
            let angle_rad = looks(from).angle(&looks(to));
            (distance_m / NEAR_M).max(angle_rad / NEAR_RAD)
        };
        let mut pairs = Vec::new();
        for member in (0..members).filter(|member| *member != view.member) {
            let start = views.partition_point(|v| v.member < member);
            let end = views.partition_point(|v| v.member <= member);
            let mut near: Vec<(f64, usize)> = (start..end)
                .map(|there| (apart(&views[there]), there))
                .filter(|(apart, _)| *apart <= 1.0)
                .collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let near = near.into_iter().take(COMPARED);
            pairs.extend(near.map(|(_, there)| (here.min(there), here.max(there))));
        }
        pairs
    });
    let pairs: BTreeSet<(usize, usize)> = pairs.flatten_iter().collect();
    pairs.into_iter().collect()
}

fn rays(view: &View) -> RayFeatures<'_> {
    RayFeatures {
        descriptors: &view.image.descriptors,
        rays: &view.image.rays,
    }
}

/// Which points two images show as one.
fn votes_of(a: &View, b: &View, config: &GroundTruthConfig) -> Vec<Pair> {
    let matches = match_epipolar(
        rays(a),
        rays(b),
        &(b.world_from_camera.inverse() * a.world_from_camera),
        config.epipolar_tolerance_deg.to_radians(),
        &config.matching,
    );
    let points = |view: &View, keypoint: u32| {
        let point = view.points.get(keypoint as usize).copied().flatten()?;
        Some((view.member, point))
    };
    let votes = matches
        .iter()
        .filter_map(|m| Some([points(a, m.first)?, points(b, m.second)?]));
    votes.collect()
}

/// Whether each of two points is where the other walk sees it.
fn fit(pair: &Pair, members: &[Member<'_>], config: &GroundTruthConfig) -> bool {
    let [a, b] = pair.map(|(m, p)| {
        (
            &members[m].solved.last.estimate,
            &members[m].solved.last.points[p],
        )
    });
    let sees = |(estimate, own): (&Estimate, &LocalPoint), other: &LocalPoint| {
        let there = LocalPoint {
            point_in_world: other.point_in_world,
            observations: Vec::new(),
        };
        let used = own.observations.iter().filter(|seen| seen.used);
        let within = used
            .clone()
            .filter(|seen| estimate.local_error_px(&there, seen) <= config.max_error_px);
        2 * within.count() > used.count()
    };
    sees(a, b.1) && sees(b, a.1)
}
