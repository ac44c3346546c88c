//! How an IMU moves between two times, by its samples, and how errors of its state grow.

use lsfb_geometry::{ImuNoiseModel, Matrix3, Se3, StampedPose, UnitQuaternion, Vector3, so3};
use lsfb_perception::imu::{ImuBias, NO_WEIGHT, NavState, PreintegratedImu, Reading};
use lsfb_types::{ImuSample, Stamped, Timestamp};
use nalgebra::{SMatrix, SVector};

/// Numbers of an error: rotation, position, velocity, both biases, markers on the IMU (rotation, position), clock, gravity.
pub(super) const SIZE: usize = 25;
pub(super) const ROTATION: usize = 0;
pub(super) const PLACE: usize = 3;
pub(super) const VELOCITY: usize = 6;
pub(super) const GYRO_BIAS: usize = 9;
pub(super) const ACCEL_BIAS: usize = 12;
pub(super) const MOUNT_ROTATION: usize = 15;
pub(super) const MOUNT_PLACE: usize = 18;
pub(super) const CLOCK: usize = 21;
pub(super) const GRAVITY: usize = 22;
/// Numbers that change from time to time; those behind them stay, but for the clock.
const MOVING: usize = 15;

pub(super) type Error25 = SVector<f64, SIZE>;
pub(super) type Matrix25 = SMatrix<f64, SIZE, SIZE>;
type Matrix15 = SMatrix<f64, MOVING, MOVING>;

/// An IMU in the world of the motion capture, and what is not known of both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ImuState {
    /// World from IMU.
    pub rotation: UnitQuaternion<f64>,
    pub place: Vector3<f64>,
    /// In the world, m/s.
    pub velocity: Vector3<f64>,
    /// rad/s.
    pub gyro_bias: Vector3<f64>,
    /// m/s².
    pub accel_bias: Vector3<f64>,
    /// IMU from the body of the markers.
    pub mount: Se3,
    /// By how much the IMU's clock is ahead of where it was looked at, seconds.
    pub clock_secs: f64,
    /// In the world, m/s²; it points down.
    pub gravity: Vector3<f64>,
}

impl ImuState {
    /// Moved by an error; rotations on the right, positions in the world.
    pub fn retract(&self, by: &Error25) -> Self {
        let part = |at: usize| by.fixed_rows::<3>(at).into_owned();
        Self {
            rotation: so3::retract(&self.rotation, &part(ROTATION)),
            place: self.place + part(PLACE),
            velocity: self.velocity + part(VELOCITY),
            gyro_bias: self.gyro_bias + part(GYRO_BIAS),
            accel_bias: self.accel_bias + part(ACCEL_BIAS),
            mount: Se3::new(
                so3::retract(&self.mount.rotation, &part(MOUNT_ROTATION)),
                self.mount.translation + part(MOUNT_PLACE),
            ),
            clock_secs: self.clock_secs + by[CLOCK],
            gravity: self.gravity + part(GRAVITY),
        }
    }

    /// `self.retract(&self.local(other)) == other`.
    pub fn local(&self, other: &Self) -> Error25 {
        let mut by = Error25::zeros();
        let mut put = |at: usize, value: Vector3<f64>| by.fixed_rows_mut::<3>(at).copy_from(&value);
        put(ROTATION, so3::local(&self.rotation, &other.rotation));
        put(PLACE, other.place - self.place);
        put(VELOCITY, other.velocity - self.velocity);
        put(GYRO_BIAS, other.gyro_bias - self.gyro_bias);
        put(ACCEL_BIAS, other.accel_bias - self.accel_bias);
        let turn = so3::local(&self.mount.rotation, &other.mount.rotation);
        put(MOUNT_ROTATION, turn);
        put(
            MOUNT_PLACE,
            other.mount.translation - self.mount.translation,
        );
        put(GRAVITY, other.gravity - self.gravity);
        by[CLOCK] = other.clock_secs - self.clock_secs;
        by
    }

    pub fn pose(&self) -> Se3 {
        Se3::new(self.rotation, self.place)
    }

    /// Where the markers' body should be seen.
    pub fn markers(&self) -> Se3 {
        self.pose() * self.mount
    }

    fn bias(&self) -> ImuBias {
        ImuBias {
            gyro_rad_s: self.gyro_bias,
            accel_m_s2: self.accel_bias,
        }
    }

    /// At the end of what samples say.
    fn after(&self, change: &PreintegratedImu) -> Self {
        let start = NavState {
            world_from_rig: self.pose(),
            velocity_m_s: self.velocity,
        };
        let end = change.predict(&start, &self.bias(), &self.gravity);
        Self {
            rotation: end.world_from_rig.rotation,
            place: end.world_from_rig.translation,
            velocity: end.velocity_m_s,
            ..*self
        }
    }
}

/// A state that was taken along, how an error of it became one of the new state, and what was added to its covariance.
pub(super) struct Moved {
    pub state: ImuState,
    pub transition: Matrix25,
    pub added: Matrix25,
}

