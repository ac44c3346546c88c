//! Two maps of one place become one: found by their descriptors, aligned by their points, never on weak evidence.

mod contradictions;

use std::collections::BTreeMap;

use lsfb_geometry::align::{Alignment, Scale, umeyama};
use lsfb_geometry::{Matrix3, Se3, StampedPose, Vector3};
use lsfb_perception::statistics::median;
use lsfb_types::{Bounds, ProgressFn};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use contradictions::{common_site, expect_other_images};

use super::build::{MapRows, typical};
use super::{HdMap, HdMapConfig, PointQuality, SearchScratch};
use crate::features::Descriptor;
use crate::{Error, Refusal};

/// Neighbours that are looked at for each descriptor, inverted lists in which they are looked for, and descriptors of these that are
/// compared.
const NEIGHBOURS: usize = 8;
const PROBES: usize = 8;
const COMPARED: usize = 16;
/// Runs of keyframes, one of which is left out at a time to see how firmly the alignment stands.
const GROUPS: usize = 8;
/// Rounds of alignment and choice of the pairs that fit.
const REFINEMENTS: usize = 10;

/// Configuration of [`HdMap::merge`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MergeConfig {
    /// Two points are the same if their descriptors' distance is at most this share of the distance to the next point's …
    pub max_ratio: f64,
    /// … and they lie at most this far apart once the maps are aligned, metres.
    pub gate_m: f64,
    /// Fewest points the maps must share.
    pub min_shared: usize,
    /// Most points that may speak for another alignment, as a share of those that speak for the best.
    pub max_rival_share: f64,
    /// Most that the alignment may be uncertain by at any keyframe of the second map (1 σ), and that another scale may move one, metres.
    pub max_sigma_m: f64,
    /// Samples of three pairs.
    pub samples: usize,
    /// Their seed.
    pub seed: u64,
    /// Descriptors and index of the result.
    pub map: HdMapConfig,
}

impl Default for MergeConfig {
    fn default() -> Self {
        Self {
            max_ratio: 0.8,
            gate_m: 0.1,
            min_shared: 50,
            max_rival_share: 0.25,
            max_sigma_m: 0.02,
            samples: 20_000,
            seed: 1,
            map: HdMapConfig::default(),
        }
    }
}

lsfb_types::bounds! {
    MergeConfig {
        max_ratio: number(Bounds::POSITIVE),
        gate_m: number(Bounds::POSITIVE),
        min_shared: number(Bounds::AT_LEAST_ONE),
        max_rival_share: number(Bounds::POSITIVE),
        max_sigma_m: number(Bounds::POSITIVE),
        samples: number(Bounds::AT_LEAST_ONE),
        seed: any,
        map: section,
    }
}

/// How two maps were found to meet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MergeReport {
    /// Pairs of points with alike descriptors.
    pub pairs: usize,
    /// Of these, the pairs that the alignment brings together: the points that were joined.
    pub shared: usize,
    /// Pairs that speak for the best other alignment.
    pub rival: usize,
    /// Median distance of shared points after the alignment, metres.
    pub median_distance_m: f64,
    /// σ of the alignment (length of the error, 1 σ) at the keyframe of the second map where it is worst, metres.
    pub worst_sigma_m: f64,
    /// How far another scale of the second map would move one of its keyframes at most, metres: a metre that is not the other map's.
    pub scale_shift_m: f64,
    /// Pose of the second map in the first.
    #[serde(skip)]
    pub first_from_second: Se3,
}

/// A pair of points that may be one.
#[derive(Clone, Copy)]
struct Pair {
    first: u32,
    second: u32,
    in_first: Vector3<f64>,
    in_second: Vector3<f64>,
}

