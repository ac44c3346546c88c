//! Loops of a walk, by appearance, odometry, registration and agreement.

use lsfb_types::{Progress, ProgressFn};
use rayon::prelude::*;

use super::agreement::agree;
use super::assessment::Assessor;
use super::closing::reject_disagreeing;
use super::descriptor::Descriptor;
use super::keyframes::{self, Keyframe, Scans};
use super::ways::Ways;
use super::{Loop, LoopDecision, LoopRejection, Loops, Measured};
use crate::Error;
use crate::odometry::{OdometryConfig, OdometryResult};

/// Less far behind, along the way, is no return, metres.
const MIN_RETURN_M: f64 = 12.0;
/// Descriptors farther apart than this are of different places.
const MAX_APPEARANCE: f64 = 0.35;
/// Earlier keyframes whose descriptors are compared, the nearest by ring key.
const COMPARED: usize = 50;
/// Candidates nearer to each other than this are one, metres along the way.
const CANDIDATES_APART_M: f64 = 3.0;
/// Candidates of one scan that are registered, at most.
const REGISTERED: usize = 2;
/// Candidates of one scan that are looked at, at most.
const LOOKED_AT: usize = 10;
/// After a confirmed loop the next is sought so much farther on, metres.
const REST_M: f64 = 4.0;

/// An earlier keyframe that looks like the present one.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    earlier: usize,
    appearance: f64,
}

/// Looks for loops among the scans that found their place.
pub fn find_loops(
    result: &OdometryResult,
    config: &OdometryConfig,
    progress: ProgressFn<'_>,
) -> Result<Loops, Error> {
    config.check_bounds("odometry")?;
    let keyframes = keyframes::choose(result);
    let paths_m = keyframes::paths_m(result);
    let descriptors: Vec<Descriptor> = keyframes
        .par_iter()
        .map(|k| Descriptor::of(&result.clouds[k.scan], &k.world_from_rig, &result.lidar))
        .collect();
    let mut found = Found::new(&keyframes);
    let search = Search {
        keyframes: &keyframes,
        descriptors: &descriptors,
        assessor: Assessor {
            scans: Scans {
                poses: &result.scan_poses,
                clouds: &result.clouds,
                paths_m: &paths_m,
                lidar: &result.lidar,
            },
            config,
        },
    };
    for later in 0..keyframes.len() {
        progress(Progress {
            stage: "loops",
            done: later as u64,
            total: keyframes.len() as u64,
        })?;
        search.look_from(later, &mut found);
    }
    let mut found = found.finish();
    reject_disagreeing(&mut found, &keyframes, progress)?;
    Ok(found)
}

/// What loops are sought among.
pub(super) struct Search<'a> {
    pub keyframes: &'a [Keyframe],
    pub descriptors: &'a [Descriptor],
    pub assessor: Assessor<'a>,
}

/// What was found so far.
#[derive(Clone, Debug)]
pub(super) struct Found {
    pub ways: Ways,
    /// Loops that may be accepted, with their number in the list.
    pub measured: Vec<(Measured, usize, Confirmed)>,
    /// Where on the way the last loop was confirmed, metres.
    confirmed_m: f64,
    pub loops: Loops,
}

/// Whether another loop says the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Confirmed {
    Yes,
    NotYet,
}

