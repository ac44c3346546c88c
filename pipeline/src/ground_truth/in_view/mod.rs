//! Whether what the map says is there is seen.
//!
//! A place that looks like another (the floor above, the next bay) gives matches that agree with one another and with the IMU: what
//! differs is not matched, and leaves no trace in any residual. So points of the map are looked for where the poses say that they must
//! be: those that nothing hid from around there when the place was mapped, as `expected` says. Each is also looked for beside its
//! place. One that is there looks more like itself in its place than beside it; of one that is not there, one look is as good as
//! another. A keypoint that is not found again proves nothing; that none of a dozen neighbours is, does:
//! points that lie together are there or absent together. How much it proves depends on how surely the point is found where it is there: few
//! images of the map that show it, and a place from which it is smaller than in any of them, make it unsure.

mod expected;

use std::collections::BTreeMap;
use std::ops::Range;

use lsfb_geometry::{Vector2, Vector3};
use rayon::prelude::*;

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::walk::Walk;
use crate::features::matching::{DESCRIPTOR_NORM, distance_squared};
use crate::features::{Features, KeypointGrid};
use crate::hd_map::HdMap;
use expected::Views;

/// Time about which one judgement is made, seconds.
const SPAN_SECS: f64 = 10.0;
/// Frames that are looked at are this far apart, seconds.
const STEP_SECS: f64 = 0.15;
/// They have this many times as many map points as are needed to place them: in others it may be dark.
const WELL_PLACED: usize = 3;
/// How far from its place a point is looked for, pixels, and how far aside the other places are.
const RADIUS_PX: f64 = 5.0;
const ASIDE_PX: f64 = 23.0;
/// Points this near to the border of an image may be outside, pixels.
const BORDER_PX: f64 = ASIDE_PX + RADIUS_PX;
/// Largest distance of descriptors that may show the same point, in units of their norm.
const MAX_DISTANCE: f32 = 0.75;
/// A point must be looked for so often before it counts.
const FEWEST_LOOKS: usize = 3;
/// Points that lie together are judged together, at most so many.
const GROUP: usize = 12;
/// Share of points that look most like themselves in their place, where they are there, by how many images of the map show them: two, three
/// and so on; the last holds for more. What two images have in common is often no point at all, or is seen from hardly anywhere.
const FOUND_WHERE_THERE: [f64; 5] = [0.5, 0.65, 0.75, 0.75, 0.85];
/// Of points that are smaller than the map's images show them anywhere, as of what is smaller than the detector's finest scale, that share
/// falls with this power of the size.
const FOUND_BY_SIZE: f64 = 1.5;
/// Share of points that look most like themselves in their place, where they are not there.
const FOUND_WHERE_ABSENT: f64 = 0.25;
/// How many times likelier one of the two must make what was found than the other.
const LIKELIER: f64 = 20.0;

/// So many points must be certain before a stretch is judged by them.
pub(super) const FEWEST_CERTAIN: usize = 4 * GROUP;
/// So many that are absent make it doubtful, however few are certain: two groups that lie apart do not go missing by chance.
const FEWEST_ABSENT: usize = 2 * GROUP;

/// What was found of the points that should be in view, in a stretch of the walk.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct InView {
    pub frames: Range<usize>,
    /// Points that are there.
    pub there: usize,
    /// Points that should be there and are not.
    pub absent: usize,
}

impl InView {
    /// Points of which it is certain whether they are there.
    pub fn certain(&self) -> usize {
        self.there + self.absent
    }

    /// Whether there are enough of them to tell the place from one that is built alike.
    pub fn is_judged(&self) -> bool {
        self.certain() >= FEWEST_CERTAIN
    }

    /// Whether so much is absent that this may be another place.
    pub fn is_doubtful(&self, config: &GroundTruthConfig) -> bool {
        // One group alone is no other place.
        let is_enough = self.absent > GROUP && self.is_judged() || self.absent >= FEWEST_ABSENT;
        is_enough && self.absent as f64 > config.max_absent_share * self.certain() as f64
    }

