//! Which of the kept images show what was seen before, and how their poses lie to each other by that.

use std::collections::{BTreeMap, BTreeSet};

use lsfb_geometry::{Matrix3, Matrix6};
use lsfb_types::{ProgressFn, SharedProgress};
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
use crate::loops::{CHI_SQUARED, Keyframe, Measured, MeasuredLoop, Way, Ways, agree};
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
    cameras: Vec<MountedCamera>,
}

/// What was recognised.
pub(super) struct Recognised {
    /// Places that were seen before, by more than chance.
    pub count: usize,
    /// Of their loops those that another one says as well, in order of time.
    pub confirmed: Vec<Found>,
}

/// For each place that was seen before the loop that most speaks for.
pub(super) fn search(
    placed: &PlacedViews,
    keyframes: &[Keyframe],
    before: &Before<'_>,
    progress: ProgressFn<'_>,
) -> Result<Recognised, Error> {
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
        cameras: cameras
            .map(|camera| MountedCamera {
                camera: *camera.camera(),
                rig_from_camera: camera.camera_from_rig().inverse(),
                readout_s: camera.timing().readout_s,
            })
            .collect(),
    };
    let mut found = search.look_from_all(progress)?;
    let count = found.iter().flatten().count();
    let confirmed = confirmed_of(&found, keyframes).into_iter();
    let confirmed: Vec<usize> = confirmed.map(|(later, _)| later).collect();
    let confirmed = confirmed.into_iter();
    Ok(Recognised {
        count,
        confirmed: confirmed.filter_map(|later| found[later].take()).collect(),
    })
}

/// Loops that another one says as well, each with the place that it was found from.
fn confirmed_of<'a>(found: &'a [Option<Found>], keyframes: &[Keyframe]) -> Vec<(usize, &'a Found)> {
    let all: Vec<(usize, &Found)> = found
        .iter()
        .enumerate()
        .filter_map(|(later, f)| Some((later, f.as_ref()?)))
        .collect();
    let is_confirmed = |(later, own): &(usize, &Found)| {
        let mut others = all.iter().filter(|(other, _)| other != later);
        others.any(|(_, other)| agree(&own.measured, &other.measured, keyframes))
    };
    all.iter().copied().filter(is_confirmed).collect()
}

/// What a look from one place gives.
struct Look {
    found: Option<Found>,
    /// Whether the way to one that looks like it was too long to tell.
    is_too_far: bool,
}

impl Search<'_> {
    /// The loop of each place, if it has one. Those that are confirmed are shorter ways to all that lies beyond them: places from which the
    /// way was too long are looked at again then.
    fn look_from_all(&self, progress: ProgressFn<'_>) -> Result<Vec<Option<Found>>, Error> {
        let keyframes = self.keyframes;
        let mut found: Vec<Option<Found>> = keyframes.iter().map(|_| None).collect();
        let mut open: Vec<usize> = (0..keyframes.len()).collect();
        let mut ways = Ways::new(keyframes);
        let mut confirmed = 0;
        loop {
            let done = SharedProgress::new("searching for revisits", open.len(), progress);
            let looks: Result<Vec<Look>, Error> = open
                .par_iter()
                .map(|later| {
                    done.one_more()?;
                    Ok(self.look_from(*later, &ways))
                })
                .collect();
            let mut too_far = Vec::new();
            for (later, look) in open.into_iter().zip(looks?) {
                found[later] = look.found;
                if found[later].is_none() && look.is_too_far {
                    too_far.push(later);
                }
            }
            let now = confirmed_of(&found, keyframes);
            if now.len() == confirmed || too_far.is_empty() {
                return Ok(found);
            }
            (open, confirmed) = (too_far, now.len());
            ways = Ways::new(keyframes);
            for (_, f) in now {
                ways.accept(&f.measured);
            }
        }
    }

    /// The loop with most pairs; none where others lead to another pose: of places that are the same any may be meant.
    fn look_from(&self, later: usize, ways: &Ways) -> Look {
        let ways = ways.to(later);
        let (mut found, mut is_too_far) = (Vec::new(), false);
        for earlier in self.candidates(later) {
            let Some(way) = &ways[earlier] else { continue };
            match self.is_within_reach(way) {
                true => found.extend(self.verify(earlier, later, way)),
                false => is_too_far = true,
            }
        }
        Look {
            found: self.best_of(found),
            is_too_far,
        }
    }

    fn best_of(&self, mut found: Vec<Found>) -> Option<Found> {
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

    /// Whether what looks alike at the end of a way is the same: what is built alike is farther away than the walk can have drifted.
    fn is_within_reach(&self, way: &Way) -> bool {
        let [_, open_m] = worst_sigmas(&opened(&way.covariance));
        SIGMAS * open_m <= self.before.config.max_open_m
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
