//! First states of all frames: the localized poses that agree, joined by the IMU.

use lsfb_geometry::{Matrix6, Se3, StampedPose, Trajectory, Vector3, Vector6, so3};
use lsfb_solver::{Kernel, PosePrior, Problem};
use lsfb_types::ProgressFn;

use super::consensus::consistent_sets;
use super::drift::drifts;
use super::inertial::add_inertial_residuals;
use super::walk::{FrameState, LocalizedPose, Walk};
use super::{GroundTruthConfig, LocalizedInstant};
use crate::Error;
use crate::inertial_blocks::StateBlocks;
use crate::preintegration::{ImuBias, NavState};
use crate::solve::solve_until_converged;

/// Explanations of a walk that are tried, the one of the largest consistent set first.
const EXPLANATIONS: usize = 4;
/// Rounds in which what was rejected may come back; after them it may not, so that an end is reached.
const ROUNDS_BOTH_WAYS: usize = 12;
/// A localized pose agrees up to this norm of its whitened difference: what one of a million exceeds.
const LARGEST_WHITENED: f64 = 6.2;
/// The IMU is summed up over this long between the frames with which explanations are tried, seconds.
const SUMMED_SECS: f64 = 0.09;
/// The robust kernel on localized poses, in standard deviations.
const KERNEL: Kernel = Kernel::Cauchy { scale: 2.0 };

/// States that agree with the IMU and with all localized poses that are accepted.
pub(super) struct Start {
    /// One for each frame.
    pub states: Vec<FrameState>,
    /// Which frames have a localized pose that agrees.
    pub accepted: Vec<bool>,
    /// How many do.
    pub accepted_count: usize,
    /// Localized poses of the best other explanation of the walk that contradict this one.
    pub rival_count: usize,
}

impl Start {
    /// The localized poses, and whether each agrees.
    pub fn localizations(&self, walk: &Walk) -> Vec<LocalizedInstant> {
        let frames = walk.frames.iter().zip(&self.accepted);
        let localized = frames.filter_map(|(frame, accepted)| {
            Some(LocalizedInstant {
                time: frame.time,
                world_from_rig: frame.localized?.world_from_rig,
                is_accepted: *accepted,
            })
        });
        localized.collect()
    }
}

