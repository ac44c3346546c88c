//! Whether each pose stands where parts of the map are withheld.
//!
//! A solve says how well observations agree with one another as if each point erred on its own. Neighbours do not: points of a poor
//! part of the map lie wrongly together, and along an edge one feature is taken for the next, in one image after the other. So
//! the points that a stretch of the walk sees are divided into four groups by where they are, and the stretch is solved again with
//! every two of them. What a group shares moves the halves apart; how far is compared with what is allowed, and how far it lets the
//! whole be off is the jackknife's: with half of the groups left out, the mean square by which the halves differ from the whole is the
//! variance of the whole (Shao and Wu, Annals of Statistics 1989).

use std::collections::BTreeMap;
use std::ops::Range;

use lsfb_geometry::{Matrix6, Vector3};
use lsfb_types::{ProgressFn, SharedProgress, no_progress};
use nalgebra::Vector6;
use rayon::prelude::*;

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::optimization::{choose_observations, optimize};
use super::uncertainty::{Deviations, of_stretch};
use super::walk::{LocalObservation, LocalPoint, Walk};
use crate::frames::times_apart;
use crate::worst_sigma::worst_sigmas;
use crate::{Error, Refusal};

/// Frames that are checked are this far apart, seconds: neighbours see the same points, and share their errors.
const STEP_SECS: f64 = 0.095;
/// Checked frames of one stretch, and those before and after it that are solved with it.
const FRAMES_AT_ONCE: usize = 30;
const MARGIN_FRAMES: usize = 10;
/// Inertial samples from this long before the first frame of a stretch to as long after the last, seconds.
const IMU_MARGIN_SECS: f64 = 0.1;
/// Groups of points.
const GROUPS: usize = 4;
/// Which groups each half has: every pair.
const HALVES: [[usize; 2]; 6] = [[0, 1], [2, 3], [0, 2], [1, 3], [0, 3], [1, 2]];
/// A half that leads further away than this share of what is allowed is weighed by what it knows.
const WEIGHED_FROM: f64 = 0.5;
/// One that pulls the whole less far than this share of it has nothing to say there.
const HARMLESS: f64 = 0.25;
/// Standard deviation, as such a share, up to which a position is known well enough without it.
const KNOWN: f64 = 0.1;
/// Rounds in which a half chooses its observations, as far from the whole's as its own poses lead.
const ROUNDS: usize = 2;

/// What halves of the map's points say of a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct HalvesCheck {
    /// Largest distance by which one half moves the position, metres; infinite where a half leads nowhere.
    pub disagreement_m: f64,
    /// Covariance of the pose by what the points of a group share, tangent `[rotation, translation]` on the right, rad² and m².
    pub shared: Matrix6<f64>,
}

impl HalvesCheck {
    fn of_agreement() -> Self {
        Self {
            disagreement_m: 0.0,
            shared: Matrix6::zeros(),
        }
    }

    /// With one half more: how far it moves the pose, or `None` where it leads nowhere.
    fn with(mut self, moved: Option<Vector6<f64>>) -> Self {
        match moved {
            Some(moved) => {
                self.disagreement_m = self.disagreement_m.max(length_m(&moved));
                self.shared += moved * moved.transpose() / HALVES.len() as f64;
            }
            None => self.disagreement_m = f64::INFINITY,
        }
        self
    }

    fn worse(self, other: Self) -> Self {
        match self.disagreement_m >= other.disagreement_m {
            true => self,
            false => other,
        }
    }
}

/// How far a half moves each of some poses; `None` where it leads nowhere.
type Moves = Vec<Option<Vector6<f64>>>;

/// What a half says of a stretch.
struct SolvedHalf {
    /// How far it moves each pose.
    moves: Vec<Vector6<f64>>,
    /// Covariances of the poses by it alone, where it moves one of them far.
    covariances: Option<Vec<Option<Matrix6<f64>>>>,
}

/// How far a tangent `[rotation, translation]` moves a position, metres.
fn length_m(moved: &Vector6<f64>) -> f64 {
    moved.fixed_rows::<3>(3).norm()
}

