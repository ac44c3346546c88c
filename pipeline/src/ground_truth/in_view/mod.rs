//! Whether what the map says is there is seen.
//!
//! A place that looks like another (the floor above, the next bay) gives matches that agree with one another and with the IMU: what
//! differs is not matched, and leaves no trace in any residual. So points of the map are looked for where the poses say that they must
//! be: those that nothing hid from around there when the place was mapped, as `expected` says. Each is also looked for beside its
//! place. One that is there looks more like itself in its place than beside it; of one that is not there, one look is as good as
//! another. A point in front of which the walk sees other things, as `hidden` says, is not looked for: there or not, it is not found.
//!
//! A keypoint that is not found again proves nothing; that none of a dozen neighbours is, does: what is there or was taken away is a thing
//! with many points on it. So points are judged by cells as large as things are. Points that are few and far between, on plain walls and where
//! edges cross in the image alone, are the least sure ones and on no thing. How much a point says depends on how surely it is found where it is
//! there, and what a cell says is limited: a screen with a hundred points on it is one thing.
//!
//! Who stood there during the scan and has gone since is seen through: what the walk sees around those points is behind them. That says nothing
//! about the place, where another picture on the same wall does, unless much of what is in view is seen through. Where the walk sees nothing around
//! such points, a plain wall may hide them: all of them together are one thing.

mod expected;
mod hidden;
mod share;

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::ops::Range;

use lsfb_geometry::{Vector2, Vector3};
use rayon::prelude::*;

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::walk::{LocalPoint, Walk};
use crate::features::matching::{DESCRIPTOR_NORM, distance_squared};
use crate::features::{Features, KeypointGrid};
use crate::hd_map::HdMap;
use expected::Views;
use hidden::{Around, Sights};
use share::Expected;

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
/// Largest distance of descriptors that show the same point, in units of their norm. Of 9 right walks 94 % of the points that were found were nearer; what is
/// found by chance, of a point that is not there, is farther in seven of eight.
const MAX_DISTANCE: f32 = 0.47;
/// A point must be looked for so often before it counts.
const FEWEST_LOOKS: usize = 3;
/// Points are judged together that lie in a cell no longer, wider or higher than this, metres.
const CELL_M: f64 = 1.0;
/// So many points must lie in it.
const FEWEST_IN_CELL: usize = 10;
/// Share of points that are found in their place where they are not there: 2 % of 1 580 points of 9 walks on other floors.
const FOUND_WHERE_ABSENT: f64 = 0.04;
/// How many times likelier one of the two must make what was found than the other to be believed.
const LIKELIER: f64 = 20.0;
/// What a cell says counts up to here, as a logarithm of that.
const MOST_OF_CELL: f64 = 8.0;
/// A cell is seen through where this share of what is around its points is behind them. Of 213 cells that were
/// there two were.
const SEEN_THROUGH_SHARE: f64 = 0.65;
/// What is seen through says nothing while it is no more than this share of all evidence. Of right walks in a hall with four people who had gone it
/// was 14 %; where everything is seen through, the walk is elsewhere.
const MOST_SEEN_THROUGH: f64 = 0.25;
/// A stretch is judged by what so many cells say at least.
const FEWEST_CELLS: f64 = 4.0;

/// What was found of the points that should be in view, in a stretch of the walk. Evidence is the logarithm of how many times likelier what was
/// found is if the points of a cell are there, or are not, summed up over all cells that say the one or the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct InView {
    pub frames: Range<usize>,
    /// Points that were looked for.
    pub points: usize,
    /// Evidence that they are there.
    pub there: f64,
    /// Evidence that they are not, where the walk sees things beside them.
    pub absent: f64,
    /// As much of that as one cell has, at most.
    pub most_absent: f64,
    /// Evidence that they are not, where it sees what is behind them.
    pub seen_through: f64,
    /// Evidence that they are not, where it sees nothing that could hide them.
    pub unseen: f64,
}

impl InView {
    /// Of these frames, before anything was found.
    fn of(frames: Range<usize>) -> Self {
        Self {
            frames,
            ..Self::default()
        }
    }

    /// All evidence that counts against the place.
    fn against(&self) -> f64 {
        let all = self.there + self.absent + self.unseen + self.seen_through;
        let may_have_gone = self.seen_through <= MOST_SEEN_THROUGH * all;
        let seen_through = if may_have_gone {
            0.0
        } else {
            self.seen_through
        };
        self.absent + self.unseen.min(MOST_OF_CELL) + seen_through
    }

    /// The same without one cell: what hangs in one place may have been taken away.
    fn absent_elsewhere(&self) -> f64 {
        let most = self.most_absent.max(self.unseen.min(MOST_OF_CELL));
        self.against() - most.min(self.against())
    }