impl Search<'_> {
    /// Looks for earlier visits of the place of a keyframe.
    pub fn look_from(&self, later: usize, found: &mut Found) {
        if self.keyframes[later].path_m - found.confirmed_m < REST_M {
            return;
        }
        let candidates = self.candidates(later);
        if candidates.is_empty() {
            return;
        }
        let ways = found.ways.to(later);
        let mut registered = 0;
        let mut unregistered: Option<Loop> = None;
        for candidate in candidates.iter().take(LOOKED_AT) {
            let Some(way) = &ways[candidate.earlier] else {
                continue;
            };
            let (a, b) = (&self.keyframes[candidate.earlier], &self.keyframes[later]);
            let assessment = self.assessor.assess(a, b, way, candidate.appearance);
            if !assessment.is_registered {
                // The most alike of them is worth a line.
                unregistered.get_or_insert(assessment.found);
                continue;
            }
            registered += 1;
            let is_accepted = assessment.found.decision == LoopDecision::Accepted;
            found.take(candidate.earlier, later, assessment.found, self.keyframes);
            if is_accepted || registered == REGISTERED {
                break;
            }
        }
        if let Some(unregistered) = unregistered.filter(|_| registered == 0) {
            found.loops.all.push(unregistered);
        }
    }

    /// Earlier keyframes that look like this one, the most alike first.
    fn candidates(&self, later: usize) -> Vec<Candidate> {
        let here = &self.keyframes[later];
        let is_return = |k: &Keyframe| here.path_m - k.path_m >= MIN_RETURN_M;
        let count = self.keyframes.iter().take_while(|k| is_return(k)).count();
        let descriptor = &self.descriptors[later];
        let key_distance = |k: usize| self.descriptors[k].key_distance(descriptor);
        let mut by_key: Vec<(f64, usize)> = (0..count).map(|k| (key_distance(k), k)).collect();
        by_key.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        by_key.truncate(COMPARED);
        let mut alike: Vec<Candidate> = by_key
            .par_iter()
            .map(|(_, earlier)| Candidate {
                earlier: *earlier,
                appearance: self.descriptors[*earlier].distance(descriptor),
            })
            .filter(|c| c.appearance < MAX_APPEARANCE)
            .collect();
        alike.sort_by(|a, b| {
            let by_appearance = a.appearance.total_cmp(&b.appearance);
            by_appearance.then(a.earlier.cmp(&b.earlier))
        });
        let mut apart: Vec<Candidate> = Vec::new();
        for candidate in alike {
            let path_m = |c: &Candidate| self.keyframes[c.earlier].path_m;
            let is_near =
                |c: &Candidate| (path_m(c) - path_m(&candidate)).abs() < CANDIDATES_APART_M;
            if !apart.iter().any(is_near) {
                apart.push(candidate);
            }
        }
        apart
    }
}

impl Found {
    /// Nothing yet.
    pub fn new(keyframes: &[Keyframe]) -> Self {
        Self {
            ways: Ways::new(keyframes),
            measured: Vec::new(),
            confirmed_m: f64::NEG_INFINITY,
            loops: Loops::default(),
        }
    }

    /// Adds a loop that was registered, and confirms it and those that it agrees with.
    fn take(&mut self, earlier: usize, later: usize, found: Loop, keyframes: &[Keyframe]) {
        let number = self.loops.all.len();
        let measured = found.measured;
        let is_accepted = found.decision == LoopDecision::Accepted;
        self.loops.all.push(found);
        let Some(loop_) = measured.filter(|_| is_accepted) else {
            return;
        };
        let new = Measured {
            earlier,
            later,
            loop_,
        };
        let mut agrees = false;
        for (other, _, confirmed) in &mut self.measured {
            if agree(other, &new, keyframes) {
                agrees = true;
                if std::mem::replace(confirmed, Confirmed::Yes) == Confirmed::NotYet {
                    self.ways.accept(other);
                }
            }
        }
        let confirmed = match agrees {
            true => Confirmed::Yes,
            false => Confirmed::NotYet,
        };
        if agrees {
            self.ways.accept(&new);
            self.confirmed_m = keyframes[later].path_m;
        }
        self.measured.push((new, number, confirmed));
    }

    fn finish(mut self) -> Loops {
        for (_, number, confirmed) in &self.measured {
            if *confirmed == Confirmed::NotYet {
                self.loops.all[*number].decision =
                    LoopDecision::Rejected(LoopRejection::Unconfirmed);
            }
        }
        self.loops
    }
}