/// Inertial samples on a line of time.
#[derive(Clone, Debug)]
pub(super) struct Inertial {
    base: Timestamp,
    secs: Vec<f64>,
    turn_rad_s: Vec<Vector3<f64>>,
    force_m_s2: Vec<Vector3<f64>>,
}

impl Inertial {
    /// Of samples in order of time; of equal stamps the first counts.
    pub fn new(samples: &[Stamped<ImuSample>], base: Timestamp) -> Self {
        let mut kept: Vec<&Stamped<ImuSample>> = samples.iter().collect();
        kept.dedup_by_key(|s| s.time);
        Self {
            base,
            secs: kept.iter().map(|s| s.time.secs_since(base)).collect(),
            turn_rad_s: kept
                .iter()
                .map(|s| s.sample.angular_velocity_rad_s.into())
                .collect(),
            force_m_s2: kept
                .iter()
                .map(|s| s.sample.specific_force_m_s2.into())
                .collect(),
        }
    }

    /// First and last sample, seconds since the base.
    pub fn span_secs(&self) -> Option<[f64; 2]> {
        Some([*self.secs.first()?, *self.secs.last()?])
    }

    /// Mean size of the specific force.
    pub fn mean_force_m_s2(&self) -> f64 {
        let sum: f64 = self.force_m_s2.iter().map(Vector3::norm).sum();
        sum / self.force_m_s2.len().max(1) as f64
    }

    /// Times of the samples within, and the longest step between neighbours among them, seconds.
    pub fn longest_step_secs(&self, from: f64, to: f64) -> f64 {
        let first = self.secs.partition_point(|s| *s < from).saturating_sub(1);
        let last = self.secs.partition_point(|s| *s <= to);
        let within = self
            .secs
            .get(first..=last.min(self.secs.len().saturating_sub(1)));
        let steps = within.unwrap_or_default().windows(2).map(|w| w[1] - w[0]);
        steps.fold(0.0, f64::max)
    }

    /// Angular velocity and specific force at a time: on the lines between the samples.
    pub fn at(&self, secs: f64) -> (Vector3<f64>, Vector3<f64>) {
        let next = self
            .secs
            .partition_point(|s| *s < secs)
            .clamp(1, self.secs.len() - 1);
        let (a, b) = (self.secs[next - 1], self.secs[next]);
        let share = ((secs - a) / (b - a)).clamp(0.0, 1.0);
        let between = |v: &[Vector3<f64>]| v[next - 1].lerp(&v[next], share);
        (between(&self.turn_rad_s), between(&self.force_m_s2))
    }

    /// Takes a state along; `clock_walk` is the clock's random walk, s/√s.
    pub fn moved(
        &self,
        start: &ImuState,
        from_secs: f64,
        to_secs: f64,
        noise: &ImuNoiseModel,
        clock_walk: f64,
    ) -> Moved {
        let mut state = *start;
        let mut moving = Matrix15::identity();
        let mut by_gravity = SMatrix::<f64, MOVING, 3>::zeros();
        let mut added = Matrix15::zeros();
        for step in self.steps(from_secs, to_secs) {
            let change = self.change(step, state.bias(), noise);
            let secs = change.duration_secs;
            let step = transition(&change, &state.rotation);
            moving = step * moving;
            by_gravity = step * by_gravity;
            for k in 0..3 {
                by_gravity[(VELOCITY + k, k)] += secs;
                by_gravity[(PLACE + k, k)] += 0.5 * secs * secs;
            }
            added = step * added * step.transpose() + step_noise(&change, &state.rotation, noise);
            state = state.after(&change);
        }
        let mut whole = Matrix25::identity();
        whole
            .fixed_view_mut::<MOVING, MOVING>(0, 0)
            .copy_from(&moving);
        whole
            .fixed_view_mut::<MOVING, 3>(0, GRAVITY)
            .copy_from(&by_gravity);
        let mut all = Matrix25::zeros();
        all.fixed_view_mut::<MOVING, MOVING>(0, 0).copy_from(&added);
        all[(CLOCK, CLOCK)] = clock_walk * clock_walk * (to_secs - from_secs);
        Moved {
            state,
            transition: whole,
            added: all,
        }
    }

    /// What the samples say from one time to another.
    fn change(&self, [a, b]: [f64; 2], bias: ImuBias, noise: &ImuNoiseModel) -> PreintegratedImu {
        let [from, to] = [a, b].map(|secs| {
            let (angular_velocity, specific_force) = self.at(secs);
            Reading {
                time: self.base.plus_secs(secs),
                angular_velocity,
                specific_force,
            }
        });
        PreintegratedImu::between(&from, &to, bias, noise)
    }

