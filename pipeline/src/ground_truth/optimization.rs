//! The batch problem of eq. (5) over all frames.

use std::collections::{BTreeMap, BTreeSet};

use lsfb_geometry::{Matrix3, Matrix6, Vector3};
use lsfb_solver::{Block, Kernel, PosePrior, Problem, Report, VectorPrior};
use lsfb_types::ProgressFn;

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::inertial::{InertialBlocks, add_inertial_residuals};
use super::walk::{FixedObservation, Frame, FrameState, LocalPoint, Walk};
use crate::Error;
use crate::inertial_blocks::StateBlocks;
use crate::residuals::{CameraCorrection, FixedPointReprojection, MovingReprojection};
use crate::solve::solve_until_converged;
use lsfb_perception::imu::{ImuErrors, standard_gravity_m_s2};

/// What was found, and local points after a solve.
pub(super) struct Optimized {
    pub estimate: Estimate,
    pub points: Vec<LocalPoint>,
    /// In the world, m/s².
    pub gravity_m_s2: Vector3<f64>,
    /// Of the IMU.
    pub imu_errors: ImuErrors,
    pub report: Report,
}

/// What holds a walk that sees no map: its first frame.
pub(super) struct Anchor {
    /// Whether all of its state is known, as one that was settled before; else its position and heading alone are given, as the world's
    /// own.
    pub is_known: bool,
    /// Frames from the first on in which the device is at rest.
    pub resting: usize,
}

/// Standard deviations of what is given or known of a first frame.
const GIVEN_M: f64 = 1e-4;
const GIVEN_RAD: f64 = 1e-4;
const KNOWN_M_S: f64 = 0.02;
const KNOWN_GYRO_BIAS_RAD_S: f64 = 2e-3;
const KNOWN_ACCEL_BIAS_M_S2: f64 = 0.03;
/// Of the velocity of a device at rest, m/s.
const RESTING_M_S: f64 = 5e-3;

impl Anchor {
    fn hold(
        &self,
        problem: &mut Problem,
        states: &[FrameState],
        blocks: &[StateBlocks],
    ) -> Result<(), Error> {
        let (Some(state), Some(first)) = (states.first(), blocks.first()) else {
            return Ok(());
        };
        let rotation = state.nav.world_from_rig.rotation;
        let up = rotation.inverse() * Vector3::z();
        // Gravity tells the lean.
        let turn = match self.is_known {
            true => Matrix3::identity(),
            false => up * up.transpose(),
        };
        let mut sqrt_information = Matrix6::zeros();
        sqrt_information
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(turn / GIVEN_RAD));
        sqrt_information
            .fixed_view_mut::<3, 3>(3, 3)
            .fill_diagonal(1.0 / GIVEN_M);
        let prior = PosePrior {
            value: state.nav.world_from_rig,
            sqrt_information,
        };
        problem.add_residual(prior, &[first.pose.id()], Kernel::Squared)?;
        let mut known = Vec::new();
        if self.is_known {
            known.extend([
                (first.velocity, state.nav.velocity_m_s, KNOWN_M_S),
                (
                    first.gyro_bias,
                    state.bias.gyro_rad_s,
                    KNOWN_GYRO_BIAS_RAD_S,
                ),
                (
                    first.accel_bias,
                    state.bias.accel_m_s2,
                    KNOWN_ACCEL_BIAS_M_S2,
                ),
            ]);
        }
        let resting = blocks.iter().take(self.resting);
        known.extend(resting.map(|b| (b.velocity, Vector3::zeros(), RESTING_M_S)));
        for (block, value, sigma) in known {
            let prior = VectorPrior::new(value, Vector3::repeat(sigma));
            problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
        }
        Ok(())
    }
}

/// The problem of eq. (5) at an estimate.
pub(super) struct Adjustment {
    pub problem: Problem,
    pub blocks: WalkBlocks,
}

impl Adjustment {
    /// Over all states, local points and what is not exactly known of the cameras: fixed points of the HD map, local points,
    /// preintegrated IMU; where no map is seen, the anchor's first state. Rows are seen from where the rig was by the motion of
    /// `before`.
    pub fn of(
        walk: &Walk,
        before: &Estimate,
        points: &[LocalPoint],
        anchor: Option<&Anchor>,
        config: &GroundTruthConfig,
    ) -> Result<Self, Error> {
        let mut problem = Problem::new();
        let part = Part {
            walk,
            before,
            points,
            anchor,
            config,
            shared: &SharedPoints::default(),
        };
        Ok(Self {
            blocks: part.add(&mut problem)?,
            problem,
        })
    }
}

