//! The batch: every corner, every sample, one spline.

use lsfb_geometry::camera::MAX_PARAMETERS;
use lsfb_geometry::{Se3, UnitQuaternion, Vector2, Vector3, spline};
use lsfb_solver::{
    Block, BlockId, Diagnosis, Kernel, Problem, ResidualId, SolveConfig, VectorPrior, solve,
};
use nalgebra::{DVector, SVector, Vector1};

use super::bend::{BEND, Bend, SIZE, bends};
use super::corner_residual::CornerResidual;
use super::inertial::{AccelAxes, Accelerometer, BiasWalk, GravityNorm, Gyro, GyroAxes};
use super::parts::{Known, known};
use super::state::{State, View};
use super::view_residual::ViewResidual;
use super::{Axes, BoardShape, CameraImuConfig, Clock, Lenses, ORDER, Readout};
use crate::Error;
use crate::board::Target;
use crate::clusters::{Clusters, share_of_board};
use crate::projection::lens_camera;

/// Corners that miss by more than this many times the median are outliers.
const OUTLIER_RATIO: f64 = 5.0;
/// Median error above which a camera does not fit, pixels.
const MAX_MEDIAN_PX: f64 = 3.0;
/// Corners a view needs.
const MIN_CORNERS: usize = 8;
/// Standard deviation of how far the middle of an edge is bent out of the board's plane, metres.
const BEND_SIGMA_M: f64 = 2e-3;
/// Standard deviation of what printers stretch and shear.
const STRETCH_SIGMA: f64 = 1e-3;
/// How much is known of what was measured at the end of a range, as a share of that: next to nothing, but enough to keep the
/// motion between two views from being anything.
const SATURATED_SIGMA: f64 = 0.5;
/// Standard deviation of a board's size of which nothing is known, as a share.
const SIZE_SIGMA: f64 = 0.1;
/// Standard deviation of an accelerometer's scale, as data sheets have it.
const ACCELEROMETER_SCALE_SIGMA: f64 = 0.03;
/// Standard deviation of how much later than the gyroscope the accelerometer measures, seconds: their filters delay them by up to
/// several milliseconds, and seldom both alike.
const ACCEL_DELAY_SIGMA_S: f64 = 5e-3;
/// Stretch of time in which errors are not independent, seconds.
const CLUSTER_S: f64 = 0.5;
/// Least standard deviation of a corner that is believed, pixels.
const LEAST_SIGMA_PX: f64 = 0.01;
/// Median length of a two-dimensional normal error of standard deviation 1.
const MEDIAN_LENGTH: f64 = 1.1774;

pub(super) type LensBlock = Block<SVector<f64, MAX_PARAMETERS>>;

/// The blocks of the problem.
pub(super) struct Blocks {
    rotations: Vec<Block<UnitQuaternion<f64>>>,
    positions: Vec<Block<Vector3<f64>>>,
    pub poses: Vec<Block<Se3>>,
    pub clocks: Vec<Block<Clock>>,
    pub lenses: Vec<LensBlock>,
    pub readouts: Vec<Block<Vector1<f64>>>,
    pub gyro_bias: Vec<Block<Vector3<f64>>>,
    pub accel_bias: Vec<Block<Vector3<f64>>>,
    pub gyro_axes: Block<GyroAxes>,
    pub accel_axes: Block<AccelAxes>,
    pub accel_delay: Block<Vector1<f64>>,
    pub gravity: Block<Vector3<f64>>,
    pub bend: Block<Bend>,
    /// What was measured, with its time, seconds after the origin.
    pub timed: Vec<(f64, ResidualId)>,
}

impl Blocks {
    fn motion(&self, first: usize) -> Vec<BlockId> {
        let range = first..first + ORDER;
        let rotations = self.rotations[range.clone()].iter().map(|b| b.id());
        rotations
            .chain(self.positions[range].iter().map(|b| b.id()))
            .collect()
    }

    /// What the size of the board depends on beside gravity: poses, clocks, lenses and the accelerometer's delay.
    fn of_cameras(&self, config: &CameraImuConfig) -> Vec<BlockId> {
        let poses = self.poses.iter().map(|b| b.id());
        let clocks = self.clocks.iter().map(|b| b.id());
        let lenses = self.lenses.iter().map(|b| b.id());
        let lenses = lenses.filter(|_| config.lenses == Lenses::Refined);
        let delay = std::iter::once(self.accel_delay.id());
        poses.chain(clocks).chain(lenses).chain(delay).collect()
    }
}