    /// What was found in all stretches of a walk together.
    pub fn of_walk(stretches: &[Self]) -> Self {
        let first = stretches.first().map_or(0, |v| v.frames.start);
        let end = stretches.last().map_or(0, |v| v.frames.end);
        Self {
            frames: first..end,
            there: stretches.iter().map(|v| v.there).sum(),
            absent: stretches.iter().map(|v| v.absent).sum(),
        }
    }
}

/// Looks for the points of the map that should be in view.
pub(super) fn look_for_points(
    walk: &Walk,
    estimate: &Estimate,
    features: &[Features],
    map: &HdMap,
    config: &GroundTruthConfig,
) -> Vec<InView> {
    let search = Search {
        walk,
        estimate,
        features,
        map,
        views: Views::of(map),
    };
    spans(walk)
        .into_iter()
        .map(|frames| {
            let chosen = chosen_frames(walk, frames.clone(), config);
            let looks: Vec<Look> = chosen
                .into_par_iter()
                .flat_map_iter(|k| search.frame(k))
                .collect();
            judged(frames, &looks, map)
        })
        .collect()
}

/// Stretches of equal length, about [`SPAN_SECS`] each.
fn spans(walk: &Walk) -> Vec<Range<usize>> {
    let (Some(first), Some(last)) = (walk.frames.first(), walk.frames.last()) else {
        return Vec::new();
    };
    let whole_secs = last.time.secs_since(first.time);
    // A stamp that is years off makes no more stretches than there are frames.
    let most = walk.frames.len() as f64;
    let count = (whole_secs / SPAN_SECS).round().clamp(1.0, most.max(1.0));
    let border = |k: f64| {
        let until_secs = whole_secs * k / count;
        walk.frames
            .partition_point(|f| f.time.secs_since(first.time) < until_secs)
    };
    let mut spans = Vec::new();
    let mut from = 0;
    for k in 1..count as usize {
        let to = border(k as f64);
        spans.push(from..to);
        from = to;
    }
    spans.push(from..walk.frames.len());
    spans
}

fn chosen_frames(walk: &Walk, frames: Range<usize>, config: &GroundTruthConfig) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    for k in frames {
        let frame = &walk.frames[k];
        let is_due = chosen
            .last()
            .is_none_or(|last| frame.time.secs_since(walk.frames[*last].time) >= STEP_SECS);
        if is_due && frame.fixed.len() >= WELL_PLACED * config.min_map_points {
            chosen.push(k);
        }
    }
    chosen
}

/// A point looked for in one image: squared distances of the most similar descriptors in its place and beside it.
struct Look {
    point: u32,
    in_place: Option<u32>,
    beside: Option<u32>,
    /// As [`Views::size`] has it.
    size: f64,
}

struct Search<'a> {
    walk: &'a Walk,
    estimate: &'a Estimate,
    features: &'a [Features],
    map: &'a HdMap,
    views: Views<'a>,
}

impl Search<'_> {
    fn frame(&self, k: usize) -> Vec<Look> {
        let cameras = 0..self.walk.cameras.len();
        cameras.flat_map(|camera| self.image(k, camera)).collect()
    }

    fn image(&self, k: usize, camera: usize) -> Vec<Look> {
        let lens = self.walk.cameras[camera].camera();
        let features = &self.features[k * self.walk.cameras.len() + camera];
        let (width, height) = (lens.width, lens.height);
        let grid = KeypointGrid::new(&features.keypoints, width, height, 2.0 * RADIUS_PX);
        let middle_px = 0.5 * f64::from(height);
        let centre = self
            .estimate
            .world_from_camera(k, camera, middle_px)
            .translation;
        let nearest = |at: Vector2<f64>, point: u32| {
            let keypoints = grid.within(&at, RADIUS_PX);
            let seen = keypoints.filter_map(|j| features.descriptors.get(j as usize));
            let known = self.map.descriptors(point);
            let distances = seen.flat_map(|seen| known.iter().map(|d| distance_squared(d, seen)));
            distances
                .min()
                .filter(|d| *d <= (MAX_DISTANCE * DESCRIPTOR_NORM).powi(2) as u32)
        };
        let expected = self.views.expected(&centre).into_iter();
        let looks = expected.filter_map(|point| {
            let point_in_world = self.map.position(point)?;
            let pixel = self.estimate.project(k, camera, &point_in_world)?;
            lens.contains(&pixel, BORDER_PX).then(|| {
                let aside = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
                let aside = aside.map(|(x, y)| pixel + Vector2::new(x, y) * ASIDE_PX);
                let away_m = (point_in_world - centre).norm();
                Look {
                    point,
                    size: self.views.size(point, away_m, lens.focal_px()[0]),
                    in_place: nearest(pixel, point),
                    beside: aside.into_iter().filter_map(|at| nearest(at, point)).min(),
                }
            })
        });
        looks.collect()
    }
}

