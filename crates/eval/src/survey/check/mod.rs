//! A trajectory against surveyed marks on which the device rested.

mod far;
mod judge;

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::{StampedPose, Vector2, Vector3};
use serde::Serialize;

use super::file::Survey;
use super::rests::Rest;
use super::solution::SurveySolution;
use crate::{Error, Statistics};

/// Marks nearer to each other than this give no heading.
const LEAST_BASE_M: f64 = 0.5;
/// Poses further apart in time are not joined by a line.
const BREAK_SECS: f64 = 1.0;
/// Rests times marks beyond which trying all pairs of pairs takes too long.
const MOST_PAIRS: usize = 10_000;
/// A rest so many times as far from a mark as it may be, and no other mark's, is that mark's all the same: there the trajectory is off.
const FAR: f64 = 5.0;
/// Another assignment of as many rests makes the best one doubtful where its errors are no larger than this many times.
const RIVAL: f64 = 2.0;

/// The error of one rest.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MarkError {
    /// The mark.
    pub mark: String,
    /// When the rest began, seconds since the first pose.
    pub start_secs: f64,
    /// How long it lasted, seconds.
    pub duration_secs: f64,
    /// Position less mark after alignment, metres: along x, y and upwards.
    pub error_m: [f64; 3],
    /// Its length, metres.
    pub distance_m: f64,
}

/// A mark that the device visited where the trajectory rests out of reach of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FarMark {
    /// The mark.
    pub mark: String,
    /// When the rest began, seconds since the first pose.
    pub start_secs: f64,
    /// From the mark to the rest on the floor, metres, aligned by the marks that were found.
    pub distance_m: f64,
}

/// The trajectory at the marks.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MarkReport {
    /// In order of time.
    pub marks: Vec<MarkError>,
    /// Of the errors' lengths, metres, after SE(3) alignment to the marks.
    pub ate_m: Statistics,
    /// Rests that belong to no mark.
    pub other_rests: usize,
    /// The trajectory's places in the survey's coordinates, z upwards from the mean of the marks, metres; where it breaks off, a new piece begins.
    #[serde(skip)]
    pub pieces: Vec<Vec<Vector3<f64>>>,
    /// All rests, likewise.
    #[serde(skip)]
    pub aligned_rests: Vec<Vector3<f64>>,
    /// Visits for which no rest was found; the marks without a rest where the order of visits is not known.
    pub missing: Vec<String>,
    /// Of these, those with a rest that is out of reach and no other mark's: the errors of `ate_m` are without them.
    pub far: Vec<FarMark>,
}

/// Tells which mark each rest of a trajectory is, aligns, and measures. The trajectory's z must point upwards. A rest belongs to no mark
/// that is further away than `reach_m`, metres.
pub fn check_marks(
    survey: &Survey,
    solution: &SurveySolution,
    poses: &[StampedPose],
    rests: &[Rest],
    reach_m: f64,
) -> Result<MarkReport, Error> {
    let visits: Vec<String> = match survey.visits.is_empty() {
        true => solution.marks.iter().map(|m| m.name.clone()).collect(),
        false => survey.visits.clone(),
    };
    let places = visits
        .iter()
        .map(|name| {
            solution
                .place(name)
                .ok_or_else(|| Error::UnknownMark { mark: name.clone() })
        })
        .collect::<Result<Vec<_>, _>>()?;
    let order = match survey.visits.is_empty() {
        true => Order::Unknown,
        false => Order::Known,
    };
    let pairs = assign(rests, &places, order, reach_m)?;
    let mut found = report(&visits, &places, rests, poses, &pairs)?;
    let first = poses.first().map(|p| p.time).unwrap_or_default();
    let far = far::marks(&places, &found.aligned_rests, &pairs, order, FAR * reach_m);
    found.far = far
        .into_iter()
        .map(|far| FarMark {
            mark: visits[far.place].clone(),
            start_secs: rests[far.rest].start.secs_since(first),
            distance_m: far.distance_m,
        })
        .collect();
    Ok(found)
}

/// Whether marks were visited in the order of their list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    Known,
    Unknown,
}

/// Indices of a rest and of its place.
type Pairs = Vec<(usize, usize)>;