/// By how much all of a board is larger than said, as a share.
#[derive(Clone, Copy)]
pub(super) struct BoardExcess {
    pub share: f64,
    pub sigma: f64,
    /// Share of the corners' squares that it takes off.
    pub explains: f64,
}

/// What is believed of the board's size.
#[derive(Clone, Copy, PartialEq, Eq)]
enum BoardSize {
    AsSaid,
    /// It is searched, and so is the scale of the accelerometer, which gravity tells.
    Searched,
}

/// How far to go.
#[derive(Clone, Copy)]
pub(super) struct Effort {
    cost_tolerance: f64,
    /// Whether views that are held back take part.
    all_views: bool,
    size: BoardSize,
    /// Whether pixels are moved by what the models of lens and board are likely not to know.
    field: bool,
    /// Whether the accelerometer may measure later than the gyroscope.
    is_delay_searched: bool,
}

impl Effort {
    pub fn of_round(round: usize, last: bool) -> Self {
        Self {
            cost_tolerance: match (round, last) {
                (_, true) => 1e-12,
                (0, false) => 1e-4,
                (_, false) => 1e-7,
            },
            all_views: last,
            size: BoardSize::AsSaid,
            field: false,
            is_delay_searched: false,
        }
    }

    fn settings(self) -> SolveConfig {
        SolveConfig {
            max_iterations: 40,
            cost_tolerance: self.cost_tolerance,
            diagnosis: Diagnosis::Off,
            ..SolveConfig::default()
        }
    }

    /// What it takes to measure the board.
    pub fn of_size() -> Self {
        Self {
            cost_tolerance: 1e-9,
            all_views: true,
            size: BoardSize::Searched,
            field: false,
            is_delay_searched: true,
        }
    }

    /// What it takes to say how well all is known.
    pub fn of_uncertainty() -> Self {
        Self {
            field: true,
            ..Self::of_delay()
        }
    }

    /// What it takes to say what the accelerometer's delay would move.
    pub fn of_delay() -> Self {
        Self {
            is_delay_searched: true,
            ..Self::of_round(0, true)
        }
    }
}

impl State {
    /// The problem at the present values.
    pub fn problem(
        &self,
        config: &CameraImuConfig,
        effort: Effort,
    ) -> Result<(Problem, Blocks), Error> {
        let mut problem = Problem::new();
        let mut blocks = self.add_blocks(&mut problem, config, effort)?;
        for view in &self.views {
            if effort.all_views || !view.holdout {
                let moved = self.moved_px(view, effort.field);
                self.add_view(&mut problem, &mut blocks, view, config, &moved)?;
            }
        }
        self.add_samples(&mut problem, &mut blocks)?;
        let norm = GravityNorm {
            expected_m_s2: config.gravity_m_s2,
            inverse_sigma: match effort.size {
                BoardSize::AsSaid => 1.0 / config.gravity_sigma_m_s2,
                BoardSize::Searched => 1.0 / (ACCELEROMETER_SCALE_SIGMA * config.gravity_m_s2),
            },
        };
        problem.add_residual(norm, &[blocks.gravity.id()], Kernel::Squared)?;
        Ok((problem, blocks))
    }

    /// Minimises over everything.
    pub fn adjust(&mut self, config: &CameraImuConfig, effort: Effort) -> Result<(), Error> {
        let (mut problem, blocks) = self.problem(config, effort)?;
        solve(&mut problem, &effort.settings())?;
        let vector = |b: &Block<Vector3<f64>>| problem.value(*b);
        self.motion.rotations = blocks.rotations.iter().map(|b| problem.value(*b)).collect();
        self.motion.positions = blocks.positions.iter().map(vector).collect();
        for (k, camera) in self.cameras.iter_mut().enumerate() {
            camera.camera_from_rig = problem.value(blocks.poses[k]);
            camera.clock = problem.value(blocks.clocks[k]);
            camera.readout_s = problem.value(blocks.readouts[k]).x;
            let size = [camera.camera.width, camera.camera.height];
            camera.camera = lens_camera(camera.model(), size, &problem.value(blocks.lenses[k]));
        }
        self.gyro_bias = blocks.gyro_bias.iter().map(vector).collect();
        self.accel_bias = blocks.accel_bias.iter().map(vector).collect();
        self.gyro_axes = problem.value(blocks.gyro_axes);
        self.accel_axes = problem.value(blocks.accel_axes);
        self.gravity = vector(&blocks.gravity);
        self.bend = problem.value(blocks.bend);
        Ok(())
    }

