//! Where everything is, as far as it is known: states, cameras and how the rig moves while images are read out.

use std::sync::Arc;

use lsfb_geometry::{Se3, Vector2, Vector3, so3};
use lsfb_types::{ImuSample, Stamped, Timestamp};

use super::walk::{FixedObservation, FrameState, LocalObservation, LocalPoint, Walk};
use crate::residuals::{CameraCorrection, FrameMotion, MovingCamera};
use lsfb_perception::imu::standard_gravity_m_s2;

/// What was found of a walk, and what follows from it.
#[derive(Clone)]
pub(super) struct Estimate {
    /// One for each frame.
    pub states: Vec<FrameState>,
    /// One for each camera.
    pub corrections: Vec<CameraCorrection>,
    /// The cameras as the corrections make them.
    pub cameras: Vec<Arc<MovingCamera>>,
    /// One for each frame.
    pub motions: Vec<FrameMotion>,
}

impl Estimate {
    pub fn new(walk: &Walk, states: Vec<FrameState>, corrections: Vec<CameraCorrection>) -> Self {
        let corrected = walk.cameras.iter().zip(&corrections);
        let motions = (0..states.len()).map(|k| match walk.has_imu() {
            true => motion(&walk.imu, walk.frames[k].time, &states[k]),
            false => motion_between_frames(walk, &states, k),
        });
        Self {
            cameras: corrected.map(|(camera, c)| camera.corrected(c)).collect(),
            motions: motions.collect(),
            states,
            corrections,
        }
    }

    /// With the cameras as the rig file has them.
    pub fn of_states(walk: &Walk, states: Vec<FrameState>) -> Self {
        let corrections = vec![CameraCorrection::zeros(); walk.cameras.len()];
        Self::new(walk, states, corrections)
    }

    /// The same with each frame moved in the world, as `there_from_here` has it.
    pub fn moved(mut self, there_from_here: impl Fn(usize) -> Se3) -> Self {
        for (frame, (state, motion)) in self.states.iter_mut().zip(&mut self.motions).enumerate() {
            let moved = there_from_here(frame);
            let nav = &mut state.nav;
            nav.world_from_rig = moved * nav.world_from_rig;
            nav.velocity_m_s = moved.rotation * nav.velocity_m_s;
            motion.velocity_m_s = moved.rotation * motion.velocity_m_s;
            motion.acceleration_m_s2 = moved.rotation * motion.acceleration_m_s2;
        }
        self
    }

    /// Pose of the rig at the stamp of a frame.
    pub fn pose(&self, frame: usize) -> &Se3 {
        &self.states[frame].nav.world_from_rig
    }

    /// Pose of a camera when it exposed a row.
    pub fn world_from_camera(&self, frame: usize, camera: usize, row_px: f64) -> Se3 {
        self.cameras[camera].world_from_camera(self.pose(frame), &self.motions[frame], row_px)
    }

    /// Pixel at which a frame sees a point; `None` behind the lens.
    pub fn project(
        &self,
        frame: usize,
        camera: usize,
        point_in_world: &Vector3<f64>,
    ) -> Option<Vector2<f64>> {
        self.cameras[camera].project(self.pose(frame), &self.motions[frame], point_in_world)
    }

    /// Reprojection error of a map point, pixels; infinite behind the lens.
    pub fn fixed_error_px(&self, frame: usize, seen: &FixedObservation) -> f64 {
        self.error_px(frame, seen.camera, &seen.pixel, &seen.point_in_world)
    }

    /// Reprojection error of a local point, pixels; infinite behind the lens.
    pub fn local_error_px(&self, point: &LocalPoint, seen: &LocalObservation) -> f64 {
        self.error_px(seen.frame, seen.camera, &seen.pixel, &point.point_in_world)
    }

    /// Where a local point should be seen less where it was, pixels; `None` behind the lens.
    pub fn local_residual_px(
        &self,
        point: &LocalPoint,
        seen: &LocalObservation,
    ) -> Option<Vector2<f64>> {
        let (pose, motion) = (self.pose(seen.frame), &self.motions[seen.frame]);
        let camera = &self.cameras[seen.camera];
        let found = camera.project_in_row(pose, motion, seen.pixel.y, &point.point_in_world)?;
        Some(found - seen.pixel)
    }

