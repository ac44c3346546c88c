//! The blocks of one state, and what the IMU says of neighbours.

use lsfb_geometry::{Se3, Vector3};
use lsfb_solver::{Block, Kernel, Problem};

use super::GroundTruthConfig;
use super::walk::{FrameState, Walk};
use crate::Error;
use crate::preintegration::{ImuBias, Matrix9, NavState, PreintegratedImu, standard_gravity_m_s2};
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
    pub fn add(problem: &mut Problem, state: &FrameState) -> Self {
        Self {
            pose: problem.add_block(state.nav.world_from_rig),
            velocity: problem.add_block(state.nav.velocity_m_s),
            gyro_bias: problem.add_block(state.bias.gyro_rad_s),
            accel_bias: problem.add_block(state.bias.accel_m_s2),
        }
    }

    pub fn read(&self, problem: &Problem) -> FrameState {
        FrameState {
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

/// Adds `h(C_i, C_i+1)` of eq. (5) for all neighbours among some frames, from the first on, and what is known of the biases
/// beforehand. The IMU is summed up with the biases that the blocks have now. Gives gravity; `None` without frames.
pub(super) fn add_inertial_residuals(
    problem: &mut Problem,
    walk: &Walk,
    first_frame: usize,
    states: &[StateBlocks],
    config: &GroundTruthConfig,
) -> Result<Option<Block<Vector3<f64>>>, Error> {
    let Some(first) = states.first() else {
        return Ok(None);
    };
    let now: Vec<FrameState> = states.iter().map(|s| s.read(problem)).collect();
    let frames = first_frame..first_frame + states.len();
    let intervals = walk.preintegrate(frames, |k| now[k - first_frame].bias)?;
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
        let frame = first_frame + k;
        let duration_secs = walk.frames[frame + 1]
            .time
            .secs_since(walk.frames[frame].time);
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
        let interval = interval.unwrap_or_else(|| any_motion(&now[k], duration_secs));
        if let Some(residual) = ImuPreintegration::new(interval) {
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
    Ok(Some(gravity))
}

/// Standard deviations of how a body moves of which nothing was measured: turns, rad/s, and accelerates, m/s².
pub(super) const ANY_TURN_RAD_S: f64 = 2.0;
pub(super) const ANY_ACCELERATION_M_S2: f64 = 3.0;

/// What is known where the IMU says nothing: a body goes on as it did, more or less.
pub(super) fn any_motion(from: &FrameState, duration_secs: f64) -> PreintegratedImu {
    let resting = from.nav.world_from_rig.rotation.inverse() * -standard_gravity_m_s2();
    let mut motion = PreintegratedImu::nothing(from.bias);
    motion.duration_secs = duration_secs;
    motion.velocity_m_s = resting * duration_secs;
    motion.position_m = resting * (0.5 * duration_secs * duration_secs);
    let sigmas = [
        ANY_TURN_RAD_S * duration_secs,
        ANY_ACCELERATION_M_S2 * duration_secs,
        0.5 * ANY_ACCELERATION_M_S2 * duration_secs * duration_secs,
    ];
    motion.covariance = Matrix9::from_fn(|row, column| {
        if row == column {
            sigmas[row / 3].powi(2)
        } else {
            0.0
        }
    });
    motion
}
