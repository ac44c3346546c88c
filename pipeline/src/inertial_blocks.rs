//! States that an IMU ties to one another, as blocks of a least-squares problem: keyframes of Eq. (4), instants of eq. (5).

use lsfb_geometry::{ImuNoiseModel, Se3, Vector3};
use lsfb_solver::{Block, BlockId, Kernel, Problem, VectorPrior};
use nalgebra::SVector;

use crate::Error;
use crate::residuals::{BiasWalk, ImuPreintegration};
use lsfb_perception::imu::{ImuBias, NavState};

/// By how much an IMU's noise is usually taken larger than the rig file says: densities leave out scale errors and vibration.
pub(crate) const USUAL_NOISE_FACTOR: f64 = 2.0;
/// Usual standard deviations of the first biases about zero, rad/s and m/s².
pub(crate) const USUAL_GYRO_BIAS_RAD_S: f64 = 0.05;
pub(crate) const USUAL_ACCEL_BIAS_M_S2: f64 = 0.3;

/// What is searched at an instant: `C_i` of eq. (5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FrameState {
    pub nav: NavState,
    pub bias: ImuBias,
}

/// Blocks of one state.
#[derive(Clone, Copy)]
pub(crate) struct StateBlocks {
    pub pose: Block<Se3>,
    pub velocity: Block<Vector3<f64>>,
    pub gyro_bias: Block<Vector3<f64>>,
    pub accel_bias: Block<Vector3<f64>>,
}

impl StateBlocks {
    pub fn add(problem: &mut Problem, state: &FrameState) -> Self {
        let pose = problem.add_block(state.nav.world_from_rig);
        Self::beside(problem, pose, state.nav.velocity_m_s, &state.bias)
    }

    /// Beside a pose that is searched already.
    pub fn beside(
        problem: &mut Problem,
        pose: Block<Se3>,
        velocity_m_s: Vector3<f64>,
        bias: &ImuBias,
    ) -> Self {
        Self {
            pose,
            velocity: problem.add_block(velocity_m_s),
            gyro_bias: problem.add_block(bias.gyro_rad_s),
            accel_bias: problem.add_block(bias.accel_m_s2),
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

    /// Says how large the biases may be.
    pub fn hold_biases(
        &self,
        problem: &mut Problem,
        gyro_sigma_rad_s: f64,
        accel_sigma_m_s2: f64,
    ) -> Result<(), Error> {
        for (block, sigma) in [
            (self.gyro_bias, gyro_sigma_rad_s),
            (self.accel_bias, accel_sigma_m_s2),
        ] {
            let prior = VectorPrior::new(Vector3::zeros(), Vector3::repeat(sigma));
            problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
        }
        Ok(())
    }
}

/// A block with what is known of it beforehand.
pub(crate) fn about<const N: usize>(
    problem: &mut Problem,
    known: SVector<f64, N>,
    sigmas: SVector<f64, N>,
) -> Result<Block<SVector<f64, N>>, Error> {
    let block = problem.add_block(known);
    let prior = VectorPrior::new(known, sigmas);
    problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
    Ok(block)
}

/// Noise so many times as large.
pub(crate) fn inflated(noise: &ImuNoiseModel, factor: f64) -> ImuNoiseModel {
    ImuNoiseModel {
        gyro_noise_density: noise.gyro_noise_density * factor,
        accel_noise_density: noise.accel_noise_density * factor,
        gyro_bias_walk: noise.gyro_bias_walk * factor,
        accel_bias_walk: noise.accel_bias_walk * factor,
    }
}

/// Says how far the biases may wander between two states, `room` times as far as the noise says.
pub(crate) fn add_bias_walks(
    problem: &mut Problem,
    [from, to]: [&StateBlocks; 2],
    duration_secs: f64,
    noise: &ImuNoiseModel,
    room: f64,
) -> Result<(), Error> {
    for (from, to, walk_per_sqrt_s) in [
        (from.gyro_bias, to.gyro_bias, noise.gyro_bias_walk),
        (from.accel_bias, to.accel_bias, noise.accel_bias_walk),
    ] {
        let wander = BiasWalk {
            walk_per_sqrt_s: room * walk_per_sqrt_s,
            duration_secs,
        };
        problem.add_residual(wander, &[from.id(), to.id()], Kernel::Squared)?;
    }
    Ok(())
}

/// Adds what the samples say of two states. `errors` are the blocks of what else the IMU is off by, where the residual has
/// [them](ImuPreintegration::with_errors).
pub(crate) fn add_samples(
    problem: &mut Problem,
    [from, to]: [&StateBlocks; 2],
    gravity: Block<Vector3<f64>>,
    samples: ImuPreintegration,
    errors: &[BlockId],
) -> Result<(), Error> {
    let mut blocks = vec![
        from.pose.id(),
        from.velocity.id(),
        from.gyro_bias.id(),
        from.accel_bias.id(),
        to.pose.id(),
        to.velocity.id(),
        gravity.id(),
    ];
    blocks.extend(errors);
    problem.add_residual(samples, &blocks, Kernel::Squared)?;
    Ok(())
}