    /// By how much all of the board is larger than said, as the accelerometer has it against gravity: a wrong scale of the
    /// accelerometer is none of the board.
    pub fn board_excess(&self, config: &CameraImuConfig) -> Result<BoardExcess, Error> {
        let effort = Effort::of_size();
        let (mut problem, blocks) = self.problem(config, effort)?;
        let report = solve(&mut problem, &effort.settings())?;
        let size = 1.0 + problem.value(blocks.bend)[SIZE];
        let gravity = problem.value(blocks.gravity);
        let share = config.gravity_m_s2 / gravity.norm();
        let mut asked = vec![blocks.bend.id(), blocks.gravity.id()];
        asked.extend(blocks.of_cameras(config));
        let found = known(&problem, &asked, None, &blocks.timed);
        let Ok(Known {
            covariance,
            scatter,
            bias,
            ..
        }) = found
        else {
            // So little motion that only the prior is left.
            return Ok(BoardExcess {
                share: 0.0,
                sigma: SIZE_SIGMA,
                explains: 0.0,
            });
        };
        let mut by = DVector::zeros(bias.len());
        by[SIZE] = share;
        by.fixed_rows_mut::<3>(BEND)
            .copy_from(&(-gravity * (size * share / gravity.norm_squared())));
        let variance = by.dot(&(covariance.joint() * &by));
        Ok(BoardExcess {
            share: size * share - 1.0,
            sigma: (variance.max(0.0).sqrt() * scatter.factor_along(&by)).hypot(by.dot(&bias)),
            explains: (report.initial_cost - report.final_cost) / self.cost_of_corners().max(1e-12),
        })
    }

