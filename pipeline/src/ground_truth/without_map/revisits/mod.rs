//! Places that a walk without a map comes back to: what drifted in between is taken out.
//!
//! Some images are kept with their features ([`WalkView`]). Those of one place are proposed by how alike they are ([`Codebook`]); the features
//! of the later are paired with points that the images around the earlier saw, and a pose by P3P in RANSAC must have more of the pairs than
//! chance gives, and be where the walk can have drifted to. Two loops must lead to one pose, and all of them fit one graph of the
//! walk. That graph bends the walk, and the pairs join what both visits saw into points of the adjustment, which then is
//! solved as a whole. A false loop is worse than none; `loops` says the same of scans, and judges by the same code.

mod placed_views;
mod search;

use std::collections::BTreeSet;
use std::path::PathBuf;

use lsfb_geometry::{Matrix6, StampedPose};
use lsfb_types::{Bounds, Finding, Limit, ProgressFn, Verdict};
use serde::{Deserialize, Serialize};

use super::TrackedWalk;
use super::extension::Settled;
use crate::Error;
use crate::bending::bent;
use crate::features::tracks::{ImagePair, Track, TrackedKeypoint, build_tracks};
use crate::features::{Features, SiftConfig};
use crate::ground_truth::GroundTruthConfig;
use crate::ground_truth::walk::{FrameState, LocalObservation, Walk};
use crate::loops::{self, Keyframe, Measured};
use crate::vlad::Codebook;
use lsfb_perception::imu::NavState;
use placed_views::{PlacedViews, sight};
use search::{Found, search};

/// An image of a walk by which its place can be recognised again.
#[derive(Clone, Debug, PartialEq)]
pub struct WalkView {
    /// Number of the frame.
    pub frame: usize,
    /// Index of the camera.
    pub camera: usize,
    /// What it shows.
    pub features: Features,
}

/// How places are recognised again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RevisitConfig {
    /// Images at least so far apart are kept to be recognised, seconds; 0 for none.
    pub view_secs: f64,
    /// Images less than this apart are no two visits, seconds.
    pub least_secs: f64,
    /// Earlier images that are looked at for each, the most alike ones.
    pub candidates: usize,
    /// Loops less than this apart are one, seconds, of which the one with most pairs is closed: more of them cost more than they tell.
    pub loop_secs: f64,
    /// Where the walk may have drifted by more than this (three standard deviations) no likeness is proof, metres: what is built alike, bays,
    /// doors and floors, is farther apart.
    pub max_open_m: f64,
    /// Fewest pairs that agree with the pose of one visit on the other.
    pub min_inliers: usize,
    /// Decimal logarithm of how many poses with as many pairs may be expected of chance.
    pub max_log10_false_alarms: f64,
    /// The codebook by which images are compared, instead of the one built in.
    pub codebook: Option<PathBuf>,
    /// The features.
    pub sift: SiftConfig,
}

impl Default for RevisitConfig {
    fn default() -> Self {
        Self {
            view_secs: 0.5,
            least_secs: 5.0,
            candidates: 4,
            loop_secs: 2.0,
            max_open_m: 2.5,
            min_inliers: 12,
            max_log10_false_alarms: -6.0,
            codebook: None,
            sift: SiftConfig {
                max_features: 500,
                ..SiftConfig::default()
            },
        }
    }
}

lsfb_types::bounds! {
    RevisitConfig {
        view_secs: number(Bounds::NOT_NEGATIVE),
        least_secs: number(Bounds::POSITIVE),
        candidates: any,
        loop_secs: number(Bounds::NOT_NEGATIVE),
        max_open_m: number(Bounds::POSITIVE),
        min_inliers: any,
        max_log10_false_alarms: any,
        codebook: any,
        sift: section,
    }
}

impl RevisitConfig {
    /// The codebook that is named, else the one built in.
    pub(super) fn read_codebook(&self) -> Result<Codebook, Error> {
        match &self.codebook {
            Some(path) => Codebook::read(path),
            None => Ok(Codebook::built_in()),
        }
    }
}

/// What became of the places that looked alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Revisits {
    /// Moments of the walk at which images were kept.
    pub places: u64,
    /// Of these, those whose images show what was seen before, by more than chance.
    pub recognised: u64,
    /// Loops that are closed: recognised, confirmed by another, in agreement with all of them, and the best of those close by.
    pub closed: u64,
    /// Loops that were closed and opened again: all solved, walk and loop did not fit.
    #[serde(default)]
    pub opened: u64,
    /// How far a pose was moved by closing them at most, metres.
    pub moved_m: f64,
    /// How far a closed loop is from what its images say at most in the end, in standard deviations (a norm over six numbers).
    pub worst_sigmas: f64,
}

