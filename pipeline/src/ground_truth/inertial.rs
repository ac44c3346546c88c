//! What the IMU says of neighbours.

use lsfb_geometry::Vector3;
use lsfb_solver::{Block, Problem};

use super::GroundTruthConfig;
use super::imu_wander::room_to_wander;
use super::walk::{FrameState, Walk};
use nalgebra::{Vector1, Vector6};

use crate::Error;
use crate::inertial_blocks::{StateBlocks, about, add_bias_walks, add_samples};
use crate::residuals::ImuPreintegration;
use lsfb_perception::imu::{ImuErrors, Matrix9, PreintegratedImu, standard_gravity_m_s2};

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
    let intervals = walk.preintegrate(frames, |k| now[k - first_frame].bias);
    let has_map = walk.frames.iter().any(|frame| !frame.fixed.is_empty());
    let shared = InertialBlocks::add(problem, config, has_map)?;
    first.hold_biases(
        problem,
        config.gyro_bias_sigma_rad_s,
        config.accel_bias_sigma_m_s2,
    )?;
    let errors = [
        shared.gyro_axes.id(),
        shared.accel_axes.id(),
        shared.accel_turn_rad.id(),
        shared.accel_delay_s.id(),
        shared.world_scale.id(),
    ];
    for (k, (pair, interval)) in states.windows(2).zip(intervals).enumerate() {
        let ends = [&pair[0], &pair[1]];
        let frame = first_frame + k;
        let duration_secs = walk.frames[frame + 1]
            .time
            .secs_since(walk.frames[frame].time);
        let room = room_to_wander(walk, frame, &config.inertial);
        add_bias_walks(problem, ends, duration_secs, &walk.noise, room)?;
        let interval = interval.unwrap_or_else(|| any_motion(&now[k], duration_secs));
        if let Some(residual) = ImuPreintegration::new(interval) {
            let samples = residual.with_errors();
            add_samples(problem, ends, shared.gravity, samples, &errors)?;
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