/// Solves for the states from each of the largest consistent sets, and keeps the explanation that costs least. `None` where no
/// localized poses agree.
pub(super) fn start_states(
    walk: &Walk,
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Option<Start>, Error> {
    let kept = telling_frames(walk)?;
    let telling = walk.with_frames(&kept);
    let mut explanations: Vec<Explanation> = Vec::new();
    for set in consistent_sets(&telling, config)? {
        if explanations.len() == EXPLANATIONS {
            break;
        }
        let explained = |e: &Explanation| set.iter().filter(|k| e.accepted[**k]).count();
        if explanations.iter().all(|e| 2 * explained(e) < set.len()) {
            explanations.push(explain(&telling, &set, config, progress)?);
        }
    }
    // The sort is stable: of equals the one that began with the larger set.
    explanations.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut explanations = explanations.into_iter();
    let Some(best) = explanations.next() else {
        return Ok(None);
    };
    let contradicting = |other: Explanation| {
        let begun = |k: usize| other.begun_with.binary_search(&k).is_ok();
        let says = |k: usize| other.accepted[k] || begun(k);
        (0..kept.len())
            .filter(|k| says(*k) && !best.accepted[*k])
            .count()
    };
    let rival_count = explanations.map(contradicting).max().unwrap_or(0);
    let mut accepted = vec![false; walk.frames.len()];
    for (frame, is_accepted) in kept.iter().zip(&best.accepted) {
        accepted[*frame] = *is_accepted;
    }
    let accepted_count = best.count();
    let states = match kept.len() == walk.frames.len() {
        true => best.states,
        false => {
            let between = between(walk, &kept, &best.states);
            fit(walk, &between, &accepted, config, progress)?.states
        }
    };
    Ok(Some(Start {
        rival_count,
        accepted_count,
        states,
        accepted,
    }))
}

/// Frames that tell one explanation from another: the localized ones, those around what the IMU did not measure, and so many between them
/// that it is never summed up for long.
fn telling_frames(walk: &Walk) -> Result<Vec<usize>, Error> {
    let count = walk.frames.len();
    if !walk.has_imu() {
        return Ok((0..count).collect());
    }
    let covered = walk.is_covered_by_imu()?;
    let is_covered =
        |interval: Option<usize>| interval.is_some_and(|k| covered.get(k) == Some(&true));
    let mut kept: Vec<usize> = Vec::new();
    for (k, frame) in walk.frames.iter().enumerate() {
        let is_inside = is_covered(k.checked_sub(1)) && is_covered(Some(k));
        let last = kept.last().map(|last| walk.frames[*last].time);
        let is_due = last.is_none_or(|last| frame.time.secs_since(last) >= SUMMED_SECS);
        if frame.localized.is_some() || !is_inside || is_due {
            kept.push(k);
        }
    }
    Ok(kept)
}

/// States of all frames by those of some, the first and the last among them.
fn between(walk: &Walk, kept: &[usize], states: &[FrameState]) -> Vec<FrameState> {
    let known = kept.iter().zip(states).map(|(frame, state)| StampedPose {
        time: walk.frames[*frame].time,
        world_from_rig: state.nav.world_from_rig,
    });
    let poses = Trajectory::new(known.collect());
    let frames = walk.frames.iter().enumerate();
    let all = frames.map(|(k, frame)| {
        let before = kept.partition_point(|kept| *kept <= k).saturating_sub(1);
        let mut state = states[before];
        if let Some(pose) = poses.at(frame.time) {
            state.nav.world_from_rig = pose;
        }
        state
    });
    all.collect()
}

/// States, and the localized poses that agree with them.
struct Explanation {
    /// The consistent set that it began with, in order.
    begun_with: Vec<usize>,
    states: Vec<FrameState>,
    accepted: Vec<bool>,
    /// Cost of the solve, and for each localized pose that is not accepted that of one that just were: to bend the IMU's motion
    /// for one more is no gain.
    cost: f64,
}

impl Explanation {
    fn count(&self) -> usize {
        self.accepted.iter().filter(|accepted| **accepted).count()
    }
}

/// Begins with a set of localized poses; after every solve all are looked at again, those in use and those that are not.
fn explain(
    walk: &Walk,
    set: &[usize],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Explanation, Error> {
    let mut accepted = vec![false; walk.frames.len()];
    for frame in set {
        accepted[*frame] = true;
    }
    let mut states = guess(walk, &accepted);
    let mut cost = f64::INFINITY;
    for round in 1.. {
        let fitted = fit(walk, &states, &accepted, config, progress)?;
        (states, cost) = (fitted.states, fitted.cost);
        let drifts = drifts(walk, &accepted, config)?;
        let agrees = |k: usize| {
            let pose = &states[k].nav.world_from_rig;
            let may = accepted[k] || round <= ROUNDS_BOTH_WAYS;
            may && walk.frames[k].localized.is_some_and(|localized| {
                let covariance = spread(&localized, config) + drifts[k];
                whitened_norm(&localized.world_from_rig, pose, &covariance) <= LARGEST_WHITENED
            })
        };
        let next: Vec<bool> = (0..walk.frames.len()).map(agrees).collect();
        if next == accepted || !next.contains(&true) {
            accepted = next;
            break;
        }
        accepted = next;
    }
    let localized = walk.frames.iter().filter(|f| f.localized.is_some()).count();
    let refused = localized - accepted.iter().filter(|accepted| **accepted).count();
    let each = 0.5 * KERNEL.at(LARGEST_WHITENED.powi(2)).cost;
    Ok(Explanation {
        begun_with: set.to_vec(),
        states,
        accepted,
        cost: cost + refused as f64 * each,
    })
}

/// Covariance of a localized pose: what is claimed for this one, and what holds for all.
fn spread(localized: &LocalizedPose, config: &GroundTruthConfig) -> Matrix6<f64> {
    let (r, t) = (
        config.localization_sigma_rad.powi(2),
        config.localization_sigma_m.powi(2),
    );
    localized.covariance + Matrix6::from_diagonal(&Vector6::new(r, r, r, t, t, t))
}

/// Norm of the difference in units of its standard deviations; infinite where there is no such unit.
fn whitened_norm(localized: &Se3, fitted: &Se3, covariance: &Matrix6<f64>) -> f64 {
    let error = localized.inverse() * *fitted;
    let (turn, shift) = (so3::log(&error.rotation), error.translation);
    let error = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
    covariance
        .cholesky()
        .and_then(|factor| factor.l().solve_lower_triangular(&error))
        .map_or(f64::INFINITY, |whitened| whitened.norm())
}

/// Poses on lines between the accepted ones, velocities from them, no bias.
fn guess(walk: &Walk, accepted: &[bool]) -> Vec<FrameState> {
    let known = walk.frames.iter().zip(accepted).filter(|(_, a)| **a);
    let known = Trajectory::new(
        known
            .filter_map(|(frame, _)| {
                Some(StampedPose {
                    time: frame.time,
                    world_from_rig: frame.localized?.world_from_rig,
                })
            })
            .collect(),
    );
    let poses: Vec<Se3> = walk
        .frames
        .iter()
        .map(|frame| {
            let end = if known.poses().first().is_some_and(|p| frame.time < p.time) {
                known.poses().first()
            } else {
                known.poses().last()
            };
            known
                .at(frame.time)
                .or(end.map(|p| p.world_from_rig))
                .unwrap_or(Se3::identity())
        })
        .collect();
    (0..poses.len())
        .map(|k| {
            let (before, after) = (k.saturating_sub(1), (k + 1).min(poses.len() - 1));
            let span = walk.frames[after].time.secs_since(walk.frames[before].time);
            let moved = poses[after].translation - poses[before].translation;
            let velocity_m_s = if span > 0.0 {
                moved / span
            } else {
                Vector3::zeros()
            };
            FrameState {
                nav: NavState {
                    world_from_rig: poses[k],
                    velocity_m_s,
                },
                bias: ImuBias::default(),
            }
        })
        .collect()
}

struct Fitted {
    states: Vec<FrameState>,
    cost: f64,
}

/// Solves for the states with the accepted localized poses and the IMU.
fn fit(
    walk: &Walk,
    states: &[FrameState],
    accepted: &[bool],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Fitted, Error> {
    let mut problem = Problem::new();
    let blocks: Vec<StateBlocks> = states
        .iter()
        .map(|state| StateBlocks::add(&mut problem, state))
        .collect();
    for (k, state) in blocks.iter().enumerate() {
        let localized = walk.frames[k].localized.filter(|_| accepted[k]);
        let prior = localized.and_then(|localized| {
            let factor = spread(&localized, config).cholesky()?;
            Some(PosePrior {
                value: localized.world_from_rig,
                sqrt_information: factor.l().solve_lower_triangular(&Matrix6::identity())?,
            })
        });
        if let Some(prior) = prior {
            problem.add_residual(prior, &[state.pose.id()], KERNEL)?;
        }
    }
    add_inertial_residuals(&mut problem, walk, 0, &blocks, config)?;
    let report = solve_until_converged("first states", &mut problem, &config.solve, progress)?;
    Ok(Fitted {
        states: blocks.iter().map(|b| b.read(&problem)).collect(),
        cost: report.final_cost,
    })
}
