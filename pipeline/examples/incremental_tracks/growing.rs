//! The problem that grows: poses, velocities, biases and points, as the peer builds it.

use std::collections::BTreeMap;
use std::error::Error;
use std::sync::Arc;

use lsfb_geometry::{ImuNoiseModel, Matrix6, Se3, UnitQuaternion, Vector2, Vector3, Vector6};
use lsfb_perception::imu::{ImuBias, NavState, PreintegratedImu};
use lsfb_pipeline::residuals::{BiasWalk, ImuPreintegration, ObservingCamera, Reprojection};
use lsfb_solver::{Block, Incremental, IncrementalConfig, Kernel, PosePrior, Problem, VectorPrior};

use crate::tracks::{FOCAL_PX, Keyframe, Sight, Tracks};

const GRAVITY_M_S2: f64 = 9.81;

const NOISE: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 3.4e-4,
    accel_noise_density: 4e-3,
    // From keyframe to keyframe, whatever the time between them: as the peer has it.
    gyro_bias_walk: 2e-4,
    accel_bias_walk: 3e-3,
};

const SIGHT_KERNEL: Kernel = Kernel::Huber { scale: 1.345 };

/// Distances at which a point is begun.
const NEAREST_M: f64 = 0.2;
const FARTHEST_M: f64 = 15.0;

/// Blocks of a keyframe.
#[derive(Clone, Copy)]
struct State {
    pose: Block<Se3>,
    velocity: Block<Vector3<f64>>,
    gyro_bias: Block<Vector3<f64>>,
    accel_bias: Block<Vector3<f64>>,
}

pub struct Growing<'a> {
    pub problem: Incremental,
    tracks: &'a Tracks,
    cameras: [Arc<ObservingCamera>; 2],
    states: Vec<State>,
    points: BTreeMap<i32, Block<Vector3<f64>>>,
    gravity: Block<Vector3<f64>>,
}

impl<'a> Growing<'a> {
    pub fn new(tracks: &'a Tracks, config: IncrementalConfig) -> Result<Self, Box<dyn Error>> {
        let mut problem = Problem::new();
        let gravity = problem.add_block(Vector3::new(0.0, 0.0, -GRAVITY_M_S2));
        problem.set_constant(gravity);
        Ok(Self {
            problem: Incremental::new(problem, config)?,
            cameras: [0, 1].map(|k| ObservingCamera::new(&tracks.cameras[k])),
            tracks,
            states: Vec::new(),
            points: BTreeMap::new(),
            gravity,
        })
    }

    /// The present estimate of a keyframe's pose.
    pub fn pose(&self, keyframe: usize) -> Se3 {
        self.problem.value(self.states[keyframe].pose)
    }

    /// A keyframe's pose in a copy of the problem.
    pub fn pose_in(&self, problem: &Problem, keyframe: usize) -> Se3 {
        problem.value(self.states[keyframe].pose)
    }

    /// Adds a keyframe with all that it saw and felt.
    pub fn add(&mut self, k: usize) -> Result<(), Box<dyn Error>> {
        let keyframe = &self.tracks.keyframes[k];
        match k.checked_sub(1) {
            None => self.begin(keyframe)?,
            Some(before) => self.follow(&self.tracks.keyframes[before], keyframe)?,
        }
        self.add_sights(k, keyframe)
    }

    fn add_state(&mut self, nav: &NavState, bias: &ImuBias) -> State {
        let state = State {
            pose: self.problem.add_block(nav.world_from_rig),
            velocity: self.problem.add_block(nav.velocity_m_s),
            gyro_bias: self.problem.add_block(bias.gyro_rad_s),
            accel_bias: self.problem.add_block(bias.accel_m_s2),
        };
        self.states.push(state);
        state
    }

    /// At rest, upright by the first samples.
    fn begin(&mut self, keyframe: &Keyframe) -> Result<(), Box<dyn Error>> {
        let imu = &self.tracks.imu;
        let until = imu.partition_point(|s| s.time <= keyframe.time).max(10);
        let up = imu[..until.min(imu.len())]
            .iter()
            .map(|s| Vector3::from(s.sample.specific_force_m_s2))
            .sum::<Vector3<f64>>();
        let upright = UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_default();
        let nav = NavState {
            world_from_rig: Se3::new(upright, Vector3::zeros()),
            velocity_m_s: Vector3::zeros(),
        };
        let state = self.add_state(&nav, &ImuBias::default());
        let sigmas = Vector6::new(0.05, 0.05, 0.001, 1e-3, 1e-3, 1e-3);
        let prior = PosePrior {
            value: nav.world_from_rig,
            sqrt_information: Matrix6::from_diagonal(&sigmas.map(|s| 1.0 / s)),
        };
        let problem = &mut self.problem;
        problem.add_residual(prior, &[state.pose.id()], Kernel::Squared)?;
        for (block, sigma) in [
            (state.velocity, 0.05),
            (state.gyro_bias, 0.1),
            (state.accel_bias, 0.2),
        ] {
            let prior = VectorPrior::new(Vector3::zeros(), Vector3::repeat(sigma));
            problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
        }
        Ok(())
    }