    /// Share of that in all evidence.
    pub fn absent_share(&self) -> f64 {
        let absent = self.absent_elsewhere();
        absent / (self.there + absent).max(f64::MIN_POSITIVE)
    }

    /// Logarithm of how many times likelier all that was found is if it is this place.
    fn for_this_place(&self) -> f64 {
        self.there - self.absent_elsewhere()
    }

    /// Whether what was found speaks more against this place than for it.
    pub fn is_refuted(&self) -> bool {
        self.for_this_place() < 0.0
    }

    /// Whether what was found here makes this the likelier place of the two by far.
    pub fn is_likelier_than(&self, other: &Self) -> bool {
        self.for_this_place() >= other.for_this_place() + LIKELIER.ln()
    }

    /// Whether there is enough of it to tell the place from one that is built alike.
    pub fn is_judged(&self) -> bool {
        self.there + self.against() >= FEWEST_CELLS * MOST_OF_CELL
    }

    /// Whether so much is absent that this may be another place.
    pub fn is_doubtful(&self, config: &GroundTruthConfig) -> bool {
        let is_believed = self.absent_elsewhere() >= LIKELIER.ln();
        is_believed && self.absent_share() > config.max_absent_share
    }

    /// What was found in all stretches of a walk together.
    pub fn of_walk(stretches: &[Self]) -> Self {
        let first = stretches.first().map_or(0, |v| v.frames.start);
        let end = stretches.last().map_or(0, |v| v.frames.end);
        let mut whole = Self::of(first..end);
        for stretch in stretches {
            whole.points += stretch.points;
            whole.there += stretch.there;
            whole.absent += stretch.absent;
            whole.most_absent = whole.most_absent.max(stretch.most_absent);
            whole.seen_through += stretch.seen_through;
            whole.unseen += stretch.unseen;
        }
        whole
    }
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
    /// What the walk sees around it.
    around: Around,
    /// As [`Views::size`] and [`Views::aside_rad`] have it.
    size: f64,
    aside_rad: f64,
}

/// Looks for the points of the map that should be in view, wherever a walk is said to be.
pub(super) struct Search<'a> {
    walk: &'a Walk,
    features: &'a [Features],
    map: &'a HdMap,
    /// Stretches of the walk, and the frames of each that are looked at.
    spans: Vec<(Range<usize>, Vec<usize>)>,
    views: Views<'a>,
    sights: Sights,
}

impl<'a> Search<'a> {
    /// What the solved walk sees in front of points is as far away wherever it is.
    pub fn new(
        walk: &'a Walk,
        (estimate, points): (&Estimate, &[LocalPoint]),
        features: &'a [Features],
        map: &'a HdMap,
        config: &GroundTruthConfig,
    ) -> Self {
        let spans: Vec<(Range<usize>, Vec<usize>)> = spans(walk)
            .into_iter()
            .map(|frames| (frames.clone(), chosen_frames(walk, frames, config)))
            .collect();
        let chosen = spans.iter().flat_map(|(_, chosen)| chosen.iter().copied());
        Self {
            walk,
            features,
            map,
            views: Views::of(map),
            sights: Sights::of(walk, estimate, points, chosen),
            spans,
        }
    }

    /// What is found in each stretch where an estimate has the walk.
    pub fn judge(&self, estimate: &Estimate) -> Vec<InView> {
        let cameras = || 0..self.walk.cameras.len();
        let of_span = |(frames, chosen): &(Range<usize>, Vec<usize>)| {
            let looks: Vec<Look> = chosen
                .par_iter()
                .flat_map_iter(|k| cameras().flat_map(|camera| self.image(estimate, *k, camera)))
                .collect();
            judged(frames.clone(), &looks, self.map)
        };
        self.spans.iter().map(of_span).collect()
    }