    /// The intervals between two times that samples cut; stamps have nanoseconds.
    fn steps(&self, from_secs: f64, to_secs: f64) -> impl Iterator<Item = [f64; 2]> + '_ {
        let first = self.secs.partition_point(|s| *s <= from_secs);
        let last = self.secs.partition_point(|s| *s < to_secs).max(first);
        let inner = self.secs[first..last].iter().copied();
        let ends = inner.clone().chain([to_secs]);
        let starts = std::iter::once(from_secs).chain(inner);
        starts
            .zip(ends)
            .map(|(a, b)| [a, b])
            .filter(|[a, b]| b - a > 2e-9)
    }

    /// Poses at the samples between two states, the later one not included; the state's own time first.
    pub fn poses_from(&self, start: &ImuState, from_secs: f64, to_secs: f64) -> Vec<StampedPose> {
        let mut state = *start;
        let mut poses = Vec::new();
        for [a, b] in self.steps(from_secs, to_secs) {
            poses.push(StampedPose {
                time: self.base.plus_secs(a),
                world_from_rig: state.pose(),
            });
            state = state.after(&self.change([a, b], state.bias(), &NO_WEIGHT));
        }
        poses
    }
}

/// Of one step, linear in the error.
fn transition(change: &PreintegratedImu, start: &UnitQuaternion<f64>) -> Matrix15 {
    let rotation = start.to_rotation_matrix().into_inner();
    let back = change.rotation.inverse().to_rotation_matrix().into_inner();
    let by = &change.by_bias;
    let mut step = Matrix15::identity();
    for (row, column, block) in [
        (ROTATION, ROTATION, back),
        (ROTATION, GYRO_BIAS, by.rotation_by_gyro),
        (
            VELOCITY,
            ROTATION,
            -rotation * so3::hat(&change.velocity_m_s),
        ),
        (VELOCITY, GYRO_BIAS, rotation * by.velocity_by_gyro),
        (VELOCITY, ACCEL_BIAS, rotation * by.velocity_by_accel),
        (PLACE, ROTATION, -rotation * so3::hat(&change.position_m)),
        (PLACE, VELOCITY, Matrix3::identity() * change.duration_secs),
        (PLACE, GYRO_BIAS, rotation * by.position_by_gyro),
        (PLACE, ACCEL_BIAS, rotation * by.position_by_accel),
    ] {
        step.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
    }
    step
}

/// What white noise and random walks add in one step.
fn step_noise(
    change: &PreintegratedImu,
    start: &UnitQuaternion<f64>,
    noise: &ImuNoiseModel,
) -> Matrix15 {
    let rotation = start.to_rotation_matrix().into_inner();
    // The change is ordered rotation, velocity, position, the last two in the frame of its start.
    let mut by_change = SMatrix::<f64, MOVING, 9>::zeros();
    for (row, column, block) in [
        (ROTATION, 0, Matrix3::identity()),
        (VELOCITY, 3, rotation),
        (PLACE, 6, rotation),
    ] {
        by_change
            .fixed_view_mut::<3, 3>(row, column)
            .copy_from(&block);
    }
    let mut added = by_change * change.covariance * by_change.transpose();
    for k in 0..3 {
        let walked = |density: f64| density * density * change.duration_secs;
        added[(GYRO_BIAS + k, GYRO_BIAS + k)] += walked(noise.gyro_bias_walk);
        added[(ACCEL_BIAS + k, ACCEL_BIAS + k)] += walked(noise.accel_bias_walk);
    }
    added
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand_eye::continuous::tests::motion;

    fn inertial() -> Inertial {
        let samples: Vec<Stamped<ImuSample>> = (0..400)
            .map(|i| super::super::tests::sample(&motion, f64::from(i) / 200.0, 0.0))
            .collect();
        Inertial::new(&samples, Timestamp::from_nanos(0))
    }

    fn state() -> ImuState {
        let h = 1e-5;
        ImuState {
            rotation: motion(0.5).rotation,
            place: motion(0.5).translation,
            velocity: (motion(0.5 + h).translation - motion(0.5 - h).translation) / (2.0 * h),
            gyro_bias: Vector3::zeros(),
            accel_bias: Vector3::zeros(),
            mount: Se3::identity(),
            clock_secs: 0.0,
            gravity: Vector3::new(0.0, 0.0, -9.81),
        }
    }

    #[test]
    fn samples_lead_along_the_motion() {
        let noise = super::super::MocapConfig::default().noise;
        let found = inertial().moved(&state(), 0.5, 0.8, &noise, 0.0).state;
        let off = found.pose().local(&motion(0.8));
        assert!(off.norm() < 2e-4, "{off}");
    }

    #[test]
    fn the_transition_is_the_derivative() {
        let noise = super::super::MocapConfig::default().noise;
        let inertial = inertial();
        let end = |state: &ImuState| inertial.moved(state, 0.5, 0.57, &noise, 0.0);
        let whole = end(&state());
        for k in 0..SIZE {
            let h = 1e-6;
            let mut by = Error25::zeros();
            by[k] = h;
            let moved = end(&state().retract(&by)).state;
            let column = whole.state.local(&moved) / h;
            let off = (column - whole.transition.column(k)).norm();
            assert!(off < 2e-3, "{k}: {off}");
        }
    }
}