    /// From the last keyframe by the IMU.
    fn follow(&mut self, before: &Keyframe, keyframe: &Keyframe) -> Result<(), Box<dyn Error>> {
        let last = *self.states.last().ok_or("no keyframe to follow")?;
        let problem = &self.problem;
        let bias = ImuBias {
            gyro_rad_s: problem.value(last.gyro_bias),
            accel_m_s2: problem.value(last.accel_bias),
        };
        let nav = NavState {
            world_from_rig: problem.value(last.pose),
            velocity_m_s: problem.value(last.velocity),
        };
        let samples = &self.tracks.imu;
        let imu = PreintegratedImu::integrate(samples, before.time, keyframe.time, bias, &NOISE)?;
        let gravity_m_s2 = Vector3::new(0.0, 0.0, -GRAVITY_M_S2);
        let state = self.add_state(&imu.predict(&nav, &bias, &gravity_m_s2), &bias);
        let blocks = [
            last.pose.id(),
            last.velocity.id(),
            last.gyro_bias.id(),
            last.accel_bias.id(),
            state.pose.id(),
            state.velocity.id(),
            self.gravity.id(),
        ];
        let residual = ImuPreintegration::new(imu).ok_or("the IMU has no noise")?;
        let problem = &mut self.problem;
        problem.add_residual(residual, &blocks, Kernel::Squared)?;
        for (from, to, walk_per_sqrt_s) in [
            (last.gyro_bias, state.gyro_bias, NOISE.gyro_bias_walk),
            (last.accel_bias, state.accel_bias, NOISE.accel_bias_walk),
        ] {
            let wander = BiasWalk {
                walk_per_sqrt_s,
                duration_secs: 1.0,
            };
            problem.add_residual(wander, &[from.id(), to.id()], Kernel::Squared)?;
        }
        Ok(())
    }

    fn add_sights(&mut self, k: usize, keyframe: &Keyframe) -> Result<(), Box<dyn Error>> {
        let pose = self.states[k].pose;
        let world_from_rig = self.problem.value(pose);
        let of = |camera| {
            let sights = keyframe.sights.iter().filter(move |s| s.camera == camera);
            sights
                .map(|s| (s.point, s))
                .collect::<BTreeMap<i32, &Sight>>()
        };
        let (left, right) = (of(0), of(1));
        for (number, seen) in left {
            let also = right.get(&number);
            let point = match (self.points.get(&number), also) {
                (Some(point), _) => *point,
                (None, Some(also)) => {
                    let Some(point_in_rig) = self.triangulate(&seen.pixel, &also.pixel) else {
                        continue;
                    };
                    let value = world_from_rig * point_in_rig;
                    let point = self.problem.add_eliminated_point(value);
                    let prior = VectorPrior::new(value, Vector3::repeat(3.0));
                    self.problem
                        .add_residual(prior, &[point.id()], Kernel::Squared)?;
                    self.points.insert(number, point);
                    point
                }
                (None, None) => continue,
            };
            for sight in [Some(seen), also.copied()].into_iter().flatten() {
                let residual = Reprojection {
                    camera: self.cameras[sight.camera].clone(),
                    pixel: sight.pixel,
                    sigma_px: 1.0,
                };
                self.problem
                    .add_residual(residual, &[pose.id(), point.id()], SIGHT_KERNEL)?;
            }
        }
        Ok(())
    }

    /// Point in the rig whose rays from both cameras come closest; `None` where it is too near or too far.
    fn triangulate(&self, left: &Vector2<f64>, right: &Vector2<f64>) -> Option<Vector3<f64>> {
        let [in_left, in_right] = [0, 1].map(|k| self.tracks.cameras[k].rig_from_camera);
        let a = (left / FOCAL_PX).push(1.0);
        let left_from_right = in_left.inverse() * in_right;
        let b = left_from_right.rotation * (right / FOCAL_PX).push(1.0);
        let between = left_from_right.translation;
        let (aa, ab, bb) = (a.dot(&a), a.dot(&b), b.dot(&b));
        let depth_m = (bb * a.dot(&between) - ab * b.dot(&between)) / (aa * bb - ab * ab);
        (NEAREST_M < depth_m && depth_m < FARTHEST_M).then(|| in_left * (a * depth_m))
    }
}