impl HdMap {
    /// `self` with the points and keyframes of `second`, moved into the frame of `self`; points found in both are one, at
    /// the mean of both positions weighted by their covariances. Cameras of `second` that have the name of another one
    /// here get a number behind it.
    ///
    /// Refused where the maps share too little, where another alignment is nearly as good (places that repeat), or
    /// where the alignment would not be known well enough at every keyframe of `second`; where both are of the same images; where `second`
    /// alone is surveyed, or its survey puts it elsewhere than its points.
    pub fn merge(
        &self,
        second: &Self,
        config: &MergeConfig,
        progress: ProgressFn,
    ) -> Result<(Self, MergeReport), Error> {
        config.check_bounds("merge")?;
        self.expect_feature(&second.feature)?;
        let pairs = pairs(self, second, config);
        let best = align(&pairs, config);
        let others: Vec<Pair> = pairs
            .iter()
            .filter(|p| distance(&best, p) > 3.0 * config.gate_m)
            .copied()
            .collect();
        let rival = shared(&align(&others, config), &others, config.gate_m).len();
        let shared = shared(&best, &pairs, config.gate_m);
        let distances: Vec<f64> = shared.iter().map(|p| distance(&best, p)).collect();
        let report = MergeReport {
            pairs: pairs.len(),
            shared: shared.len(),
            rival,
            median_distance_m: median(distances).unwrap_or(f64::INFINITY),
            worst_sigma_m: worst_sigma_m(&shared, second),
            scale_shift_m: scale_shift_m(&best, &shared, second),
            first_from_second: best,
        };
        let is_sure = report.shared >= config.min_shared
            && report.rival as f64 <= config.max_rival_share * report.shared as f64
            && report.worst_sigma_m <= config.max_sigma_m
            && report.scale_shift_m <= config.max_sigma_m;
        if !is_sure {
            return Err(Refusal::MapsDoNotMeet {
                pairs: report.pairs,
                shared: report.shared,
                rival: report.rival,
                sigma_m: report.worst_sigma_m,
                scale_shift_m: report.scale_shift_m,
            }
            .into());
        }
        expect_other_images(self, second, &shared)?;
        let mut rows = joined(self, second, &report, &shared, config);
        rows.site = common_site(self, second, &best, config.gate_m)?;
        let merged = Self::from_rows(rows, &config.map.index, progress)?;
        Ok((merged, report))
    }
}

/// For each point of `second`, the point of `first` that looks like it, where none other does.
fn pairs(first: &HdMap, second: &HdMap, config: &MergeConfig) -> Vec<Pair> {
    let points: Vec<u32> = (0..second.point_count() as u32).collect();
    let found = points
        .par_iter()
        .map_init(SearchScratch::default, |scratch, point| {
            // The nearest descriptor of each point of the first map, over all descriptors of this one.
            let mut nearest: BTreeMap<u32, u32> = BTreeMap::new();
            for descriptor in second.descriptors(*point) {
                for n in first.nearest(descriptor, NEIGHBOURS, PROBES, COMPARED, scratch) {
                    let best = nearest.entry(n.point).or_insert(u32::MAX);
                    *best = n.distance_squared.min(*best);
                }
            }
            let mut by_distance: Vec<(u32, u32)> =
                nearest.into_iter().map(|(p, d)| (d, p)).collect();
            by_distance.sort_unstable();
            let (distance, found) = *by_distance.first()?;
            let next = by_distance.get(1).map_or(u32::MAX, |(d, _)| *d);
            let is_alone = f64::from(distance) <= config.max_ratio.powi(2) * f64::from(next);
            Some(Pair {
                first: found,
                second: *point,
                in_first: first.position(found)?,
                in_second: second.position(*point)?,
            })
            .filter(|_| is_alone)
        });
    let mut found: Vec<Pair> = found.flatten().collect();
    // A point of the first map that several claim is none of theirs.
    let mut claims: BTreeMap<u32, usize> = BTreeMap::new();
    found
        .iter()
        .for_each(|p| *claims.entry(p.first).or_default() += 1);
    found.retain(|p| claims.get(&p.first) == Some(&1));
    found
}

fn distance(first_from_second: &Se3, pair: &Pair) -> f64 {
    (*first_from_second * pair.in_second - pair.in_first).norm()
}

fn shared(first_from_second: &Se3, pairs: &[Pair], gate_m: f64) -> Vec<Pair> {
    let near = pairs
        .iter()
        .filter(|p| distance(first_from_second, p) <= gate_m);
    near.copied().collect()
}

fn fit(pairs: &[Pair]) -> Option<Se3> {
    fit_with(pairs, Scale::Fixed).map(|a| a.target_from_source)
}