impl Revisits {
    /// What is said of it; nothing where no images were kept.
    pub(super) fn finding(&self) -> Option<Finding> {
        let Self {
            places,
            recognised,
            closed,
            opened,
            ..
        } = self;
        let opened = match opened {
            0 => String::new(),
            _ => format!("; {opened} more did not fit the solution and were dropped"),
        };
        let said = match closed {
            0 => format!(
                "no revisit was recognised at {places} places: drift grows with the distance{opened}"
            ),
            _ => format!(
                "{recognised} of {places} places were recognised as revisited; {closed} loops are closed, which moved poses by up to {:.1} cm{opened}",
                self.moved_m * 1e2
            ),
        };
        (*places > 0).then(|| {
            Finding::new("revisits", Verdict::Warn.unless(!self.is_contradicted()), "trajectory", said)
                .value(self.opened as f64, "loops")
                .limit(Limit::AtMost(0.0))
                .remedy("places that look alike may have been confused: set revisits.view_secs to 0 and compare")
        })
    }

    /// Whether what is closed is contradicted by what looked the same as well.
    pub fn is_contradicted(&self) -> bool {
        self.closed > 0 && self.opened > 0
    }
}

/// Refuses views that are of no frame or camera of their walk, out of order, or of keypoints without descriptors.
pub(super) fn check(walk: &TrackedWalk) -> Result<(), Error> {
    let is_there = |v: &WalkView| {
        v.frame < walk.frames.len()
            && v.camera < walk.cameras.len()
            && v.features.keypoints.len() == v.features.descriptors.len()
    };
    let place = |v: &WalkView| (v.frame, v.camera);
    let mut views = walk.views.iter().enumerate();
    let wrong = views.find(|(k, view)| {
        let before = k.checked_sub(1).map(|k| place(&walk.views[k]));
        !is_there(view) || before.is_some_and(|before| before >= place(view))
    });
    match wrong {
        Some((view, _)) => Err(Error::UnknownView { view }),
        None => Ok(()),
    }
}

/// 99 % of squared norms of six standard normal numbers are below this: a loop beyond it is opened. True ones have come to 7 at most, and to
/// open one of them costs little.
const FITS: f64 = 16.811_894;

/// Loops of a walk that are closed.
pub(super) struct ClosedLoops<'a> {
    before: &'a Before<'a>,
    placed: PlacedViews,
    keyframes: Vec<Keyframe>,
    found: Vec<Found>,
    revisits: Revisits,
}

/// A walk bent so that its loops close.
pub(super) struct Bent {
    /// State of each frame.
    pub states: Vec<FrameState>,
    /// What more than one visit saw.
    pub tracks: Vec<Vec<LocalObservation>>,
}

/// Walk, views and what was found so far.
pub(super) struct Before<'a> {
    pub walk: &'a Walk,
    pub tracked: &'a TrackedWalk,
    pub settled: &'a Settled,
    /// Of each place's pose relative to the first frame.
    pub covariances: &'a [Matrix6<f64>],
    pub config: &'a RevisitConfig,
    pub adjustment: &'a GroundTruthConfig,
}

impl<'a> ClosedLoops<'a> {
    /// Looks for loops.
    pub fn find(before: &'a Before<'a>, progress: ProgressFn<'_>) -> Result<Self, Error> {
        let placed = PlacedViews::new(before, progress)?;
        let keyframes = placed.keyframes(before);
        let recognised = search(&placed, &keyframes, before, progress)?;
        let mut found = recognised.confirmed;
        if !found.is_empty() {
            let mut fits = loops::fitting(&keyframes, &measured(&found), progress)?.into_iter();
            found.retain(|_| fits.next().unwrap_or(false));
        }
        let found = apart(found, &keyframes, before.config.loop_secs);
        let revisits = Revisits {
            places: keyframes.len() as u64,
            recognised: recognised.count as u64,
            closed: found.len() as u64,
            ..Revisits::default()
        };
        Ok(Self {
            before,
            placed,
            keyframes,
            found,
            revisits,
        })
    }

    /// The walk bent to what the loops say; `None` without any.
    pub fn bend(&mut self, progress: ProgressFn<'_>) -> Result<Option<Bent>, Error> {
        if self.found.is_empty() {
            return Ok(None);
        }
        let (before, keyframes) = (self.before, &self.keyframes);
        let closed = loops::closed_poses(keyframes, &measured(&self.found), progress)?;
        let moved = keyframes.iter().zip(&closed);
        let moved_m = moved.map(|(k, now)| (k.world_from_rig.translation - now.translation).norm());
        self.revisits.moved_m = moved_m.fold(0.0, f64::max);
        let poses: Vec<StampedPose> = keyframes.iter().map(stamped).collect();
        let frames = before.walk.frames.iter();
        let states = frames.zip(&before.settled.last.estimate.states);
        let states = states.map(|(frame, state)| {
            let here = StampedPose {
                time: frame.time,
                world_from_rig: state.nav.world_from_rig,
            };
            let there = bent(&here, &poses, &closed);
            let turned = there.rotation * here.world_from_rig.rotation.inverse();
            FrameState {
                nav: NavState {
                    world_from_rig: there,
                    velocity_m_s: turned * state.nav.velocity_m_s,
                },
                bias: state.bias,
            }
        });
        Ok(Some(Bent {
            states: states.collect(),
            tracks: joined(&self.placed, &before.tracked.views, &self.found),
        }))
    }