/// Weighs how far the poses by a half lie from those by all by what it says in the whole. Of a half that sees all of its points in one
/// direction the poses may lie anywhere along another, in which the whole hardly listens to it. With the normal matrices `H` of all and `H₁` of the
/// half its observations pull the whole by `H⁻¹ H₁ δ`, where alone they lead `δ` away; half as far where both halves know as much, so that
/// twice that is what stands for `δ`. A half that pulls further than `harmless_m` is no weak one, and where all know a position no better than
/// `known_m` a half has as much to say as they: there counts where it leads.
fn weigh(
    moves: &mut [Vector6<f64>],
    [by_all, by_half]: [&[Option<Matrix6<f64>>]; 2],
    [harmless_m, known_m]: [f64; 2],
) {
    for (moved, (by_all, by_half)) in moves.iter_mut().zip(by_all.iter().zip(by_half)) {
        let information = by_half.and_then(|covariance| covariance.try_inverse());
        let Some((by_all, information)) = by_all.zip(information) else {
            continue;
        };
        let [_, sigma_m] = worst_sigmas(&by_all);
        let pulled = by_all * information * *moved * 2.0;
        if sigma_m < known_m && length_m(&pulled) < harmless_m.min(length_m(moved)) {
            *moved = pulled;
        }
    }
}