/// A point that was looked for often enough.
struct Sought {
    point_in_world: Vector3<f64>,
    /// Images of the map that show it.
    images: usize,
    /// Where it is largest, as [`Views::size`] has it.
    size: f64,
    is_found: bool,
}

impl Sought {
    /// Logarithm of how many times likelier what was found is if the point is there.
    fn likelihood(&self) -> f64 {
        let last = FOUND_WHERE_THERE.len() - 1;
        let there = FOUND_WHERE_THERE[self.images.saturating_sub(2).min(last)];
        let there = there * self.size.min(1.0).powf(FOUND_BY_SIZE);
        let there = there.max(FOUND_WHERE_ABSENT);
        match self.is_found {
            true => (there / FOUND_WHERE_ABSENT).ln(),
            false => ((1.0 - there) / (1.0 - FOUND_WHERE_ABSENT)).ln(),
        }
    }
}

/// Of each point its best look counts; of points that lie together what they say together.
fn judged(frames: Range<usize>, looks: &[Look], map: &HdMap) -> InView {
    let mut by_point: BTreeMap<u32, Vec<&Look>> = BTreeMap::new();
    for look in looks {
        by_point.entry(look.point).or_default().push(look);
    }
    let mut sought: Vec<Sought> = by_point
        .into_iter()
        .filter(|(_, looks)| looks.len() >= FEWEST_LOOKS)
        .filter_map(|(point, looks)| {
            let in_place = looks.iter().filter_map(|look| look.in_place).min();
            let beside = looks.iter().filter_map(|look| look.beside).min();
            let is_better = |own: u32| beside.is_none_or(|beside| own < beside);
            Some(Sought {
                point_in_world: map.position(point)?,
                images: map.observations(point).count(),
                size: looks.iter().map(|look| look.size).fold(0.0, f64::max),
                is_found: in_place.is_some_and(is_better),
            })
        })
        .collect();
    let mut found = InView {
        frames,
        there: 0,
        absent: 0,
    };
    judge_groups(&mut sought, &mut found);
    found
}

/// Halves the points where they spread most until they lie together.
fn judge_groups(sought: &mut [Sought], found: &mut InView) {
    if sought.len() > GROUP {
        let spread = |axis: usize| {
            let at = sought.iter().map(|s| s.point_in_world[axis]);
            at.clone().fold(f64::NEG_INFINITY, f64::max) - at.fold(f64::INFINITY, f64::min)
        };
        let widest = (0..3)
            .max_by(|a, b| spread(*a).total_cmp(&spread(*b)))
            .unwrap_or(0);
        // The sort is stable: of equals the one of lower index comes first.
        sought.sort_by(|a, b| a.point_in_world[widest].total_cmp(&b.point_in_world[widest]));
        let (low, high) = sought.split_at_mut(sought.len() / 2);
        judge_groups(low, found);
        judge_groups(high, found);
        return;
    }
    let sum: f64 = sought.iter().map(Sought::likelihood).sum();
    if sum >= LIKELIER.ln() {
        found.there += sought.len();
    } else if sum <= -LIKELIER.ln() {
        found.absent += sought.len();
    }
}
