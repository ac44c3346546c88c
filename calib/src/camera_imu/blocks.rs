//! The unknowns of the batch, and what is known of them beforehand.

use lsfb_geometry::camera::MAX_PARAMETERS;
use lsfb_geometry::{Se3, UnitQuaternion, Vector3};
use lsfb_solver::{Block, BlockId, Kernel, Problem, ResidualId, VectorPrior};
use nalgebra::{SVector, Vector1};

use super::bend::{Bend, SIZE};
use super::effort::{BoardSize, Effort};
use super::inertial::{AxisErrors, TURNED};
use super::state::RigEstimate;
use super::{AccelDelay, Axes, BoardShape, CameraImuConfig, Clock, Lenses, ORDER, Readout};
use crate::Error;

/// Standard deviation of how far the middle of an edge is bent out of the board's plane, metres.
const BEND_SIGMA_M: f64 = 2e-3;
/// Standard deviation of what printers stretch and shear.
const STRETCH_SIGMA: f64 = 1e-3;
/// Standard deviation of a board's size of which nothing is known, as a share.
pub(super) const SIZE_SIGMA: f64 = 0.1;
/// Standard deviation of how much later than the gyroscope the accelerometer measures, seconds: their filters delay them by up to
/// several milliseconds, and seldom both alike.
const ACCEL_DELAY_SIGMA_S: f64 = 5e-3;

/// The blocks of the problem.
pub(super) struct Blocks {
    pub rotations: Vec<Block<UnitQuaternion<f64>>>,
    pub positions: Vec<Block<Vector3<f64>>>,
    pub poses: Vec<Block<Se3>>,
    pub clocks: Vec<Block<Clock>>,
    pub lenses: Vec<Block<SVector<f64, MAX_PARAMETERS>>>,
    pub readouts: Vec<Block<Vector1<f64>>>,
    pub gyro_bias: Vec<Block<Vector3<f64>>>,
    pub accel_bias: Vec<Block<Vector3<f64>>>,
    pub gyro_axes: Block<AxisErrors>,
    pub accel_axes: Block<AxisErrors>,
    pub accel_delay: Block<Vector1<f64>>,
    pub gravity: Block<Vector3<f64>>,
    pub bend: Block<Bend>,
    /// What was measured, with its time, seconds after the origin.
    pub timed: Vec<(f64, ResidualId)>,
}

impl Blocks {
    pub fn motion(&self, first: usize) -> Vec<BlockId> {
        let range = first..first + ORDER;
        let rotations = self.rotations[range.clone()].iter().map(|b| b.id());
        rotations
            .chain(self.positions[range].iter().map(|b| b.id()))
            .collect()
    }

    /// What the size of the board depends on beside gravity: poses, clocks, lenses and the accelerometer's delay.
    pub fn of_cameras(&self, config: &CameraImuConfig) -> Vec<BlockId> {
        let poses = self.poses.iter().map(|b| b.id());
        let clocks = self.clocks.iter().map(|b| b.id());
        let lenses = self.lenses.iter().map(|b| b.id());
        let lenses = lenses.filter(|_| config.lenses == Lenses::Refined);
        let delay = self.delay(config);
        poses.chain(clocks).chain(lenses).chain(delay).collect()
    }

    /// The accelerometer's delay where it is searched.
    pub fn delay(&self, config: &CameraImuConfig) -> Option<BlockId> {
        (config.accel_delay == AccelDelay::Estimated).then_some(self.accel_delay.id())
    }
}

