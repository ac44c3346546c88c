//! The batch: every corner, every sample, one spline.

use lsfb_geometry::{Vector2, Vector3, spline};
use lsfb_solver::{Block, Kernel, Problem, solve, solve_until_converged};

use super::bend::bent;
use super::blocks::Blocks;
use super::corner_residual::CornerResidual;
use super::effort::{BoardSize, Effort};
use super::inertial::{Accelerometer, BiasWalk, GravityNorm, Gyro};
use super::state::{RigEstimate, View};
use super::timed_view::TimedView;
use super::view_residual::ViewResidual;
use super::{CameraImuConfig, ORDER, Readout};
use crate::Error;
use crate::projection::lens_camera;

/// Corners a view needs.
const MIN_CORNERS: usize = 8;
/// How much is known of what was measured at the end of a range, as a share of that: next to nothing, but enough to keep the
/// motion between two views from being anything.
const SATURATED_SIGMA: f64 = 0.5;
/// Standard deviation of an accelerometer's scale, as data sheets have it.
const ACCELEROMETER_SCALE_SIGMA: f64 = 0.03;

impl RigEstimate {
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
                let moved = self.moved_px(view, effort.moved);
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
        let settings = effort.settings();
        match effort.all_views {
            true => solve_until_converged(&mut problem, &settings)?,
            false => solve(&mut problem, &settings)?,
        };
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
        self.accel_delay_s = problem.value(blocks.accel_delay).x;
        self.bend = problem.value(blocks.bend);
        Ok(())
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
        let timed_view = |time_in_segment_s| TimedView {
            model: camera.model(),
            size: [camera.camera.width, camera.camera.height],
            time_in_segment_s,
            after_middle_s: view.stamp_s - self.middle_s,
            spacing_s: self.motion.knots.spacing_s,
            centre: self.centre,
            inverse_sigma: 1.0 / camera.sigma_px,
        };
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
                view: timed_view(time_in_segment_s),
                corners: seen,
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
                view: timed_view(time_in_segment_s),
                point,
                pixel,
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

    /// A corner of the board as it is bent.
    pub fn bent(&self, point: &Vector3<f64>) -> Vector3<f64> {
        bent(point, &self.centre, &self.bend)
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
            // Where the motion was when it measured.
            let Some(segment) = self.segment(sample.time_s - self.accel_delay_s) else {
                continue;
            };
            let motion = blocks.motion(segment.first);
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
}
