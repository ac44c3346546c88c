//! Tracks by number, and the points that they show.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::ops::Range;

use lsfb_geometry::Vector2;

use super::TrackedWalk;
use crate::ground_truth::GroundTruthConfig;
use crate::ground_truth::estimate::Estimate;
use crate::ground_truth::local_points::{contradicted_share, locate_all};
use crate::ground_truth::walk::{LocalObservation, LocalPoint};

/// All tracks of a walk, those with fewer than two sights left out.
pub(super) struct Tracks {
    /// In order of frame and camera.
    all: Vec<Vec<LocalObservation>>,
    /// What several visits of a place saw: each is a point, however short it is.
    joined: Vec<Vec<LocalObservation>>,
}

impl Tracks {
    pub fn of(walk: &TrackedWalk) -> Self {
        let mut by_number: BTreeMap<u32, Vec<LocalObservation>> = BTreeMap::new();
        for (frame, entry) in walk.frames.iter().enumerate() {
            for sight in entry
                .sights
                .iter()
                .filter(|s| s.camera < walk.cameras.len())
            {
                by_number
                    .entry(sight.track)
                    .or_default()
                    .push(LocalObservation {
                        frame,
                        camera: sight.camera,
                        pixel: sight.pixel,
                        used: true,
                    });
            }
        }
        let all = by_number.into_values().filter(|sights| sights.len() >= 2);
        Self {
            all: all.collect(),
            joined: Vec::new(),
        }
    }

    /// With what several visits of a place saw besides.
    pub fn with(&self, joined: &[Vec<LocalObservation>]) -> Self {
        Self {
            all: self.all.clone(),
            joined: joined.to_vec(),
        }
    }

    /// The parts of the tracks within some frames; frames count from the first of them.
    pub fn within(&self, frames: &Range<usize>) -> Vec<Vec<LocalObservation>> {
        parts(&self.all, frames)
    }

    /// Of those parts the longest, until each image has as many as wanted.
    fn longest_within(
        &self,
        frames: &Range<usize>,
        per_image: usize,
    ) -> Vec<Vec<LocalObservation>> {
        let mut parts = self.within(frames);
        // The sort is stable: tracks of one length stay in the order of their numbers.
        parts.sort_by_key(|part| Reverse(part.len()));
        let mut used: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        parts.retain(|part| {
            let is_wanted = part.iter().any(|seen| {
                used.get(&(seen.frame, seen.camera))
                    .is_none_or(|n| *n < per_image)
            });
            if is_wanted {
                for seen in part {
                    *used.entry((seen.frame, seen.camera)).or_default() += 1;
                }
            }
            is_wanted
        });
        parts
    }

    /// Points of the longest tracks within some frames, as the estimate of those frames places them.
    pub fn locate(
        &self,
        estimate: &Estimate,
        frames: Range<usize>,
        config: &GroundTruthConfig,
    ) -> Vec<LocalPoint> {
        let mut tracks = self.longest_within(&frames, config.local_points_per_image);
        tracks.extend(parts(&self.joined, &frames));
        locate_all(estimate, &tracks, config)
    }

    /// Share of the sights of those tracks that fit no point.
    pub fn contradicted_share(
        &self,
        estimate: &Estimate,
        frames: Range<usize>,
        config: &GroundTruthConfig,
    ) -> f64 {
        let tracks = self.longest_within(&frames, config.local_points_per_image);
        contradicted_share(estimate, &tracks, config)
    }

    /// Pairs of pixels of tracks that two images share.
    pub fn shared(&self, camera: usize, first: usize, second: usize) -> Vec<[Vector2<f64>; 2]> {
        let at = |track: &[LocalObservation], frame| {
            let seen = track
                .iter()
                .find(|s| s.frame == frame && s.camera == camera);
            seen.map(|s| s.pixel)
        };
        let pairs = self.all.iter();
        pairs
            .filter_map(|track| Some([at(track, first)?, at(track, second)?]))
            .collect()
    }
}

/// The parts of some tracks within some frames; frames count from the first of them.
fn parts(tracks: &[Vec<LocalObservation>], frames: &Range<usize>) -> Vec<Vec<LocalObservation>> {
    let parts = tracks.iter().map(|track| {
        let sights = track.iter().filter(|seen| frames.contains(&seen.frame));
        let counted = sights.map(|seen| LocalObservation {
            frame: seen.frame - frames.start,
            ..*seen
        });
        counted.collect::<Vec<_>>()
    });
    parts.filter(|part| part.len() >= 2).collect()
}