    /// Opens the loops that the walk, solved with them, is farther from than their images say. Whether there were any: then it is to be
    /// solved again, without them.
    pub fn open_misfits(&mut self, solved: &Settled) -> bool {
        let pose = |k: usize| solved.last.estimate.pose(self.keyframes[k].scan);
        let mut worst = 0.0_f64;
        self.found.retain(|f| {
            let Measured {
                earlier,
                later,
                loop_,
            } = &f.measured;
            let squared = loops::squared_sigmas(pose(*earlier), pose(*later), loop_);
            let fits = squared <= FITS;
            if fits {
                worst = worst.max(squared);
            }
            fits
        });
        let kept = self.found.len() as u64;
        let opened = self.revisits.closed - kept;
        self.revisits = Revisits {
            closed: kept,
            opened: self.revisits.opened + opened,
            moved_m: if kept == 0 {
                0.0
            } else {
                self.revisits.moved_m
            },
            worst_sigmas: worst.sqrt(),
            ..self.revisits
        };
        opened > 0
    }

    /// What is said of the loops once all is solved.
    pub fn revisits(&self) -> Revisits {
        self.revisits
    }
}

fn measured(found: &[Found]) -> Vec<Measured> {
    found.iter().map(|f| f.measured).collect()
}

fn stamped(keyframe: &Keyframe) -> StampedPose {
    StampedPose {
        time: keyframe.time,
        world_from_rig: keyframe.world_from_rig,
    }
}

/// Of loops whose later visits are close to one another those with most pairs; in order of time.
fn apart(mut found: Vec<Found>, keyframes: &[Keyframe], least_secs: f64) -> Vec<Found> {
    // The sort is stable: of equals the first stays.
    found.sort_by_key(|f| std::cmp::Reverse(f.inliers()));
    let secs = |a: usize, b: usize| keyframes[a].time.secs_since(keyframes[b].time).abs();
    let mut kept: Vec<Found> = Vec::new();
    for f in found {
        let is_near = |other: &Found| secs(f.measured.later, other.measured.later) < least_secs;
        if !kept.iter().any(is_near) {
            kept.push(f);
        }
    }
    kept.sort_by_key(|f| f.measured.later);
    kept
}

/// Sights of what two visits saw that are farther from both of them than this are left out, in places: each visit has few images of a point
/// then, and the adjustment fewer frames that hang together.
const FROM_VISIT: usize = 1;

/// Tracks in which what two visits saw is one point.
fn joined(placed: &PlacedViews, views: &[WalkView], found: &[Found]) -> Vec<Vec<LocalObservation>> {
    let mut pairs: Vec<ImagePair> = placed.pairs.clone();
    let mut ends: BTreeSet<TrackedKeypoint> = BTreeSet::new();
    for pair in found.iter().flat_map(|f| &f.pairs) {
        let of = |image: usize, keypoint: u32| TrackedKeypoint {
            image: image as u32,
            keypoint,
        };
        ends.extend(pair.matches.iter().map(|m| of(pair.first, m.first)));
        ends.extend(pair.matches.iter().map(|m| of(pair.second, m.second)));
        pairs.push(pair.clone());
    }
    let mut place_of = vec![0; views.len()];
    for (place, images) in placed.places.iter().enumerate() {
        place_of[images.clone()].fill(place);
    }
    let place = |k: &TrackedKeypoint| place_of[k.image as usize];
    let counts: Vec<usize> = views.iter().map(|v| v.features.len()).collect();
    let tracks = build_tracks(&counts, &pairs, 2);
    let near_visits = |track: &Track| {
        let keypoints = track.keypoints.iter();
        let visits: Vec<usize> = keypoints
            .clone()
            .filter(|k| ends.contains(k))
            .map(place)
            .collect();
        let is_near = |k: &&TrackedKeypoint| {
            let near = |visit: &usize| visit.abs_diff(place(k)) <= FROM_VISIT;
            visits.iter().any(near)
        };
        let kept = keypoints.filter(is_near).map(|k| sight(views, k));
        // A match that contradicted better ones leaves one end alone.
        (visits.len() >= 2).then(|| kept.collect())
    };
    tracks.iter().filter_map(near_visits).collect()
}
