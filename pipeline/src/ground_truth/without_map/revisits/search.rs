//! Which of the kept images show what was seen before, and how their poses lie to each other by that.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};

use lsfb_geometry::{Matrix3, Matrix6};
use lsfb_types::{Progress, ProgressFn};
use rayon::prelude::*;

use super::Before;
use super::placed_views::PlacedViews;
use crate::Error;
use crate::features::matching::{DescriptorSet, Match, match_mutual};
use crate::features::tracks::ImagePair;
use crate::localization::{
    ExpectedPose, MountedCamera, PointMatch, PoseKnowledge, RansacConfig, VerifiedPose,
    verified_pose,
};
use crate::loops::{CHI_SQUARED, Keyframe, Measured, MeasuredLoop, Way, Ways};
use crate::vlad::Vlad;
use crate::worst_sigma::worst_sigmas;

/// Candidates nearer to each other than this are one, in places.
const CANDIDATES_APART: usize = 4;
/// Places around the earlier one whose points are looked for, to each side.
const AROUND: usize = 2;
/// Two visits see the same by tracks that never ended where so many features were followed from one to the other.
const FOLLOWED: usize = 8;
/// Poses are looked for so much farther than the walk may have drifted, metres and radians; whether what is found fits the drift is asked then.
const LEAST_OPEN_M: f64 = 0.1;
const LEAST_OPEN_RAD: f64 = 0.01;
/// In how many standard deviations of the drift a place is looked for.
const SIGMAS: f64 = 3.0;
/// Poses farther apart than this are two places: metres and radians. What drifted between two visits is less.
const RIVAL_M: f64 = 0.5;
const RIVAL_RAD: f64 = 0.1;
/// What the points of a place are off by together, which no count of them reduces: metres and radians.
const SHARED_M: f64 = 0.02;
const SHARED_RAD: f64 = 0.002;

/// A loop with what both visits saw.
pub(super) struct Found {
    pub measured: Measured,
    /// Keypoints of the earlier and the later images.
    pub pairs: Vec<ImagePair>,
}

impl Found {
    /// Pairs that agree.
    pub fn inliers(&self) -> usize {
        self.pairs.iter().map(|p| p.matches.len()).sum()
    }
}

/// What the search looks at.
struct Search<'a> {
    placed: &'a PlacedViews,
    keyframes: &'a [Keyframe],
    before: &'a Before<'a>,
    /// Numbers of the tracks that each place sees.
    tracks: Vec<BTreeSet<u32>>,
    vlads: Vec<Vlad>,
    ways: Ways,
    cameras: Vec<MountedCamera>,
}

/// For each place that was seen before the loop that most speaks for, in order of time.
pub(super) fn search(
    placed: &PlacedViews,
    keyframes: &[Keyframe],
    before: &Before<'_>,
    progress: ProgressFn<'_>,
) -> Result<Vec<Found>, Error> {
    let codebook = before.config.read_codebook()?;
    let views = before.tracked.views.par_iter();
    let tracks_in = |frame: usize| {
        let sights = &before.tracked.frames[frame].sights;
        sights.iter().map(|s| s.track).collect()
    };
    let cameras = before.settled.last.estimate.cameras.iter();
    let search = Search {
        placed,
        keyframes,
        before,
        tracks: keyframes.iter().map(|k| tracks_in(k.scan)).collect(),
        vlads: views
            .map(|v| codebook.describe(&v.features.descriptors))
            .collect(),
        ways: Ways::new(keyframes),
        cameras: cameras
            .map(|camera| MountedCamera {
                camera: *camera.camera(),
                rig_from_camera: camera.camera_from_rig().inverse(),
                readout_s: camera.timing().readout_s,
            })
            .collect(),
    };
    let (done, total) = (AtomicU64::new(0), keyframes.len() as u64);
    let found: Result<Vec<Option<Found>>, Error> = (0..keyframes.len())
        .into_par_iter()
        .map(|later| {
            progress(Progress {
                stage: "places seen again",
                done: done.fetch_add(1, Ordering::Relaxed) + 1,
                total,
            })?;
            Ok(search.look_from(later))
        })
        .collect();
    Ok(found?.into_iter().flatten().collect())
}