    fn error_px(
        &self,
        frame: usize,
        camera: usize,
        pixel: &Vector2<f64>,
        point_in_world: &Vector3<f64>,
    ) -> f64 {
        let motion = &self.motions[frame];
        self.cameras[camera]
            .project_in_row(self.pose(frame), motion, pixel.y, point_in_world)
            .map_or(f64::INFINITY, |found| (found - pixel).norm())
    }
}

/// Inertial samples this near to a stamp say how the rig moves there, seconds: a readout and a little more.
const REACH_NS: i64 = 20_000_000;

/// Motion around a stamp: the line through the gyroscope's samples, the mean of the accelerometer's. Without samples the rig goes
/// straight on.
fn motion(imu: &[Stamped<ImuSample>], stamp: Timestamp, state: &FrameState) -> FrameMotion {
    let first = imu.partition_point(|s| s.time < stamp.plus_nanos(-REACH_NS));
    let end = imu.partition_point(|s| s.time <= stamp.plus_nanos(REACH_NS));
    let near = &imu[first..end.max(first)];
    let mut motion = FrameMotion {
        velocity_m_s: state.nav.velocity_m_s,
        ..FrameMotion::default()
    };
    if near.is_empty() {
        return motion;
    }
    let count = near.len() as f64;
    let (mut rate, mut force) = (Vector3::zeros(), Vector3::zeros());
    let mut middle_secs = 0.0;
    for s in near {
        rate += Vector3::from(s.sample.angular_velocity_rad_s) / count;
        force += Vector3::from(s.sample.specific_force_m_s2) / count;
        middle_secs += s.time.secs_since(stamp) / count;
    }
    let (mut slope, mut spread) = (Vector3::zeros(), 0.0);
    for s in near {
        let secs = s.time.secs_since(stamp) - middle_secs;
        slope += (Vector3::from(s.sample.angular_velocity_rad_s) - rate) * secs;
        spread += secs * secs;
    }
    if spread > 0.0 {
        motion.turn_acceleration_rad_s2 = slope / spread;
    }
    motion.turn_rate_rad_s =
        rate - state.bias.gyro_rad_s - motion.turn_acceleration_rad_s2 * middle_secs;
    motion.acceleration_m_s2 = state.nav.world_from_rig.rotation * (force - state.bias.accel_m_s2)
        + standard_gravity_m_s2();
    motion
}

/// Frames that are farther apart do not say how the rig moved at one of them, seconds.
const NEIGHBOURS_SECS: f64 = 0.5;

/// Motion at a frame of a walk without an IMU: the parabola through it and its neighbours; with one of them the line.
fn motion_between_frames(walk: &Walk, states: &[FrameState], frame: usize) -> FrameMotion {
    let step = |from: usize, to: usize| {
        let secs = walk.frames[to].time.secs_since(walk.frames[from].time);
        let (from, to) = (&states[from].nav, &states[to].nav);
        let turned = from.world_from_rig.rotation.inverse() * to.world_from_rig.rotation;
        let gained = to.velocity_m_s - from.velocity_m_s;
        (0.0 < secs && secs <= NEIGHBOURS_SECS).then(|| (secs, so3::log(&turned) / secs, gained))
    };
    let before = frame.checked_sub(1).and_then(|k| step(k, frame));
    let after = (frame + 1 < states.len())
        .then(|| step(frame, frame + 1))
        .flatten();
    let mut motion = FrameMotion {
        velocity_m_s: states[frame].nav.velocity_m_s,
        ..FrameMotion::default()
    };
    match (before, after) {
        (Some((a_secs, a, a_gained)), Some((b_secs, b, b_gained))) => {
            let secs = a_secs + b_secs;
            motion.turn_rate_rad_s = (a * b_secs + b * a_secs) / secs;
            motion.turn_acceleration_rad_s2 = (b - a) * (2.0 / secs);
            motion.acceleration_m_s2 = (a_gained + b_gained) / secs;
        }
        (Some((secs, turn_rate, gained)), None) | (None, Some((secs, turn_rate, gained))) => {
            motion.turn_rate_rad_s = turn_rate;
            motion.acceleration_m_s2 = gained / secs;
        }
        (None, None) => {}
    }
    motion
}