impl RigEstimate {
    /// The unknowns at their present values, and what is known of them beforehand.
    pub fn add_blocks(
        &self,
        problem: &mut Problem,
        config: &CameraImuConfig,
        effort: Effort,
    ) -> Result<Blocks, Error> {
        let size = effort.size;
        let mut vectors = |values: &[Vector3<f64>]| -> Vec<Block<Vector3<f64>>> {
            values.iter().map(|v| problem.add_block(*v)).collect()
        };
        let positions = vectors(&self.motion.positions);
        let gyro_bias = vectors(&self.gyro_bias);
        let accel_bias = vectors(&self.accel_bias);
        let mut blocks = Blocks {
            rotations: self
                .motion
                .rotations
                .iter()
                .map(|r| problem.add_block(*r))
                .collect(),
            positions,
            poses: Vec::new(),
            clocks: Vec::new(),
            lenses: Vec::new(),
            readouts: Vec::new(),
            gyro_bias,
            accel_bias,
            gyro_axes: problem.add_block(self.gyro_axes),
            accel_axes: problem.add_block(self.accel_axes),
            accel_delay: problem.add_block(Vector1::new(self.accel_delay_s)),
            gravity: problem.add_block(self.gravity),
            bend: problem.add_block(self.bend),
            timed: Vec::new(),
        };
        problem.set_name(blocks.bend.id(), "bend of the board");
        problem.set_name(blocks.accel_delay.id(), "delay of the accelerometer");
        match config.accel_delay {
            AccelDelay::Estimated => {
                let prior = VectorPrior::new(Vector1::zeros(), Vector1::new(ACCEL_DELAY_SIGMA_S));
                problem.add_residual(prior, &[blocks.accel_delay.id()], Kernel::Squared)?;
            }
            AccelDelay::Absent => problem.set_constant(blocks.accel_delay),
        }
        match config.board {
            BoardShape::Flat if size == BoardSize::AsSaid => {
                problem.set_constant(blocks.bend);
            }
            BoardShape::Flat => {
                // A rig that does not move says nothing of it.
                let prior = VectorPrior::new(Bend::zeros(), Bend::repeat(SIZE_SIGMA));
                problem.add_residual(prior, &[blocks.bend.id()], Kernel::Squared)?;
                problem.set_constant_components(blocks.bend, &[0, 1, 2, 3, 4])?;
            }
            BoardShape::Bent => {
                let sigma = BEND_SIGMA_M / (self.half_board_m * self.half_board_m);
                let prior = VectorPrior::new(
                    Bend::zeros(),
                    Bend::new(
                        sigma,
                        sigma,
                        sigma,
                        STRETCH_SIGMA,
                        STRETCH_SIGMA,
                        SIZE_SIGMA,
                    ),
                );
                problem.add_residual(prior, &[blocks.bend.id()], Kernel::Squared)?;
                if size == BoardSize::AsSaid {
                    problem.set_constant_components(blocks.bend, &[SIZE])?;
                }
            }
        }
        problem.set_name(blocks.gyro_axes.id(), "axes of the gyroscope");
        problem.set_name(blocks.accel_axes.id(), "axes of the accelerometer");
        match config.axes {
            Axes::Ideal => {
                problem.set_constant(blocks.gyro_axes);
                problem.set_constant(blocks.accel_axes);
            }
            Axes::NearlyIdeal => {
                let sigma = AxisErrors::repeat(config.axes_sigma);
                for triad in [blocks.gyro_axes, blocks.accel_axes] {
                    let prior = VectorPrior::new(AxisErrors::zeros(), sigma);
                    problem.add_residual(prior, &[triad.id()], Kernel::Squared)?;
                }
            }
            // The accelerometer says what the rig's axes are.
            Axes::Estimated => problem.set_constant_components(blocks.accel_axes, &TURNED)?,
        }
        for camera in &self.cameras {
            let pose = problem.add_block(camera.camera_from_rig);
            let clock = problem.add_block(camera.clock);
            let readout = problem.add_block(Vector1::new(camera.readout_s));
            let parameters = camera.camera.lens.parameters();
            let values: SVector<f64, MAX_PARAMETERS> = parameters.values.into();
            let lens = problem.add_block(values);
            problem.set_name(pose.id(), format!("{} in the rig", camera.name));
            problem.set_name(clock.id(), format!("{} clock", camera.name));
            problem.set_component_names(clock.id(), &["offset", "drift"]);
            problem.set_name(readout.id(), format!("{} readout", camera.name));
            problem.set_name(lens.id(), format!("{} lens", camera.name));
            problem.set_component_names(lens.id(), camera.model().parameter_names());
            match config.lenses {
                Lenses::Known => problem.set_constant(lens),
                Lenses::Refined => {
                    let absent: Vec<usize> = (parameters.count..MAX_PARAMETERS).collect();
                    problem.set_constant_components(lens, &absent)?;
                }
            }
            if config.readout == Readout::Known {
                problem.set_constant(readout);
            }
            blocks.poses.push(pose);
            blocks.clocks.push(clock);
            blocks.readouts.push(readout);
            blocks.lenses.push(lens);
        }
        Ok(blocks)
    }
}