    fn add_blocks(
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
            accel_delay: problem.add_block(Vector1::zeros()),
            gravity: problem.add_block(self.gravity),
            bend: problem.add_block(self.bend),
            timed: Vec::new(),
        };
        problem.set_name(blocks.bend.id(), "bend of the board");
        problem.set_name(blocks.accel_delay.id(), "delay of the accelerometer");
        if effort.is_delay_searched {
            let prior = VectorPrior::new(Vector1::zeros(), Vector1::new(ACCEL_DELAY_SIGMA_S));
            problem.add_residual(prior, &[blocks.accel_delay.id()], Kernel::Squared)?;
        } else {
            problem.set_constant(blocks.accel_delay);
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
        if config.axes == Axes::Ideal {
            problem.set_constant(blocks.gyro_axes);
            problem.set_constant(blocks.accel_axes);
        }
        for camera in &self.cameras {
            let pose = problem.add_block(camera.camera_from_rig);
            let clock = problem.add_block(camera.clock);
            let readout = problem.add_block(Vector1::new(camera.readout_s));
            let parameters = camera.camera.lens.parameters();
            let values: SVector<f64, MAX_PARAMETERS> = parameters.values.into();
            let lens = problem.add_block(values);
            problem.set_name(pose.id(), format!("{} on the rig", camera.name));
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

    pub fn segment(&self, time_s: f64) -> Option<spline::Segment<ORDER>> {
        let motion = &self.motion;
        motion
            .knots
            .segment::<ORDER>(time_s, motion.rotations.len())
    }

    fn segment_start_s(&self, segment: &spline::Segment<ORDER>) -> f64 {
        self.motion.knots.start_s + segment.first as f64 * self.motion.knots.spacing_s
    }

    fn add_view(
        &self,
        problem: &mut Problem,
        blocks: &mut Blocks,
        view: &View,
        config: &CameraImuConfig,
        moved: &[Vector2<f64>],
    ) -> Result<(), Error> {
        let k = view.camera;
        let camera = &self.cameras[k];
        let knots = self.motion.knots;
        let size = [camera.camera.width, camera.camera.height];
        let inverse_sigma = 1.0 / camera.sigma_px;
        let rest = [
            blocks.poses[k].id(),
            blocks.clocks[k].id(),
            blocks.lenses[k].id(),
            blocks.bend.id(),
            blocks.readouts[k].id(),
        ];
        // The control points that move a time, and the view's stamp in their segment.
        let place = |row_s: f64| {
            let segment = self.segment(self.time_s(view) + row_s)?;
            let start_s = self.segment_start_s(&segment);
            Some((blocks.motion(segment.first), view.stamp_s - start_s))
        };
        let seen: Vec<(Vector3<f64>, Vector2<f64>)> = view
            .corners
            .iter()
            .zip(&view.inliers)
            .zip(moved)
            .filter_map(|(((point, pixel), inlier), moved)| {
                inlier.then_some((*point, pixel - moved))
            })
            .collect();
        if seen.len() < MIN_CORNERS {
            return Ok(());
        }
        if camera.readout_s == 0.0 && config.readout == Readout::Known {
            let Some((mut ids, time_in_segment_s)) = place(0.0) else {
                return Ok(());
            };
            ids.extend(&rest[..4]);
            let residual = ViewResidual {
                model: camera.model(),
                size,
                time_in_segment_s,
                after_middle_s: view.stamp_s - self.middle_s,
                spacing_s: knots.spacing_s,
                centre: self.centre,
                corners: seen,
                inverse_sigma,
            };
            let id = problem.add_residual(residual, &ids, Kernel::Squared)?;
            blocks.timed.push((view.stamp_s, id));
            return Ok(());
        }
        let mut timed = Vec::with_capacity(seen.len());
        for (point, pixel) in seen {
            let Some((mut ids, time_in_segment_s)) = place(camera.row_s(&pixel)) else {
                continue;
            };
            ids.extend(&rest);
            let residual = CornerResidual {
                model: camera.model(),
                size,
                time_in_segment_s,
                after_middle_s: view.stamp_s - self.middle_s,
                spacing_s: knots.spacing_s,
                centre: self.centre,
                point,
                pixel,
                inverse_sigma,
            };
            let id = problem.add_residual(residual, &ids, Kernel::Squared)?;
            timed.push((view.stamp_s, id));
        }
        blocks.timed.extend(timed);
        Ok(())
    }

    /// When a view was taken, by the IMU's clock.
    pub fn time_s(&self, view: &View) -> f64 {
        let clock = &self.cameras[view.camera].clock;
        view.stamp_s + clock.x + clock.y * (view.stamp_s - self.middle_s)
    }

    /// Half the weighted squares of all corners that count.
    fn cost_of_corners(&self) -> f64 {
        let of_view = |view: &View| {
            let errors = self.errors_px(view).into_iter().zip(&view.inliers);
            let squares: f64 = errors
                .filter(|(_, inlier)| **inlier)
                .filter_map(|(error, _)| Some(error?.norm_squared()))
                .sum();
            0.5 * squares / self.cameras[view.camera].sigma_px.powi(2)
        };
        self.views.iter().map(of_view).sum()
    }

    /// A corner of the board as it is bent.
    pub fn bent(&self, point: &Vector3<f64>) -> Vector3<f64> {
        point + bends(&(point - self.centre)) * self.bend
    }

    /// Which of the biases' control points a time lies between, and where.
    pub fn bias_place(&self, time_s: f64) -> (usize, f64) {
        let at = ((time_s - self.motion.knots.start_s) / self.bias_spacing_s).max(0.0);
        let first = (at as usize).min(self.gyro_bias.len().saturating_sub(2));
        (first, at - first as f64)
    }

    fn add_samples(&self, problem: &mut Problem, blocks: &mut Blocks) -> Result<(), Error> {
        let weights = |sigma: f64, measured: &Vector3<f64>, saturated: &[bool; 3]| {
            Vector3::from_fn(|k, _| match saturated[k] {
                true => 1.0 / (SATURATED_SIGMA * measured[k].abs()).max(sigma),
                false => 1.0 / sigma,
            })
        };
        for sample in &self.samples {
            let Some(segment) = self.segment(sample.time_s) else {
                continue;
            };
            let motion = blocks.motion(segment.first);
            let (bias, bias_share) = self.bias_place(sample.time_s);
            let gyro = Gyro {
                weights: segment.weights,
                bias_share,
                measured: sample.gyro,
                inverse_sigma: weights(self.gyro_sigma, &sample.gyro, &sample.gyro_saturated),
            };
            let last = [
                blocks.gyro_bias[bias].id(),
                blocks.gyro_bias[bias + 1].id(),
                blocks.gyro_axes.id(),
            ];
            let ids = [&motion[..ORDER], &last].concat();
            let id = problem.add_residual(gyro, &ids, Kernel::Squared)?;
            blocks.timed.push((sample.time_s, id));
            let accelerometer = Accelerometer {
                time_in_segment_s: sample.time_s - self.segment_start_s(&segment),
                spacing_s: self.motion.knots.spacing_s,
                bias_share,
                measured: sample.accel,
                inverse_sigma: weights(self.accel_sigma, &sample.accel, &sample.accel_saturated),
            };
            let last = [
                blocks.accel_bias[bias].id(),
                blocks.accel_bias[bias + 1].id(),
                blocks.gravity.id(),
                blocks.accel_axes.id(),
                blocks.accel_delay.id(),
            ];
            let ids = [&motion[..], &last].concat();
            let id = problem.add_residual(accelerometer, &ids, Kernel::Squared)?;
            blocks.timed.push((sample.time_s, id));
        }
        let root = self.bias_spacing_s.sqrt();
        for (bias, density) in [
            (&blocks.gyro_bias, self.noise.gyro_bias_walk),
            (&blocks.accel_bias, self.noise.accel_bias_walk),
        ] {
            for w in bias.windows(2) {
                let walk = BiasWalk {
                    inverse_sigma: 1.0 / (density * root),
                };
                problem.add_residual(walk, &[w[0].id(), w[1].id()], Kernel::Squared)?;
            }
        }
        Ok(())
    }

    /// Error of each corner of a view, pixels; `None` where it is not seen.
    pub fn errors_px(&self, view: &View) -> Vec<Option<Vector2<f64>>> {
        let camera = &self.cameras[view.camera];
        let mut pose = None;
        view.corners
            .iter()
            .map(|(point, pixel)| {
                if pose.is_none() || camera.readout_s != 0.0 {
                    let time_s = self.time_s(view) + camera.row_s(pixel);
                    pose = self.motion.pose_at(time_s);
                }
                let in_rig = pose?.inverse() * self.bent(point);
                let seen = camera.camera.project(&(camera.camera_from_rig * in_rig))?;
                Some(seen - pixel)
            })
            .collect()
    }

    /// How much less a camera's corners are worth than as many independent ones.
    fn design_effect(&self, target: &Target, camera: usize) -> f64 {
        let mut clusters = Clusters::default();
        for view in self.views.iter().filter(|v| v.camera == camera) {
            let time = (view.stamp_s / CLUSTER_S).floor() as i64;
            let errors = self.errors_px(view).into_iter().zip(&view.inliers);
            for ((error, inlier), (point, _)) in errors.zip(&view.corners) {
                if let Some(error) = error.filter(|_| *inlier) {
                    clusters.add(time, share_of_board(target, point), &error);
                }
            }
        }
        clusters.design_effect()
    }

    /// Finds outliers and the spread of the others, camera by camera.
    pub fn find_outliers(&mut self, target: &Target) -> Result<(), Error> {
        let length = |e: &Option<Vector2<f64>>| e.map_or(f64::INFINITY, |e| e.norm());
        let errors: Vec<Vec<f64>> = self
            .views
            .iter()
            .map(|v| self.errors_px(v).iter().map(length).collect())
            .collect();
        for k in 0..self.cameras.len() {
            let of_camera = || {
                self.views
                    .iter()
                    .zip(&errors)
                    .filter(|(v, _)| v.camera == k)
            };
            let mut lengths: Vec<f64> = of_camera().flat_map(|(_, e)| e.iter().copied()).collect();
            lengths.sort_by(f64::total_cmp);
            let median = lengths
                .get(lengths.len() / 2)
                .copied()
                .unwrap_or(f64::INFINITY);
            if !(median < MAX_MEDIAN_PX) && self.cameras[k].alone_px < 0.5 * MAX_MEDIAN_PX {
                return Err(Error::NotJoined {
                    first: self.cameras[k].name.clone(),
                    second: "the IMU".to_owned(),
                    problem: format!(
                        "each view for itself is met to {:.1} px, all of them along one motion with the IMU's samples miss by {median:.1} px: an axis of the accelerometer has the wrong sign or is exchanged, the images are mirrored, or the board is of quite another size",
                        self.cameras[k].alone_px
                    ),
                });
            }
            if !(median < MAX_MEDIAN_PX) {
                return Err(Error::DoesNotFit {
                    camera: self.cameras[k].name.clone(),
                    rms_px: median,
                    target: target.describe(),
                    model: self.cameras[k].model().name(),
                });
            }
            let limit = OUTLIER_RATIO * median;
            let inliers = lengths.partition_point(|e| *e <= limit).max(1);
            let squares: f64 = lengths[..inliers].iter().map(|e| e * e).sum();
            let spread = (squares / (2 * inliers) as f64).sqrt();
            // Robust against what is left of outliers, exact where the errors are normal.
            let spread = spread.min(1.2 * median / MEDIAN_LENGTH).max(LEAST_SIGMA_PX);
            for (view, errors) in self.views.iter_mut().zip(&errors) {
                if view.camera == k {
                    view.inliers = errors.iter().map(|e| *e <= limit).collect();
                }
            }
            self.cameras[k].sigma_px = spread * self.design_effect(target, k).sqrt();
        }
        Ok(())
    }
}
