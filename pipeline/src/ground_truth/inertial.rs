//! First states of all frames: localized poses, joined and checked by the IMU.

use lsfb_geometry::{Se3, StampedPose, Trajectory, Vector3, so3};
use lsfb_solver::{Block, Kernel, PosePrior, Problem, solve};

use super::GroundTruthConfig;
use super::walk::{State, Walk};
use crate::Error;
use crate::preintegration::{ImuBias, NavState, PreintegratedImu, standard_gravity_m_s2};
use crate::residuals::{BiasWalk, ImuPreintegration};

/// Blocks of one state.
#[derive(Clone, Copy)]
pub(super) struct StateBlocks {
    pub pose: Block<Se3>,
    pub velocity: Block<Vector3<f64>>,
    pub gyro_bias: Block<Vector3<f64>>,
    pub accel_bias: Block<Vector3<f64>>,
}

impl StateBlocks {
    pub fn add(problem: &mut Problem, state: &State) -> Self {
        Self {
            pose: problem.add_block(state.nav.world_from_rig),
            velocity: problem.add_block(state.nav.velocity_m_s),
            gyro_bias: problem.add_block(state.bias.gyro_rad_s),
            accel_bias: problem.add_block(state.bias.accel_m_s2),
        }
    }

    pub fn read(&self, problem: &Problem) -> State {
        State {
            nav: NavState {
                world_from_rig: problem.value(self.pose),
                velocity_m_s: problem.value(self.velocity),
            },
            bias: ImuBias {
                gyro_rad_s: problem.value(self.gyro_bias),
                accel_m_s2: problem.value(self.accel_bias),
            },
        }
    }
}

/// Adds `h(C_i, C_i+1)` of eq. (5) for all neighbours, and what is known of the biases beforehand.
pub(super) fn add_inertial_residuals(
    problem: &mut Problem,
    walk: &Walk,
    states: &[StateBlocks],
    intervals: &[Option<PreintegratedImu>],
    config: &GroundTruthConfig,
) -> Result<(), Error> {
    let Some(first) = states.first() else {
        return Ok(());
    };
    // The map is level only as far as its odometry knew: gravity may lean a little.
    let gravity = problem.add_block(standard_gravity_m_s2());
    for (block, known, sigma) in [
        (
            first.gyro_bias,
            Vector3::zeros(),
            config.gyro_bias_sigma_rad_s,
        ),
        (
            first.accel_bias,
            Vector3::zeros(),
            config.accel_bias_sigma_m_s2,
        ),
        (gravity, standard_gravity_m_s2(), config.gravity_sigma_m_s2),
    ] {
        let known = problem.add_block(known);
        problem.set_constant(known);
        // A prior is a walk of one second from a known value.
        let prior = BiasWalk {
            walk_per_sqrt_s: sigma,
            duration_secs: 1.0,
        };
        problem.add_residual(prior, &[known.id(), block.id()], Kernel::Squared)?;
    }
    for (k, (pair, interval)) in states.windows(2).zip(intervals).enumerate() {
        let [a, b] = [pair[0], pair[1]];
        let duration_secs = walk.frames[k + 1].time.secs_since(walk.frames[k].time);
        for (from, to, walk_per_sqrt_s) in [
            (a.gyro_bias, b.gyro_bias, walk.noise.gyro_bias_walk),
            (a.accel_bias, b.accel_bias, walk.noise.accel_bias_walk),
        ] {
            let wander = BiasWalk {
                walk_per_sqrt_s,
                duration_secs,
            };
            problem.add_residual(wander, &[from.id(), to.id()], Kernel::Squared)?;
        }
        if let Some(residual) = interval.clone().and_then(ImuPreintegration::new) {
            let blocks = [
                a.pose.id(),
                a.velocity.id(),
                a.gyro_bias.id(),
                a.accel_bias.id(),
                b.pose.id(),
                b.velocity.id(),
                gravity.id(),
            ];
            problem.add_residual(residual, &blocks, Kernel::Squared)?;
        }
    }
    Ok(())
}

/// States that agree with the IMU and with most localized poses.
pub(super) struct InertialStart {
    pub states: Vec<State>,
    pub rejected_localizations: usize,
}

/// Solves for the states with robust localized poses; takes those that do not fit out of the walk, with their
/// observations, and solves again.
pub(super) fn start_states(
    walk: &mut Walk,
    config: &GroundTruthConfig,
) -> Result<InertialStart, Error> {
    let mut states = guess(walk);
    let mut rejected_localizations = 0;
    loop {
        let intervals = walk.preintegrate(|k| states[k].bias)?;
        states = fit(walk, &states, &intervals, config)?;
        let mut rejected = 0;
        for (frame, state) in walk.frames.iter_mut().zip(&states) {
            if let Some(localized) = frame.localized
                && !agrees(&localized, &state.nav.world_from_rig, config)
            {
                frame.localized = None;
                frame.fixed.clear();
                rejected += 1;
            }
        }
        rejected_localizations += rejected;
        if rejected == 0 {
            return Ok(InertialStart {
                states,
                rejected_localizations,
            });
        }
    }
}

/// Within four standard deviations in rotation and in translation.
fn agrees(localized: &Se3, fitted: &Se3, config: &GroundTruthConfig) -> bool {
    let error = localized.inverse() * *fitted;
    so3::log(&error.rotation).norm() <= 4.0 * config.localization_sigma_rad
        && error.translation.norm() <= 4.0 * config.localization_sigma_m
}

/// Poses on lines between the localized ones, velocities from them, no bias.
fn guess(walk: &Walk) -> Vec<State> {
    let known = Trajectory::new(
        walk.frames
            .iter()
            .filter_map(|frame| {
                Some(StampedPose {
                    time: frame.time,
                    world_from_rig: frame.localized?,
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
            State {
                nav: NavState {
                    world_from_rig: poses[k],
                    velocity_m_s,
                },
                bias: ImuBias::default(),
            }
        })
        .collect()
}

fn fit(
    walk: &Walk,
    states: &[State],
    intervals: &[Option<PreintegratedImu>],
    config: &GroundTruthConfig,
) -> Result<Vec<State>, Error> {
    let mut problem = Problem::new();
    let blocks: Vec<StateBlocks> = states
        .iter()
        .map(|state| StateBlocks::add(&mut problem, state))
        .collect();
    for (frame, state) in walk.frames.iter().zip(&blocks) {
        if let Some(localized) = frame.localized {
            let prior = PosePrior::isotropic(
                localized,
                config.localization_sigma_rad,
                config.localization_sigma_m,
            );
            problem.add_residual(prior, &[state.pose.id()], Kernel::Cauchy { scale: 2.0 })?;
        }
    }
    add_inertial_residuals(&mut problem, walk, &blocks, intervals, config)?;
    solve(&mut problem, &config.solve)?;
    Ok(blocks.iter().map(|b| b.read(&problem)).collect())
}