/// Which rest is which mark: of all ways to lay two rests on two marks that which explains the most rests, and these best.
fn assign(
    rests: &[Rest],
    places: &[Vector2<f64>],
    order: Order,
    reach_m: f64,
) -> Result<Pairs, Error> {
    let too_few = || Error::TooFewRests {
        rests: rests.len(),
        marks: places.len(),
    };
    if rests.len() < 3 {
        return Err(too_few());
    }
    if rests.len() * places.len() > MOST_PAIRS {
        return Err(Error::TooManyRests {
            rests: rests.len(),
            marks: places.len(),
        });
    }
    let on_floor: Vec<Vector2<f64>> = rests.iter().map(|r| r.place.xy()).collect();
    let mut best: Option<(Pairs, f64)> = None;
    let mut rivals: Vec<(Pairs, f64)> = Vec::new();
    for i in 0..rests.len() {
        for j in 0..rests.len() {
            let base = on_floor[j] - on_floor[i];
            if i == j || base.norm() < LEAST_BASE_M || (order == Order::Known && j < i) {
                continue;
            }
            for a in 0..places.len() {
                for b in 0..places.len() {
                    let wanted = places[b] - places[a];
                    let fits = (wanted.norm() - base.norm()).abs() < reach_m;
                    if a == b || !fits || (order == Order::Known && b < a) {
                        continue;
                    }
                    let turn = (wanted.y * base.x - wanted.x * base.y).atan2(wanted.dot(&base));
                    let rotation = nalgebra::Rotation2::new(turn);
                    let moved: Vec<Vector2<f64>> = on_floor
                        .iter()
                        .map(|p| places[a] + rotation * (p - on_floor[i]))
                        .collect();
                    let pairs = match order {
                        Order::Known => in_order(&moved, places, reach_m),
                        Order::Unknown => nearest(&moved, places, reach_m),
                    };
                    if pairs.len() < 3 {
                        continue;
                    }
                    let Some(rms_m) = fit_rms(&on_floor, places, &pairs) else {
                        continue;
                    };
                    let found = (pairs, rms_m);
                    let better = best
                        .as_ref()
                        .is_none_or(|(most, rms)| (found.0.len(), -found.1) > (most.len(), -rms));
                    if better {
                        rivals.extend(best.replace(found));
                    } else {
                        rivals.push(found);
                    }
                    rivals.retain(|(pairs, _)| {
                        best.as_ref().is_some_and(|b| pairs.len() >= b.0.len())
                    });
                    rivals.sort_by(|x, y| x.1.total_cmp(&y.1));
                    rivals.dedup_by(|x, y| x.0 == y.0);
                }
            }
        }
    }
    let (pairs, rms_m) = best.ok_or_else(too_few)?;
    // A survey that looks the same from two sides lets the same rests be other marks.
    let worst_m = RIVAL * rms_m.max(0.02);
    match rivals
        .iter()
        .any(|(other, rms)| *other != pairs && *rms <= worst_m)
    {
        true => Err(Error::AmbiguousRests { rests: pairs.len() }),
        false => Ok(pairs),
    }
}

/// The most pairs in the order of both lists, and of these the nearest: dynamic programming.
fn in_order(moved: &[Vector2<f64>], places: &[Vector2<f64>], reach_m: f64) -> Pairs {
    let width = places.len() + 1;
    let mut table = vec![(0usize, 0.0f64); (moved.len() + 1) * width];
    for (i, rest) in moved.iter().enumerate() {
        for (k, place) in places.iter().enumerate() {
            let (above, left, before) = (
                table[i * width + k + 1],
                table[(i + 1) * width + k],
                table[i * width + k],
            );
            let mut best = if is_better(left, above) { left } else { above };
            let off_m = (rest - place).norm();
            if off_m <= reach_m {
                let joined = (before.0 + 1, before.1 + off_m);
                if is_better(joined, best) {
                    best = joined;
                }
            }
            table[(i + 1) * width + k + 1] = best;
        }
    }
    let (mut i, mut k) = (moved.len(), places.len());
    let mut pairs = Vec::new();
    while i > 0 && k > 0 {
        let here = table[i * width + k];
        if here == table[(i - 1) * width + k] {
            i -= 1;
        } else if here == table[i * width + k - 1] {
            k -= 1;
        } else {
            pairs.push((i - 1, k - 1));
            i -= 1;
            k -= 1;
        }
    }
    pairs.reverse();
    pairs
}