/// What one walk adds to a problem.
pub(super) struct Part<'a> {
    pub walk: &'a Walk,
    pub before: &'a Estimate,
    pub points: &'a [LocalPoint],
    pub anchor: Option<&'a Anchor>,
    pub config: &'a GroundTruthConfig,
    /// Blocks of what other walks see too.
    pub shared: &'a SharedPoints,
}

/// Blocks of points that several walks see.
#[derive(Clone, Default)]
pub(super) struct SharedPoints {
    /// Whether each frame sees the map's as others do.
    pub frames: Vec<bool>,
    /// Of the map's, by their number there: they are free, and what the map says of them is known beforehand.
    pub of_map: BTreeMap<u32, Block<Vector3<f64>>>,
    /// Of local ones, by their index among the walk's.
    pub local: BTreeMap<usize, Block<Vector3<f64>>>,
}

/// Blocks of a walk in a problem.
pub(super) struct WalkBlocks {
    /// One for each camera.
    pub corrections: Vec<Block<CameraCorrection>>,
    /// One for each frame.
    pub states: Vec<StateBlocks>,
    /// Beside the points; `None` for one that nothing determines.
    pub points: Vec<Option<Block<Vector3<f64>>>>,
    /// `None` without frames.
    pub inertial: Option<InertialBlocks>,
}

impl Part<'_> {
    /// As [`Adjustment::of`] has it.
    pub fn add(&self, problem: &mut Problem) -> Result<WalkBlocks, Error> {
        let Self {
            walk,
            before,
            points,
            anchor,
            config,
            shared,
        } = self;
        let kernel = Kernel::Cauchy {
            scale: config.kernel_scale,
        };
        let corrections = before
            .corrections
            .iter()
            .zip(&walk.cameras)
            .map(|(correction, camera)| {
                let block = problem.add_block(*correction);
                let known = config.calibration_sigmas(camera);
                let prior = VectorPrior::new(CameraCorrection::zeros(), known);
                problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
                Ok(block)
            })
            .collect::<Result<Vec<_>, Error>>()?;
        let states: Vec<StateBlocks> = before
            .states
            .iter()
            .map(|state| StateBlocks::add(problem, state))
            .collect();
        for (k, (frame, state)) in walk.frames.iter().zip(&states).enumerate() {
            for seen in &frame.fixed {
                let (pose, correction) = (state.pose.id(), corrections[seen.camera].id());
                let is_shared = shared.frames.get(k) == Some(&true);
                if let Some(point) = shared.of_map.get(&seen.point).filter(|_| is_shared) {
                    let residual = MovingReprojection {
                        camera: walk.cameras[seen.camera].clone(),
                        motion: before.motions[k],
                        pixel: seen.pixel,
                        sigma_px: config.local_sigma_px,
                    };
                    problem.add_residual(residual, &[pose, correction, point.id()], kernel)?;
                    continue;
                }
                let residual = FixedPointReprojection {
                    camera: walk.cameras[seen.camera].clone(),
                    motion: before.motions[k],
                    point_in_world: seen.point_in_world,
                    pixel: seen.pixel,
                    sigma_px: config.map_sigma_px,
                };
                problem.add_residual(residual, &[pose, correction], kernel)?;
            }
        }
        let mut point_blocks = Vec::with_capacity(points.len());
        for (index, point) in points.iter().enumerate() {
            if !point.is_determined() {
                point_blocks.push(None);
                continue;
            }
            let block = match shared.local.get(&index) {
                Some(block) => *block,
                None => problem.add_eliminated_point(point.point_in_world),
            };
            point_blocks.push(Some(block));
            for seen in point.observations.iter().filter(|seen| seen.used) {
                let residual = MovingReprojection {
                    camera: walk.cameras[seen.camera].clone(),
                    motion: before.motions[seen.frame],
                    pixel: seen.pixel,
                    sigma_px: config.local_sigma_px,
                };
                let blocks = [
                    states[seen.frame].pose.id(),
                    corrections[seen.camera].id(),
                    block.id(),
                ];
                problem.add_residual(residual, &blocks, kernel)?;
            }
        }
        let inertial = add_inertial_residuals(problem, walk, 0, &states, config)?;
        if let Some(anchor) = anchor {
            anchor.hold(problem, &before.states, &states)?;
        }
        Ok(WalkBlocks {
            corrections,
            states,
            points: point_blocks,
            inertial,
        })
    }
}