    fn image(&self, estimate: &Estimate, k: usize, camera: usize) -> Vec<Look> {
        let lens = self.walk.cameras[camera].camera();
        let features = &self.features[k * self.walk.cameras.len() + camera];
        let (width, height) = (lens.width, lens.height);
        let grid = KeypointGrid::new(&features.keypoints, width, height, 2.0 * RADIUS_PX);
        let middle_px = 0.5 * f64::from(height);
        let centre = estimate.world_from_camera(k, camera, middle_px).translation;
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
            let pixel = estimate.project(k, camera, &point_in_world)?;
            lens.contains(&pixel, BORDER_PX).then(|| {
                let aside = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
                let aside = aside.map(|(x, y)| pixel + Vector2::new(x, y) * ASIDE_PX);
                let away_m = (point_in_world - centre).norm();
                Look {
                    point,
                    size: self.views.size(point, away_m, lens.focal_px()[0]),
                    aside_rad: self.views.aside_rad(point, &centre),
                    around: self.sights.around(k, camera, &pixel, away_m),
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
    expected: Expected,
    is_found: bool,
    looks: usize,
    /// How much the walk sees around it in all looks, and how much of that is behind it.
    around: usize,
    behind: usize,
}

impl Sought {
    /// Logarithm of how many times likelier what was found is if the point is there.
    fn likelihood(&self) -> f64 {
        let there = self.expected.share_found().max(FOUND_WHERE_ABSENT);
        match self.is_found {
            true => (there / FOUND_WHERE_ABSENT).ln(),
            false => ((1.0 - there) / (1.0 - FOUND_WHERE_ABSENT)).ln(),
        }
    }
}

/// Of each point its best look counts; of the points of a cell what they say together.
fn judged(frames: Range<usize>, looks: &[Look], map: &HdMap) -> InView {
    let mut by_point: BTreeMap<u32, Vec<&Look>> = BTreeMap::new();
    for look in looks {
        by_point.entry(look.point).or_default().push(look);
    }
    let mut sought: Vec<Sought> = by_point
        .into_iter()
        .filter(|(_, looks)| looks.len() >= FEWEST_LOOKS)
        .map(|(point, looks)| {
            let around: Around = looks.iter().map(|look| look.around).sum();
            (point, looks, around)
        })
        .filter(|(_, _, around)| !around.hides())
        .filter_map(|(point, looks, around)| {
            let in_place = looks.iter().filter_map(|look| look.in_place).min();
            let beside = looks.iter().filter_map(|look| look.beside).min();
            let is_better = |own: u32| beside.is_none_or(|beside| own < beside);
            Some(Sought {
                point_in_world: map.position(point)?,
                expected: Expected {
                    size: looks.iter().map(|look| look.size).fold(0.0, f64::max),
                    aside_rad: looks.iter().map(|l| l.aside_rad).fold(PI, f64::min),
                    spread_per_image: spread(map, point),
                },
                is_found: in_place.is_some_and(is_better),
                looks: looks.len(),
                behind: around.behind,
                around: around.all,
            })
        })
        .collect();
    let mut found = InView::of(frames);
    found.points = sought.len();
    judge_cells(&mut sought, &mut found);
    found
}

/// How far the descriptors of a point are apart at most, in units of their norm, by the images that show it.
fn spread(map: &HdMap, point: u32) -> f64 {
    let known = map.descriptors(point);
    let pairs = known.iter().enumerate();
    let pairs = pairs.flat_map(|(k, one)| known[..k].iter().map(move |other| (one, other)));
    let farthest = pairs.map(|(one, other)| distance_squared(one, other)).max();
    let farthest = f64::from(farthest.unwrap_or(0)).sqrt() / f64::from(DESCRIPTOR_NORM);
    farthest / map.observations(point).count().max(1) as f64
}

/// Halves the space in which the points lie until it is a cell.
fn judge_cells(sought: &mut [Sought], found: &mut InView) {
    if sought.len() < FEWEST_IN_CELL {
        return;
    }
    let ends = |axis: usize| {
        let at = sought.iter().map(|s| s.point_in_world[axis]);
        let low = at.clone().fold(f64::INFINITY, f64::min);
        (low, at.fold(f64::NEG_INFINITY, f64::max))
    };
    let long_m = |axis: usize| ends(axis).1 - ends(axis).0;
    let widest = (0..3)
        .max_by(|a, b| long_m(*a).total_cmp(&long_m(*b)))
        .unwrap_or(0);
    if long_m(widest) > CELL_M {
        let (low, high) = ends(widest);
        let middle = 0.5 * (low + high);
        // The sort is stable: of equals the one of lower index comes first.
        sought.sort_by(|a, b| a.point_in_world[widest].total_cmp(&b.point_in_world[widest]));
        let first = sought.partition_point(|s| s.point_in_world[widest] <= middle);
        let (low, high) = sought.split_at_mut(first);
        judge_cells(low, found);
        judge_cells(high, found);
        return;
    }
    let sum: f64 = sought.iter().map(Sought::likelihood).sum();
    let said = sum.abs().min(MOST_OF_CELL);
    match surroundings(sought) {
        _ if sum >= 0.0 => found.there += said,
        Surroundings::Behind => found.seen_through += said,
        Surroundings::Nothing => found.unseen += said,
        Surroundings::Beside => {
            found.absent += said;
            found.most_absent = found.most_absent.max(said);
        }
    }
}

/// What the walk sees around points that are not there.
enum Surroundings {
    /// Things behind them: where they were mapped nothing is any more.
    Behind,
    /// Fewer than one thing in a look: whether something hides them, such as a plain wall, is not known.
    Nothing,
    Beside,
}

fn surroundings(sought: &[Sought]) -> Surroundings {
    let looks: usize = sought.iter().map(|s| s.looks).sum();
    let around: usize = sought.iter().map(|s| s.around).sum();
    let behind: usize = sought.iter().map(|s| s.behind).sum();
    if around > 0 && behind as f64 >= SEEN_THROUGH_SHARE * around as f64 {
        Surroundings::Behind
    } else if around < looks {
        Surroundings::Nothing
    } else {
        Surroundings::Beside
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sought(x: f64, y: f64, is_found: bool) -> Sought {
        Sought {
            point_in_world: Vector3::new(x, y, 0.0),
            expected: Expected {
                size: 1.0,
                aside_rad: 0.0,
                spread_per_image: 0.05,
            },
            is_found,
            looks: 5,
            around: 20,
            behind: 4,
        }
    }

    fn judged(points: impl IntoIterator<Item = Sought>) -> InView {
        let mut points: Vec<Sought> = points.into_iter().collect();
        let mut found = InView::of(0..1);
        judge_cells(&mut points, &mut found);
        found
    }

    /// A hundred points on a thing that is not a metre large.
    fn thing(x: f64, is_found: bool) -> impl Iterator<Item = Sought> {
        (0..100).map(move |k| sought(x + 0.009 * f64::from(k), 0.1 * f64::from(k % 7), is_found))
    }

    /// A screen of a metre in a hall made ten groups of points, and half of all that was said to be absent.
    #[test]
    fn a_thing_with_many_points_is_one_thing() {
        let others = (1..10).flat_map(|n| thing(3.0 * f64::from(n), true));
        let found = judged(thing(0.0, false).chain(others));
        assert_eq!(
            (found.absent, found.most_absent),
            (MOST_OF_CELL, MOST_OF_CELL)
        );
        assert!(found.there >= 9.0 * MOST_OF_CELL && found.is_judged());
        assert_eq!(found.absent_share(), 0.0, "one thing proves nothing");
        let two = judged(
            thing(0.0, false)
                .chain(thing(1.5, false))
                .chain(thing(5.0, true)),
        );
        assert!((two.absent_share() - 0.5).abs() < 1e-9, "{two:?}");
    }

    /// What two things say that are absent, where the walk sees so much around each of their points, and so much of that behind it.
    fn two_absent(around: usize, behind: usize) -> InView {
        let points = thing(0.0, false).chain(thing(3.0, false));
        judged(points.map(|point| Sought {
            around,
            behind,
            ..point
        }))
    }

    /// In an atrium three right walks were refused for the four people who had stood there while it was scanned.
    #[test]
    fn who_has_gone_says_nothing() {
        let said = 2.0 * MOST_OF_CELL;
        assert_eq!(two_absent(20, 10).absent, said);
        let gone = two_absent(20, 15);
        assert_eq!((gone.absent, gone.seen_through), (0.0, said));
        let in_a_hall = InView {
            there: 4.0 * said,
            ..gone.clone()
        };
        assert_eq!(in_a_hall.absent_share(), 0.0);
        let elsewhere = InView {
            there: 2.0 * said,
            ..gone
        };
        assert_eq!(elsewhere.absent_share(), 1.0 / 3.0, "too much has gone");
    }

    /// In a house park a shelf behind a plain wall was said to be absent as two things.
    #[test]
    fn behind_a_plain_wall_all_is_one_thing() {
        let hidden = two_absent(4, 0);
        assert_eq!((hidden.absent, hidden.unseen), (0.0, 2.0 * MOST_OF_CELL));
        assert_eq!(hidden.absent_share(), 0.0);
        assert_eq!(two_absent(5, 0).absent_share(), 1.0);
    }

    /// On the plain walls of an atrium, and where edges cross in the image alone, one point in two metres was not found again, and right walks were
    /// refused.
    #[test]
    fn points_far_between_are_on_no_thing() {
        let found = judged((0..200).map(|k| sought(0.7 * f64::from(k), 0.0, false)));
        assert_eq!((found.there, found.absent), (0.0, 0.0));
        assert!(!found.is_judged());
    }

    /// That hard points are not found says little, that easy ones are not says much.
    #[test]
    fn what_is_hard_to_find_says_little() {
        let cell = |aside_rad: f64| {
            let points = (0..10).map(|k| {
                let mut point = sought(0.05 * f64::from(k), 0.0, false);
                point.expected.aside_rad = aside_rad;
                point
            });
            judged(points).absent
        };
        assert_eq!(cell(0.0), MOST_OF_CELL);
        assert!(cell(0.34) < 0.8 * MOST_OF_CELL, "{}", cell(0.34));
    }
}