fn is_better(a: (usize, f64), b: (usize, f64)) -> bool {
    a.0 > b.0 || a.0 == b.0 && a.1 < b.1
}

/// Each rest with the nearest place in reach.
fn nearest(moved: &[Vector2<f64>], places: &[Vector2<f64>], reach_m: f64) -> Pairs {
    let of = |rest: &Vector2<f64>| {
        let off = |place: &Vector2<f64>| (place - rest).norm();
        let found =
            (0..places.len()).min_by(|a, b| off(&places[*a]).total_cmp(&off(&places[*b])))?;
        (off(&places[found]) <= reach_m).then_some(found)
    };
    let rests = moved.iter().enumerate();
    rests.filter_map(|(i, rest)| Some((i, of(rest)?))).collect()
}

/// Root mean square after the best turn and shift on the floor; `None` where the places are all one.
fn fit_rms(rests: &[Vector2<f64>], places: &[Vector2<f64>], pairs: &Pairs) -> Option<f64> {
    let count = pairs.len() as f64;
    let mean = |of: &dyn Fn(&(usize, usize)) -> Vector2<f64>| {
        pairs.iter().map(of).sum::<Vector2<f64>>() / count
    };
    let (rest_mean, place_mean) = (mean(&|p| rests[p.0]), mean(&|p| places[p.1]));
    let (mut along, mut across) = (0.0, 0.0);
    for (i, k) in pairs {
        let (r, p) = (rests[*i] - rest_mean, places[*k] - place_mean);
        along += r.dot(&p);
        across += r.x * p.y - r.y * p.x;
    }
    if along.hypot(across) < 1e-9 {
        return None;
    }
    let rotation = nalgebra::Rotation2::new(across.atan2(along));
    let off = pairs.iter().map(|(i, k)| {
        (rotation * (rests[*i] - rest_mean) + place_mean - places[*k]).norm_squared()
    });
    Some((off.sum::<f64>() / count).sqrt())
}

fn report(
    visits: &[String],
    places: &[Vector2<f64>],
    rests: &[Rest],
    poses: &[StampedPose],
    pairs: &Pairs,
) -> Result<MarkReport, Error> {
    let source: Vec<Vector3<f64>> = pairs.iter().map(|(i, _)| rests[*i].place).collect();
    let target: Vec<Vector3<f64>> = pairs.iter().map(|(_, k)| places[*k].push(0.0)).collect();
    let alignment = umeyama(&source, &target, Scale::Fixed).ok_or(Error::Degenerate)?;
    let first = poses.first().map(|p| p.time).unwrap_or_default();
    let errors: Vec<MarkError> = pairs
        .iter()
        .map(|(i, k)| {
            let error = alignment.apply(&rests[*i].place) - places[*k].push(0.0);
            MarkError {
                mark: visits[*k].clone(),
                start_secs: rests[*i].start.secs_since(first),
                duration_secs: rests[*i].end.secs_since(rests[*i].start),
                error_m: error.into(),
                distance_m: error.norm(),
            }
        })
        .collect();
    let lengths: Vec<f64> = errors.iter().map(|e| e.distance_m).collect();
    let missing = (0..visits.len()).filter(|k| pairs.iter().all(|(_, other)| other != k));
    Ok(MarkReport {
        ate_m: Statistics::of(&lengths).ok_or(Error::Degenerate)?,
        marks: errors,
        other_rests: rests.len() - pairs.len(),
        pieces: poses
            .chunk_by(|a, b| b.time.secs_since(a.time) <= BREAK_SECS)
            .map(|piece| {
                let places = piece.iter().map(|p| &p.world_from_rig.translation);
                places.map(|place| alignment.apply(place)).collect()
            })
            .collect(),
        aligned_rests: rests.iter().map(|r| alignment.apply(&r.place)).collect(),
        missing: missing.map(|k| visits[k].clone()).collect(),
        far: Vec::new(),
    })
}

#[cfg(test)]
mod tests;
