//! First states of all frames: the localized poses that agree, joined by the IMU.

use lsfb_geometry::{Matrix6, Se3, StampedPose, Trajectory, Vector3, Vector6, so3};
use lsfb_solver::{Kernel, PosePrior, Problem};
use lsfb_types::ProgressFn;

use super::consensus::consistent_sets;
use super::dead_reckoning::DeadReckoning;
use super::drift::drifts;
use super::inertial::add_inertial_residuals;
use super::walk::{FrameState, LocalizedPose, Walk};
use super::{GroundTruthConfig, LocalizedInstant};
use crate::Error;
use crate::inertial_blocks::StateBlocks;
use crate::solve::solve_until_converged;
use lsfb_perception::imu::{ImuBias, NavState, standard_gravity_m_s2};

/// Explanations of a walk that are tried, the one of the largest consistent set first.
const EXPLANATIONS: usize = 4;
/// A localized pose that was refused so often does not come back, so that an end is reached.
const TIMES_REFUSED: usize = 3;
/// A localized pose agrees up to this norm of its whitened difference: what one of a million exceeds.
const LARGEST_WHITENED: f64 = 6.2;
/// What is foretold with a larger standard deviation is looked at after what is foretold better, metres.
const FORETOLD_M: f64 = 0.3;
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
    let imu_of_all = DeadReckoning::of(walk)?;
    let kept = telling_frames(walk, &imu_of_all);
    let telling = walk.with_frames(&kept);
    let imu = DeadReckoning::of(&telling)?;
    let sets = consistent_sets(&telling, &imu, config);
    let mut explanations: Vec<Explanation> = Vec::new();
    for set in &sets {
        if explanations.len() == EXPLANATIONS {
            break;
        }
        let explained = |e: &Explanation| set.iter().filter(|k| e.accepted[**k]).count();
        if explanations.iter().all(|e| 2 * explained(e) < set.len()) {
            explanations.push(explain(&telling, &imu, &sets, set, config, progress)?);
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
            let mut states = States::unknown(walk.frames.len());
            states.of_frames = between(walk, &kept, &best.states);
            states.fit(walk, &imu_of_all, &accepted, config, progress)?;
            states.of_frames
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
fn telling_frames(walk: &Walk, imu: &DeadReckoning) -> Vec<usize> {
    if !walk.has_imu() {
        return (0..walk.frames.len()).collect();
    }
    let mut kept: Vec<usize> = Vec::new();
    for (k, frame) in walk.frames.iter().enumerate() {
        let is_inside = k > 0 && imu.is_measured(k - 1) && imu.is_measured(k);
        let last = kept.last().map(|last| walk.frames[*last].time);
        let is_due = last.is_none_or(|last| frame.time.secs_since(last) >= SUMMED_SECS);
        if frame.localized.is_some() || !is_inside || is_due {
            kept.push(k);
        }
    }
    kept
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

/// Begins with a set of localized poses, and goes on from it to those that the IMU leads to; after every solve all are looked at again, those in
/// use and those that are not.
fn explain(
    walk: &Walk,
    imu: &DeadReckoning,
    sets: &[Vec<usize>],
    begun_with: &[usize],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Explanation, Error> {
    let count = walk.frames.len();
    let mut accepted = vec![false; count];
    for frame in begun_with {
        accepted[*frame] = true;
    }
    let mut states = States::unknown(count).joined(walk, imu, &accepted);
    let mut refused = vec![0; count];
    let cost = loop {
        let cost = states.fit(walk, imu, &accepted, config, progress)?;
        let drifts = drifts(walk, imu, &accepted, config);
        let may = |k: usize| refused[k] < TIMES_REFUSED;
        let agrees = |k: usize| {
            let pose = &states.of_frames[k].nav.world_from_rig;
            may(k)
                && walk.frames[k].localized.is_some_and(|localized| {
                    let covariance = spread(&localized, config) + drifts[k];
                    whitened_norm(&localized.world_from_rig, pose, &covariance) <= LARGEST_WHITENED
                })
        };
        let agreeing: Vec<bool> = (0..count).map(agrees).collect();
        let drift_m = |k: usize| drifts[k][(3, 3)].sqrt();
        let next = next_accepted(&accepted, &agreeing, drift_m, sets, may);
        let is_last = next == accepted || !next.contains(&true);
        for (times, (was, is)) in refused.iter_mut().zip(accepted.iter().zip(&next)) {
            *times += usize::from(*was && !is);
        }
        accepted = next;
        if is_last {
            break cost;
        }
        states = states.joined(walk, imu, &accepted);
    };
    let localized = walk.frames.iter().filter(|f| f.localized.is_some()).count();
    let refused = localized - accepted.iter().filter(|accepted| **accepted).count();
    let each = 0.5 * KERNEL.at(LARGEST_WHITENED.powi(2)).cost;
    Ok(Explanation {
        begun_with: begun_with.to_vec(),
        states: states.of_frames,
        accepted,
        cost: cost + refused as f64 * each,
    })
}

/// Which localized poses are accepted next: of those that agree the ones that were, the ones that the IMU foretells well, and the rest of their
/// sets, where most of those that it foretells well agree; where it foretells none well, the ones that it foretells best. What is foretold badly
/// agrees anyhow: it waits until more is known.
fn next_accepted(
    accepted: &[bool],
    agreeing: &[bool],
    drift_m: impl Fn(usize) -> f64,
    sets: &[Vec<usize>],
    may: impl Fn(usize) -> bool,
) -> Vec<bool> {
    let new = |k: &usize| agreeing[*k] && !accepted[*k];
    let of_new = (0..accepted.len()).filter(new).map(&drift_m);
    let reach_m = of_new.fold(f64::INFINITY, f64::min).max(FORETOLD_M);
    let is_in_reach = |k: &usize| drift_m(*k) <= reach_m;
    let comes = |k: usize| agreeing[k] && (accepted[k] || is_in_reach(&k));
    let mut next: Vec<bool> = (0..accepted.len()).map(comes).collect();
    for set in sets {
        let in_reach = set.iter().filter(|k| is_in_reach(k));
        let agree = in_reach.clone().filter(|k| agreeing[**k]).count();
        if 2 * agree > in_reach.count() {
            for k in set.iter().filter(|k| may(**k) && !is_in_reach(k)) {
                next[*k] = true;
            }
        }
    }
    next
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

/// States of all frames while it is found out which localized poses belong together.
struct States {
    of_frames: Vec<FrameState>,
    /// Frames whose poses were solved for with a localized one.
    held: Vec<bool>,
    /// In the world, m/s².
    gravity_m_s2: Vector3<f64>,
}

impl States {
    fn unknown(count: usize) -> Self {
        let nowhere = FrameState {
            nav: NavState {
                world_from_rig: Se3::identity(),
                velocity_m_s: Vector3::zeros(),
            },
            bias: ImuBias::default(),
        };
        Self {
            of_frames: vec![nowhere; count],
            held: vec![false; count],
            gravity_m_s2: standard_gravity_m_s2(),
        }
    }

    /// Leads through the localized poses that are accepted and held nothing in the last solve: where the IMU led without them may be so far off
    /// that the kernel would let go of them.
    fn joined(mut self, walk: &Walk, imu: &DeadReckoning, accepted: &[bool]) -> Self {
        let pose = |k: usize| match self.held[k] {
            true => Some(self.of_frames[k].nav.world_from_rig),
            false => Some(walk.frames[k].localized?.world_from_rig),
        };
        let of_accepted = (0..accepted.len()).filter(|k| accepted[*k]);
        let known: Vec<(usize, Se3)> = of_accepted.filter_map(|k| Some((k, pose(k)?))).collect();
        let solved = self.held.iter().position(|held| *held);
        let mut bias = solved.map_or(ImuBias::default(), |k| self.of_frames[k].bias);
        for pair in known.windows(2) {
            let [from, to] = [pair[0], pair[1]];
            let [from_held, to_held] = [from, to].map(|(k, _)| self.held[k]);
            if from_held {
                bias = self.of_frames[from.0].bias;
            }
            if from_held && to_held {
                continue;
            }
            let between = imu.between([from, to], bias, &self.gravity_m_s2);
            for (k, state) in (from.0..=to.0).zip(between) {
                let is_solved = (k == from.0 && from_held) || (k == to.0 && to_held);
                if !is_solved {
                    self.of_frames[k] = state;
                }
            }
        }
        self
    }

    /// Solves for the states with the accepted localized poses and the IMU; before the first and behind the last of them the IMU alone leads.
    /// Returns the cost.
    fn fit(
        &mut self,
        walk: &Walk,
        imu: &DeadReckoning,
        accepted: &[bool],
        config: &GroundTruthConfig,
        progress: ProgressFn<'_>,
    ) -> Result<f64, Error> {
        let first = accepted.iter().position(|accepted| *accepted);
        let last = accepted.iter().rposition(|accepted| *accepted);
        let (Some(first), Some(last)) = (first, last) else {
            return Ok(0.0);
        };
        let span = first..last + 1;
        let mut problem = Problem::new();
        let blocks: Vec<StateBlocks> = self.of_frames[span.clone()]
            .iter()
            .map(|state| StateBlocks::add(&mut problem, state))
            .collect();
        for (k, state) in span.clone().zip(&blocks) {
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
        let inertial = add_inertial_residuals(&mut problem, walk, span.start, &blocks, config)?;
        let report = solve_until_converged("first states", &mut problem, &config.solve, progress)?;
        for (state, block) in self.of_frames[span.clone()].iter_mut().zip(&blocks) {
            *state = block.read(&problem);
        }
        if let Some(inertial) = inertial {
            self.gravity_m_s2 = problem.value(inertial.gravity);
        }
        imu.carry_on(&mut self.of_frames, span, &self.gravity_m_s2);
        self.held = accepted.to_vec();
        Ok(report.final_cost)
    }
}