impl Search<'_> {
    /// The loop with most pairs; none where others lead to another pose: of places that are the same any may be meant.
    fn look_from(&self, later: usize) -> Option<Found> {
        let ways = self.ways.to(later);
        let candidates = self.candidates(later).into_iter();
        let mut found: Vec<Found> = candidates
            .filter_map(|earlier| self.verify(earlier, later, ways[earlier].as_ref()?))
            .collect();
        // Of equals the one that looks most alike.
        let most = (0..found.len()).rev().max_by_key(|k| found[*k].inliers())?;
        let best = found.swap_remove(most);
        let pose = |f: &Found| {
            let earlier = &self.keyframes[f.measured.earlier];
            earlier.world_from_rig * f.measured.loop_.earlier_from_later
        };
        let is_rival = |other: &Found| {
            let off = pose(&best).inverse() * pose(other);
            off.translation.norm() > RIVAL_M || off.rotation.angle() > RIVAL_RAD
        };
        (!found.iter().any(is_rival)).then_some(best)
    }

    /// Earlier places that look like this one and are another visit, the most alike first.
    fn candidates(&self, later: usize) -> Vec<usize> {
        let here = &self.keyframes[later];
        let is_apart = |k: &Keyframe| here.time.secs_since(k.time) >= self.before.config.least_secs;
        let earlier = self.keyframes.iter().take_while(|k| is_apart(k)).count();
        let likeness = |place: usize| {
            let pairs = self.placed.places[place].clone().flat_map(|a| {
                let of_later = self.placed.places[later].clone();
                of_later.map(move |b| (a, b))
            });
            pairs
                .map(|(a, b)| self.vlads[a].likeness(&self.vlads[b]))
                .fold(f32::NEG_INFINITY, f32::max)
        };
        let mut alike: Vec<(f32, usize)> = (0..earlier).map(|k| (likeness(k), k)).collect();
        alike.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut apart: Vec<usize> = Vec::new();
        for (_, place) in alike {
            if apart.len() == self.before.config.candidates {
                break;
            }
            let is_new = apart.iter().all(|k| k.abs_diff(place) >= CANDIDATES_APART);
            if is_new && !self.never_left(place, later) {
                apart.push(place);
            }
        }
        apart
    }

    /// Whether features were followed from one place to the other: then it is one visit, and its tracks say how they lie.
    fn never_left(&self, earlier: usize, later: usize) -> bool {
        let (earlier, later) = (&self.tracks[earlier], &self.tracks[later]);
        earlier.intersection(later).take(FOLLOWED).count() == FOLLOWED
    }

    /// The pose of the later visit on the earlier by what both see, if more of it agrees than chance gives.
    fn verify(&self, earlier: usize, later: usize, way: &Way) -> Option<Found> {
        let covariance = opened(&way.covariance);
        let [_, open_m] = worst_sigmas(&covariance);
        if SIGMAS * open_m > self.before.config.max_open_m {
            return None;
        }
        let around = self.points_around(earlier, later);
        let (points, sources): (Vec<usize>, Vec<(usize, u32)>) = around.into_iter().unzip();
        let descriptors: Vec<_> = sources
            .iter()
            .map(|(view, k)| self.before.tracked.views[*view].features.descriptors[*k as usize])
            .collect();
        let known_set = DescriptorSet::new(&descriptors);
        let mut matches: Vec<(u32, u32, PointMatch)> = Vec::new();
        let mut keypoints: Vec<(usize, Match)> = Vec::new();
        for view in self.placed.places[later].clone() {
            let own = &self.before.tracked.views[view];
            let set = &self.placed.descriptors[view];
            for m in match_mutual(&known_set, set, &self.before.adjustment.matching) {
                let pixel = own.features.keypoints[m.second as usize].pixel_f64();
                let point = PointMatch {
                    camera: own.camera,
                    pixel,
                    point_in_world: self.placed.points[points[m.first as usize]],
                    point_covariance_m2: Matrix3::zeros(),
                };
                matches.push((m.distance_squared, m.first, point));
                keypoints.push((view, m));
            }
        }
        let world_from_earlier = self.keyframes[earlier].world_from_rig;
        let known = PoseKnowledge {
            up: None,
            pose: Some(ExpectedPose {
                world_from_rig: world_from_earlier * way.here_from_target,
                covariance,
            }),
        };
        let found = verified_pose(&self.cameras, &matches, &known, &RansacConfig::default())?;
        let [rotation_rad, place_m] = worst_sigmas(&found.covariance);
        let measured = Measured {
            earlier,
            later,
            loop_: MeasuredLoop {
                earlier_from_later: world_from_earlier.inverse() * found.world_from_rig,
                rotation_sigma_rad: rotation_rad.hypot(SHARED_RAD),
                translation_sigma_m: place_m.hypot(SHARED_M),
            },
        };
        if !self.is_sure(&found) || !fits_drift(way, &measured.loop_) {
            return None;
        }
        let mut pairs: BTreeMap<(usize, usize), Vec<Match>> = BTreeMap::new();
        for k in &found.inliers {
            let (view, m) = keypoints[*k];
            let (source, keypoint) = sources[m.first as usize];
            pairs.entry((source, view)).or_default().push(Match {
                first: keypoint,
                ..m
            });
        }
        let pairs = pairs
            .into_iter()
            .map(|((first, second), matches)| ImagePair {
                first,
                second,
                matches,
            });
        Some(Found {
            measured,
            pairs: pairs.collect(),
        })
    }

    fn is_sure(&self, found: &VerifiedPose) -> bool {
        found.inliers.len() >= self.before.config.min_inliers
            && found.log10_false_alarms <= self.before.config.max_log10_false_alarms
    }

    /// Points that the images around a place see, each with the image nearest to it that does and its keypoint there.
    fn points_around(&self, place: usize, later: usize) -> BTreeMap<usize, (usize, u32)> {
        let first = place.saturating_sub(AROUND);
        let last = (place + AROUND).min(later.saturating_sub(1));
        let mut nearest: Vec<usize> = (first..=last).collect();
        nearest.sort_by_key(|k| (k.abs_diff(place), *k));
        let mut points = BTreeMap::new();
        for view in nearest
            .into_iter()
            .flat_map(|k| self.placed.places[k].clone())
        {
            for (keypoint, point) in &self.placed.seen[view] {
                points.entry(*point).or_insert((view, *keypoint));
            }
        }
        points
    }
}

/// Whether a loop is where the walk can have drifted to. Loops that are false together outweigh the drift in any graph: each is asked by itself.
fn fits_drift(way: &Way, loop_: &MeasuredLoop) -> bool {
    let off = way.here_from_target.local(&loop_.earlier_from_later);
    let covariance = way.covariance + loop_.covariance();
    covariance
        .cholesky()
        .is_some_and(|c| off.dot(&c.solve(&off)) < CHI_SQUARED)
}

/// A covariance with what it does not say added.
fn opened(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut opened = *covariance;
    for k in 0..3 {
        opened[(k, k)] += LEAST_OPEN_RAD * LEAST_OPEN_RAD;
        opened[(k + 3, k + 3)] += LEAST_OPEN_M * LEAST_OPEN_M;
    }
    opened
}
