//! The blocks of one state, and what the IMU says of neighbours.

use lsfb_geometry::{Se3, Vector3};
use lsfb_solver::{Block, Kernel, Problem, VectorPrior};

use super::GroundTruthConfig;
use super::imu_wander::room_to_wander;
use super::walk::{FrameState, Walk};
use nalgebra::{SVector, Vector1, Vector6};

use crate::Error;
use crate::preintegration::{
    ImuBias, ImuErrors, Matrix9, NavState, PreintegratedImu, standard_gravity_m_s2,
};
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

/// Blocks of what is the same all along: gravity in the world, and errors of the IMU.
#[derive(Clone, Copy)]
pub(super) struct InertialBlocks {
    pub gravity: Block<Vector3<f64>>,
    /// Scale and shear.
    pub gyro_axes: Block<Vector6<f64>>,
    pub accel_axes: Block<Vector6<f64>>,
    pub accel_turn_rad: Block<Vector3<f64>>,
    pub accel_delay_s: Block<Vector1<f64>>,
    pub world_scale: Block<Vector1<f64>>,
}

impl InertialBlocks {
    /// With what is known of them beforehand. `has_map` says whether the world is a map's: without one lengths are the IMU's.
    fn add(
        problem: &mut Problem,
        config: &GroundTruthConfig,
        has_map: bool,
    ) -> Result<Self, Error> {
        let known = &config.inertial;
        let world_scale = about(
            problem,
            Vector1::zeros(),
            Vector1::new(known.map_scale_sigma),
        )?;
        if !has_map {
            problem.set_constant(world_scale);
        }
        let (lean, size) = (config.gravity_sigma_m_s2, known.gravity_size_sigma_m_s2);
        let gravity_sigmas = Vector3::new(lean, lean, size);
        Ok(Self {
            // The map is level only as far as its odometry knew: gravity may lean a little.
            gravity: about(problem, standard_gravity_m_s2(), gravity_sigmas)?,
            gyro_axes: about(
                problem,
                Vector6::zeros(),
                axes(known.gyro_scale_sigma, known.shear_sigma),
            )?,
            accel_axes: about(
                problem,
                Vector6::zeros(),
                axes(known.accel_scale_sigma, known.shear_sigma),
            )?,
            accel_turn_rad: about(
                problem,
                Vector3::zeros(),
                Vector3::repeat(known.accel_turn_sigma_rad),
            )?,
            accel_delay_s: about(
                problem,
                Vector1::zeros(),
                Vector1::new(known.accel_delay_sigma_s),
            )?,
            world_scale,
        })
    }

    pub fn errors(&self, problem: &Problem) -> ImuErrors {
        let (gyro, accel) = (
            problem.value(self.gyro_axes),
            problem.value(self.accel_axes),
        );
        ImuErrors {
            gyro_scale: gyro.fixed_rows::<3>(0).into(),
            gyro_shear: gyro.fixed_rows::<3>(3).into(),
            accel_scale: accel.fixed_rows::<3>(0).into(),
            accel_shear: accel.fixed_rows::<3>(3).into(),
            accel_turn_rad: problem.value(self.accel_turn_rad),
            accel_delay_s: problem.value(self.accel_delay_s).x,
            world_scale: problem.value(self.world_scale).x,
        }
    }
}

/// Scales of three axes, and shears of three pairs.
fn axes(scale: f64, shear: f64) -> Vector6<f64> {
    Vector6::new(scale, scale, scale, shear, shear, shear)
}

/// A block with what is known of it beforehand.
fn about<const N: usize>(
    problem: &mut Problem,
    known: SVector<f64, N>,
    sigmas: SVector<f64, N>,
) -> Result<Block<SVector<f64, N>>, Error> {
    let block = problem.add_block(known);
    let prior = VectorPrior::new(known, sigmas);
    problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
    Ok(block)
}

/// Adds `h(C_i, C_i+1)` of eq. (5) for all neighbours among some frames, from the first on, and what is known of the biases
/// beforehand. The IMU is summed up with the biases that the blocks have now. `None` without frames.
pub(super) fn add_inertial_residuals(
    problem: &mut Problem,
    walk: &Walk,
    first_frame: usize,
    states: &[StateBlocks],
    config: &GroundTruthConfig,
) -> Result<Option<InertialBlocks>, Error> {
    let Some(first) = states.first() else {
        return Ok(None);
    };
    let now: Vec<FrameState> = states.iter().map(|s| s.read(problem)).collect();
    let frames = first_frame..first_frame + states.len();
    let intervals = walk.preintegrate(frames, |k| now[k - first_frame].bias)?;
    let has_map = walk.frames.iter().any(|frame| !frame.fixed.is_empty());
    let shared = InertialBlocks::add(problem, config, has_map)?;
    for (block, sigma) in [
        (first.gyro_bias, config.gyro_bias_sigma_rad_s),
        (first.accel_bias, config.accel_bias_sigma_m_s2),
    ] {
        let prior = VectorPrior::new(Vector3::zeros(), Vector3::repeat(sigma));
        problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
    }
    for (k, (pair, interval)) in states.windows(2).zip(intervals).enumerate() {
        let [a, b] = [pair[0], pair[1]];
        let frame = first_frame + k;
        let duration_secs = walk.frames[frame + 1]
            .time
            .secs_since(walk.frames[frame].time);
        let room = room_to_wander(walk, frame, &config.inertial);
        for (from, to, walk_per_sqrt_s) in [
            (a.gyro_bias, b.gyro_bias, walk.noise.gyro_bias_walk),
            (a.accel_bias, b.accel_bias, walk.noise.accel_bias_walk),
        ] {
            let wander = BiasWalk {
                walk_per_sqrt_s: room * walk_per_sqrt_s,
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
                shared.gravity.id(),
                shared.gyro_axes.id(),
                shared.accel_axes.id(),
                shared.accel_turn_rad.id(),
                shared.accel_delay_s.id(),
                shared.world_scale.id(),
            ];
            problem.add_residual(residual.with_errors(), &blocks, Kernel::Squared)?;
        }
    }
    Ok(Some(shared))
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