fn fit_with(pairs: &[Pair], scale: Scale) -> Option<Alignment> {
    let (second, first): (Vec<_>, Vec<_>) = pairs.iter().map(|p| (p.in_second, p.in_first)).unzip();
    umeyama(&second, &first, scale)
}

/// The alignment that brings most pairs together: samples of three, then least squares over what fits. Samples are drawn
/// before they are tried, so that threads change nothing.
fn align(pairs: &[Pair], config: &MergeConfig) -> Se3 {
    if pairs.len() < 3 {
        return Se3::identity();
    }
    let mut random = ChaCha8Rng::seed_from_u64(config.seed);
    let samples: Vec<[usize; 3]> = (0..config.samples)
        .map(|_| std::array::from_fn(|_| random.random_range(0..pairs.len())))
        .collect();
    let tried = samples
        .par_iter()
        .enumerate()
        .filter_map(|(number, sample)| {
            let three = sample.map(|i| pairs[i]);
            // A triangle keeps its sides.
            let keeps = (0..3).all(|i| {
                let (a, b) = (&three[i], &three[(i + 1) % 3]);
                let first = (a.in_first - b.in_first).norm();
                let second = (a.in_second - b.in_second).norm();
                first > 2.0 * config.gate_m && (first - second).abs() <= 2.0 * config.gate_m
            });
            let found = fit(&three).filter(|_| keeps)?;
            let inliers = shared(&found, pairs, config.gate_m).len();
            Some((inliers, std::cmp::Reverse(number), found))
        });
    let best = tried.max_by_key(|(inliers, number, _)| (*inliers, *number));
    let mut best = best.map_or_else(Se3::identity, |(_, _, found)| found);
    for _ in 0..REFINEMENTS {
        if let Some(found) = fit(&shared(&best, pairs, config.gate_m)) {
            best = found;
        }
    }
    best
}

/// σ of the alignment's position at the keyframe of `second` where it is largest. Points that the same keyframes saw are wrong
/// together, so that their own scatter promises too much: the alignment is made again without each of [`GROUPS`] runs of
/// keyframes, and its scatter over these gives σ (the jackknife).
fn worst_sigma_m(shared: &[Pair], second: &HdMap) -> f64 {
    let first_seen = |p: &Pair| second.observations(p.second).next().map(|o| o.keyframe);
    let mut in_order = shared.to_vec();
    in_order.sort_by_key(|p| (first_seen(p), p.second));
    let without: Option<Vec<Se3>> = (0..GROUPS)
        .map(|group| {
            let ends = [group, group + 1].map(|g| g * in_order.len() / GROUPS);
            fit(&[&in_order[..ends[0]], &in_order[ends[1]..]].concat())
        })
        .collect();
    let Some(without) = without else {
        return f64::INFINITY;
    };
    let n = GROUPS as f64;
    let keyframes = (0..second.keyframe_count() as u32).filter_map(|k| second.keyframe(k));
    let variances = keyframes.map(|k| {
        let placed = without.iter().map(|a| *a * k.world_from_rig.translation);
        let mean = placed.clone().sum::<Vector3<f64>>() / n;
        let squares: f64 = placed.map(|p| (p - mean).norm_squared()).sum();
        squares * (n - 1.0) / n
    });
    variances.fold(0.0, f64::max).sqrt()
}

/// How far an alignment that may change the scale moves a keyframe of `second` from where `best` has it, at most. Scatter does not show
/// a wrong scale: every part of the maps has it alike.
fn scale_shift_m(best: &Se3, shared: &[Pair], second: &HdMap) -> f64 {
    let Some(scaled) = fit_with(shared, Scale::Free) else {
        return f64::INFINITY;
    };
    let keyframes = (0..second.keyframe_count() as u32).filter_map(|k| second.keyframe(k));
    let shifts = keyframes.map(|k| {
        let place = k.world_from_rig.translation;
        (scaled.apply(&place) - *best * place).norm()
    });
    shifts.fold(0.0, f64::max)
}