impl WalkBlocks {
    /// What was found of the walk, and of its points.
    pub fn read(
        &self,
        problem: &Problem,
        walk: &Walk,
        points: &[LocalPoint],
        report: Report,
    ) -> Optimized {
        let estimate = Estimate::new(
            walk,
            self.states.iter().map(|b| b.read(problem)).collect(),
            self.corrections.iter().map(|c| problem.value(*c)).collect(),
        );
        let beside = points.iter().zip(&self.points);
        let moved = beside.map(|(point, block)| LocalPoint {
            point_in_world: block.map_or(point.point_in_world, |b| problem.value(b)),
            observations: point.observations.clone(),
        });
        let inertial = self.inertial;
        Optimized {
            estimate,
            points: moved.collect(),
            gravity_m_s2: inertial.map_or_else(standard_gravity_m_s2, |i| problem.value(i.gravity)),
            imu_errors: inertial.map(|i| i.errors(problem)).unwrap_or_default(),
            report,
        }
    }
}

/// Minimises eq. (5), as [`Adjustment::of`] has it.
pub(super) fn optimize(
    walk: &Walk,
    before: &Estimate,
    points: &[LocalPoint],
    anchor: Option<&Anchor>,
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Optimized, Error> {
    let Adjustment {
        mut problem,
        blocks,
    } = Adjustment::of(walk, before, points, anchor, config)?;
    let report = solve_until_converged("bundle adjustment", &mut problem, &config.solve, progress)?;
    Ok(blocks.read(&problem, walk, points, report))
}

/// Uses of what was recognised and followed that which now lies within the gate of where it should be, whether it was used
/// before or not; in each image each keypoint and each point of the map once, at the smaller error. Returns how many
/// observations came or went.
pub(super) fn choose_observations(
    walk: &mut Walk,
    estimate: &Estimate,
    points: &mut [LocalPoint],
    config: &GroundTruthConfig,
) -> usize {
    let mut changed = 0;
    for (k, frame) in walk.frames.iter_mut().enumerate() {
        let within = within_gate(estimate, k, frame, config);
        let came = within.iter().filter(|seen| !frame.fixed.contains(seen));
        changed += came.count();
        let went = frame.fixed.iter().filter(|seen| !within.contains(seen));
        changed += went.count();
        frame.fixed = within;
    }
    for point in points.iter_mut() {
        for k in 0..point.observations.len() {
            let error_px = estimate.local_error_px(point, &point.observations[k]);
            let used = error_px <= config.max_error_px;
            changed += usize::from(used != point.observations[k].used);
            point.observations[k].used = used;
        }
    }
    changed
}

/// Of what a frame recognised, that which lies where it should be.
pub(super) fn within_gate(
    estimate: &Estimate,
    k: usize,
    frame: &Frame,
    config: &GroundTruthConfig,
) -> Vec<FixedObservation> {
    let mut near: Vec<(f64, FixedObservation)> = frame
        .recognised
        .iter()
        .map(|seen| (estimate.fixed_error_px(k, seen), *seen))
        .filter(|(error_px, _)| *error_px <= config.max_error_px)
        .collect();
    near.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let mut chosen: Vec<FixedObservation> = Vec::with_capacity(near.len());
    let (mut keypoints, mut points) = (BTreeSet::new(), BTreeSet::new());
    for (_, seen) in near {
        let free = !keypoints.contains(&(seen.camera, seen.keypoint))
            && !points.contains(&(seen.camera, seen.point));
        if free {
            keypoints.insert((seen.camera, seen.keypoint));
            points.insert((seen.camera, seen.point));
            chosen.push(seen);
        }
    }
    chosen.sort_by_key(|seen| (seen.camera, seen.keypoint));
    chosen
}