/// What halves of the map's points say of each frame.
pub(super) fn check_halves(
    walk: &Walk,
    estimate: &Estimate,
    points: &[LocalPoint],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Vec<HalvesCheck>, Error> {
    let times: Vec<_> = walk.frames.iter().map(|frame| frame.time).collect();
    let checked = times_apart(&times, STEP_SECS);
    let firsts = (0..checked.len()).step_by(FRAMES_AT_ONCE);
    let cores: Vec<Range<usize>> = firsts
        .map(|first| first..(first + FRAMES_AT_ONCE).min(checked.len()))
        .collect();
    let done = SharedProgress::new("cross-check", cores.len() * HALVES.len(), progress);
    let config = &config.roughly();
    let shown = Deviations::of(walk, estimate, points);
    let [limit_m, harmless_m, known_m] =
        [WEIGHED_FROM, HARMLESS, KNOWN].map(|share| share * config.max_disagreement_m);
    let found: Vec<(Range<usize>, Vec<Moves>)> = cores
        .into_par_iter()
        .map(|core| {
            let begin = core.start.saturating_sub(MARGIN_FRAMES);
            let end = (core.end + MARGIN_FRAMES).min(checked.len());
            let frames = &checked[begin..end];
            let inside = core.start - begin..core.end - begin;
            let halves: Vec<Option<SolvedHalf>> = HALVES
                .into_par_iter()
                .map(|half| {
                    done.one_more()?;
                    let stretch = Stretch::new(walk, estimate, points, frames);
                    let Some(half) = stretch.solved_by(half, config)? else {
                        return Ok(None);
                    };
                    let apart = frames.iter().enumerate().map(|(k, frame)| {
                        (estimate.pose(*frame).inverse() * *half.estimate.pose(k)).log()
                    });
                    let moves: Vec<Vector6<f64>> = apart.collect();
                    let is_far = moves[inside.clone()].iter().any(|m| length_m(m) > limit_m);
                    let covariances = is_far.then(|| half.covariances(&shown, config));
                    Ok(Some(SolvedHalf {
                        moves,
                        covariances: covariances.transpose()?,
                    }))
                })
                .collect::<Result<_, Error>>()?;
            let is_far = |half: &SolvedHalf| half.covariances.is_some();
            let by_all = match halves.iter().flatten().any(is_far) {
                true => Stretch::new(walk, estimate, points, frames).covariances(&shown, config)?,
                false => Vec::new(),
            };
            let moves = halves.into_iter().map(|solved| {
                let Some(mut half) = solved else {
                    return vec![None; core.len()];
                };
                if let Some(by_half) = &half.covariances {
                    weigh(&mut half.moves, [&by_all, by_half], [harmless_m, known_m]);
                }
                half.moves[inside.clone()]
                    .iter()
                    .copied()
                    .map(Some)
                    .collect()
            });
            Ok((core.clone(), moves.collect()))
        })
        .collect::<Result<_, Error>>()?;
    let mut said = vec![HalvesCheck::of_agreement(); checked.len()];
    for (core, halves) in found {
        for moves in halves {
            for (said, moved) in said[core.clone()].iter_mut().zip(moves) {
                *said = said.with(moved);
            }
        }
    }
    Ok(spread_to_neighbours(walk, &checked, &said))
}

/// Of a frame that was not checked what holds for the worse of its two checked neighbours.
fn spread_to_neighbours(walk: &Walk, checked: &[usize], said: &[HalvesCheck]) -> Vec<HalvesCheck> {
    (0..walk.frames.len())
        .map(|frame| {
            let after = checked.partition_point(|k| *k < frame);
            let before = checked.partition_point(|k| *k <= frame).saturating_sub(1);
            let of = |k: usize| {
                said.get(k)
                    .copied()
                    .unwrap_or_else(HalvesCheck::of_agreement)
            };
            of(before).worse(of(after))
        })
        .collect()
}

/// Some frames of a walk, with what is known of them.
struct Stretch {
    walk: Walk,
    estimate: Estimate,
    points: Vec<LocalPoint>,
    /// Group of each point of the map.
    groups: BTreeMap<u32, usize>,
}

impl Stretch {
    fn new(walk: &Walk, estimate: &Estimate, points: &[LocalPoint], frames: &[usize]) -> Self {
        let times = |k: Option<&usize>| k.map_or_else(Default::default, |k| walk.frames[*k].time);
        let (from, to) = (times(frames.first()), times(frames.last()));
        let first = walk
            .imu
            .partition_point(|s| from.secs_since(s.time) > IMU_MARGIN_SECS);
        let end = walk
            .imu
            .partition_point(|s| s.time.secs_since(to) <= IMU_MARGIN_SECS);
        let inside = |point: &LocalPoint| {
            let seen = point.observations.iter().filter_map(|seen| {
                let frame = frames.binary_search(&seen.frame).ok()?;
                Some(LocalObservation { frame, ..*seen })
            });
            LocalPoint {
                point_in_world: point.point_in_world,
                observations: seen.collect(),
            }
        };
        let part = Walk {
            cameras: walk.cameras.clone(),
            frames: frames.iter().map(|k| walk.frames[*k].clone()).collect(),
            imu: walk.imu[first..end.max(first)].to_vec(),
            noise: walk.noise.clone(),
            noise_factors: Default::default(),
            point_covariances_m2: walk.point_covariances_m2.clone(),
        };
        let at = |k: &usize| (estimate.states[*k], estimate.motions[*k]);
        let (states, motions) = frames.iter().map(at).unzip();
        let estimate = Estimate {
            states,
            motions,
            corrections: estimate.corrections.clone(),
            cameras: estimate.cameras.clone(),
        };
        Self {
            groups: groups(&part, &estimate),
            walk: part,
            estimate,
            points: points.iter().map(inside).collect(),
        }
    }

    /// Covariances of its poses; `None` where nothing determines one.
    fn covariances(
        &self,
        shown: &Deviations,
        config: &GroundTruthConfig,
    ) -> Result<Vec<Option<Matrix6<f64>>>, Error> {
        of_stretch(&self.walk, &self.estimate, &self.points, shown, config)
    }

    /// Solved by the points of two groups; `None` where they lead nowhere.
    fn solved_by(
        mut self,
        half: [usize; 2],
        config: &GroundTruthConfig,
    ) -> Result<Option<Self>, Error> {
        let groups = &self.groups;
        let is_kept = |point: &u32| groups.get(point).is_some_and(|g| half.contains(g));
        for frame in &mut self.walk.frames {
            frame.fixed.retain(|seen| is_kept(&seen.point));
            frame.recognised.retain(|seen| is_kept(&seen.point));
        }
        for round in 0..ROUNDS {
            let (walk, points) = (&self.walk, &self.points);
            let solved = match optimize(walk, &self.estimate, points, None, config, &no_progress) {
                Ok(solved) => solved,
                Err(Error::Refused(Refusal::NotConverged { .. }) | Error::Solver(_)) => {
                    return Ok(None);
                }
                Err(other) => return Err(other),
            };
            (self.estimate, self.points) = (solved.estimate, solved.points);
            let is_last = round + 1 == ROUNDS;
            if is_last
                || choose_observations(&mut self.walk, &self.estimate, &mut self.points, config)
                    == 0
            {
                break;
            }
        }
        Ok(Some(self))
    }
}

/// A point of the map as a stretch sees it.
struct Sighted {
    point: u32,
    /// Its direction, as long as the logarithm of its distance: near points are as far from one another as distant ones.
    place: Vector3<f64>,
    sights: usize,
}

/// Divides the points of a stretch into groups that lie together, with about as many sights each: halved where they spread
/// most, and halved again.
fn groups(walk: &Walk, estimate: &Estimate) -> BTreeMap<u32, usize> {
    let mut sighted: BTreeMap<u32, Sighted> = BTreeMap::new();
    for (k, frame) in walk.frames.iter().enumerate() {
        for seen in &frame.recognised {
            let entry = sighted.entry(seen.point).or_insert_with(|| {
                let away_m = seen.point_in_world - estimate.pose(k).translation;
                let distance_m = away_m.norm();
                Sighted {
                    point: seen.point,
                    place: away_m * (distance_m.ln_1p() / distance_m.max(f64::MIN_POSITIVE)),
                    sights: 0,
                }
            });
            entry.sights += 1;
        }
    }
    let mut sighted: Vec<Sighted> = sighted.into_values().collect();
    let mut groups = BTreeMap::new();
    divide(&mut sighted, 0..GROUPS, &mut groups);
    groups
}

fn divide(sighted: &mut [Sighted], numbers: Range<usize>, groups: &mut BTreeMap<u32, usize>) {
    if numbers.len() == 1 || sighted.len() < 2 {
        groups.extend(sighted.iter().map(|s| (s.point, numbers.start)));
        return;
    }
    let total: usize = sighted.iter().map(|s| s.sights).sum();
    let spread = |axis: usize| {
        let weighted = |of: &dyn Fn(&Sighted) -> f64| {
            sighted.iter().map(|s| of(s) * s.sights as f64).sum::<f64>() / total as f64
        };
        let mean = weighted(&|s| s.place[axis]);
        weighted(&|s| (s.place[axis] - mean).powi(2))
    };
    let widest = (0..3).max_by(|a, b| spread(*a).total_cmp(&spread(*b)));
    let axis = widest.unwrap_or(0);
    sighted.sort_by(|a, b| {
        let along = a.place[axis].total_cmp(&b.place[axis]);
        along.then(a.point.cmp(&b.point))
    });
    let mut below = 0;
    let half = sighted.iter().position(|s| {
        below += s.sights;
        2 * below >= total
    });
    let at = half.map_or(1, |k| k + 1).min(sighted.len() - 1);
    let (low, high) = sighted.split_at_mut(at);
    let middle = numbers.start + numbers.len() / 2;
    divide(low, numbers.start..middle, groups);
    divide(high, middle..numbers.end, groups);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A covariance with these standard deviations of attitude and place, the latter along x and across it.
    fn known_to(rotation_rad: f64, along_m: f64, across_m: f64) -> Option<Matrix6<f64>> {
        let r = rotation_rad;
        let sigmas = Vector6::new(r, r, r, along_m, across_m, across_m);
        Some(Matrix6::from_diagonal(&sigmas.map(|sigma| sigma * sigma)))
    }

    fn weighed_m(away_m: f64, by_all: Option<Matrix6<f64>>, by_half: Option<Matrix6<f64>>) -> f64 {
        let mut moves = [Vector6::new(0.0, 0.0, 0.0, away_m, 0.0, 0.0)];
        weigh(&mut moves, [&[by_all], &[by_half]], [0.02, 0.008]);
        length_m(&moves[0])
    }

    /// Half of the points in a narrow part of the view lead far away along it, and the whole hardly listens.
    #[test]
    fn a_half_that_knows_little_says_little() {
        let by_all = known_to(1e-3, 0.003, 0.003);
        let by_weak = known_to(1e-2, 0.03, 0.005);
        let said_m = weighed_m(0.15, by_all, by_weak);
        assert!((said_m - 2.0 * 0.15 * 0.01).abs() < 1e-9, "{said_m}");
        // Both halves know as much: this one counts as it is, as does one that knows all there is.
        let root = 2.0_f64.sqrt();
        let by_equal = known_to(1e-3 * root, 0.003 * root, 0.003 * root);
        assert!((weighed_m(0.15, by_all, by_equal) - 0.15).abs() < 1e-9);
        assert!((weighed_m(0.15, by_all, by_all) - 0.15).abs() < 1e-9);
    }

    /// Before a bare door frame neither the whole nor a half knows a place along it.
    #[test]
    fn where_all_know_little_a_half_counts() {
        let by_half = known_to(1e-2, 0.1, 0.02);
        assert!(weighed_m(0.1, known_to(1e-3, 0.012, 0.003), by_half) > 0.099);
        assert!(weighed_m(0.1, known_to(1e-3, 0.006, 0.003), by_half) < 0.001);
        assert!(weighed_m(0.1, None, by_half) > 0.099);
        assert!(weighed_m(0.1, by_half, None) > 0.099);
    }
}