fn joined(
    first: &HdMap,
    second: &HdMap,
    report: &MergeReport,
    shared: &[Pair],
    config: &MergeConfig,
) -> MapRows {
    let (mut rows, moved) = (first.rows(), second.rows());
    let before = rows.keyframes.len() as u32;
    rows.keyframes
        .extend(moved.keyframes.iter().map(|k| StampedPose {
            world_from_rig: report.first_from_second * k.world_from_rig,
            ..*k
        }));
    // Known relative to the first keyframe of a map of their own, and moved by an alignment that has its error too.
    rows.covariances.resize(rows.keyframes.len(), None);
    let limit = config.map.max_descriptors_per_point.max(1);
    let rotation = report.first_from_second.rotation_matrix();
    let named = place_cameras(&mut rows, &moved);
    let of_second: BTreeMap<u32, u32> = shared.iter().map(|p| (p.second, p.first)).collect();
    for (number, mut point) in (0..).zip(moved.points) {
        for o in &mut point.observations {
            o.keyframe += before;
            o.camera = named[usize::from(o.camera)];
        }
        point.position = report.first_from_second * point.position;
        match of_second.get(&number) {
            Some(same) => {
                let weights = (first.quality(*same), second.quality(number));
                let row = &mut rows.points[*same as usize];
                row.position = weighted(weights, &rotation, (&row.position, &point.position));
                row.observations.extend(point.observations);
                row.observations.sort_by_key(|o| (o.keyframe, o.camera));
                let all: Vec<&Descriptor> =
                    row.descriptors.iter().chain(&point.descriptors).collect();
                row.descriptors = typical(&all, limit);
            }
            None => rows.points.push(point),
        }
    }
    let mut hash = Sha256::new();
    hash.update(&first.provenance);
    hash.update(&second.provenance);
    rows.provenance = hash.finalize().iter().map(|b| format!("{b:02x}")).collect();
    for failure in moved.failures {
        if !rows.failures.contains(&failure) {
            rows.failures.push(failure);
        }
    }
    rows
}

/// Takes the cameras of `moved` into the rig of `rows`; gives the place there of each camera of `moved`.
fn place_cameras(rows: &mut MapRows, moved: &MapRows) -> Vec<u16> {
    let before: Vec<String> = rows.rig.cameras.keys().cloned().collect();
    let names: Vec<String> = moved
        .rig
        .cameras
        .iter()
        .map(|(name, mounted)| {
            let mut numbered =
                std::iter::once(name.clone()).chain((2..).map(|number| format!("{name}-{number}")));
            let cameras = &mut rows.rig.cameras;
            let is_free = |name: &String| cameras.get(name).is_none_or(|there| there == mounted);
            let chosen = numbered.find(is_free).unwrap_or_else(|| name.clone());
            cameras.insert(chosen.clone(), mounted.clone());
            let stated = moved.stated.get(name).cloned();
            rows.stated
                .extend(stated.map(|stated| (chosen.clone(), stated)));
            chosen
        })
        .collect();
    let place = |name: &String| {
        let at = rows.rig.cameras.keys().position(|n| n == name);
        at.unwrap_or(0) as u16
    };
    let of_first: Vec<u16> = before.iter().map(place).collect();
    let of_second = names.iter().map(place).collect();
    for o in rows.points.iter_mut().flat_map(|p| &mut p.observations) {
        o.camera = of_first[usize::from(o.camera)];
    }
    of_second
}

/// Mean of two positions of one point, weighted by their covariances where both have one.
fn weighted(
    (first, second): (Option<PointQuality>, Option<PointQuality>),
    rotation: &Matrix3<f64>,
    (a, b): (&Vector3<f64>, &Vector3<f64>),
) -> Vector3<f64> {
    let information = |quality: Option<PointQuality>, by: &Matrix3<f64>| {
        let covariance = by * quality?.covariance_m2 * by.transpose();
        let inverse = covariance.try_inverse()?;
        inverse.iter().all(|v| v.is_finite()).then_some(inverse)
    };
    let both = information(first, &Matrix3::identity()).zip(information(second, rotation));
    let mean = both.and_then(|(of_a, of_b)| {
        let covariance = (of_a + of_b).try_inverse()?;
        Some(covariance * (of_a * a + of_b * b))
    });
    mean.filter(|m| m.iter().all(|v| v.is_finite()))
        .unwrap_or((a + b) / 2.0)
}

#[cfg(test)]
mod tests;
