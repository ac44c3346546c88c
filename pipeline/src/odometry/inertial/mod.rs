//! The inertial half: an error-state filter that predicts the pose between scans and learns velocity, biases and
//! gravity from the registered poses.
//!
//! Error state, in this order: rotation and translation of the pose (right perturbation), velocity, gyroscope bias,
//! accelerometer bias, gravity; three components each. Model as in Xu et al., "FAST-LIO2", eq. (1)–(8), with the pose
//! error in the tangent of SE(3). From sample to sample it moves as [`PreintegratedImu`] does.

mod standing;
mod start;

#[cfg(test)]
mod tests;

use lsfb_geometry::{ImuNoiseModel, Matrix3, Matrix6, Se3, StampedPose, Vector3, Vector6, so3};
use lsfb_perception::lidar::PosePrior;
use lsfb_types::{ImuSample, Stamped, Timestamp};
use nalgebra::{SMatrix, SVector};

use super::uncertainty::once_seen;
use lsfb_perception::imu::{ImuBias, NavState, PreintegratedImu};
use lsfb_perception::imu::{Reading, reading_at};
use standing::{STANDING_SPAN_S, Standing};
pub(super) use start::KnownBias;

type Matrix18 = SMatrix<f64, 18, 18>;

const VELOCITY: usize = 6;
const GYRO_BIAS: usize = 9;
const ACCEL_BIAS: usize = 12;
const GRAVITY: usize = 15;

/// Beyond this the motion between two samples is not what they say, seconds: steps shake at a few hertz, and a straight line
/// between samples still follows that.
const MAX_SAMPLE_GAP_S: f64 = 0.08;
/// Longer than this between two samples a straight line between them misses some of the motion, seconds.
const SURE_SAMPLE_GAP_S: f64 = 0.02;
/// What a walker may do unseen: turn rate, rad/s, and acceleration, m/s².
const UNSEEN_RATE_RAD_S: f64 = 0.5;
const UNSEEN_ACCELERATION_M_S2: f64 = 2.0;

/// What the filter estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialState {
    /// Pose of the rig.
    pub world_from_rig: Se3,
    /// Velocity of the rig in the world, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Gyroscope bias, rad/s.
    pub gyro_bias_rad_s: Vector3<f64>,
    /// Accelerometer bias, m/s².
    pub accel_bias_m_s2: Vector3<f64>,
    /// Gravity in the world, m/s²: close to (0, 0, −9.81), and exactly known only as the walk goes on.
    pub gravity_m_s2: Vector3<f64>,
}

impl InertialState {
    fn add(&mut self, delta: &SVector<f64, 18>) {
        let of_pose: Vector6<f64> = delta.fixed_rows::<6>(0).into();
        self.world_from_rig = self.world_from_rig.retract(&of_pose);
        self.velocity_m_s += delta.fixed_rows::<3>(VELOCITY);
        self.gyro_bias_rad_s += delta.fixed_rows::<3>(GYRO_BIAS);
        self.accel_bias_m_s2 += delta.fixed_rows::<3>(ACCEL_BIAS);
        self.gravity_m_s2 += delta.fixed_rows::<3>(GRAVITY);
    }
}

/// The filter.
#[derive(Clone, Debug)]
pub struct InertialFilter {
    state: InertialState,
    /// By which scans and prediction are weighed.
    covariance: Matrix18,
    /// By which the estimate is reported: with scans that share their errors.
    reported: Matrix18,
    /// What it felt at the start, as long as it has stood still since.
    standing: Option<Standing>,
    time: Timestamp,
    noise: ImuNoiseModel,
}

impl InertialFilter {
    /// The estimate at [`InertialFilter::time`].
    pub fn state(&self) -> &InertialState {
        &self.state
    }

    /// Time of the estimate.
    pub fn time(&self) -> Timestamp {
        self.time
    }

    /// Moves the estimate to `end` with the samples around that span; returns the poses on the way, both ends included.
    pub fn predict(&mut self, samples: &[Stamped<ImuSample>], end: Timestamp) -> Vec<StampedPose> {
        let mut knots = vec![self.knot()];
        let Some(mut from) = reading_at(samples, self.time) else {
            return knots;
        };
        while self.time < end {
            let first = samples.partition_point(|s| s.time <= self.time);
            let span_end = self.time.plus_secs(STANDING_SPAN_S);
            let until = match (self.standing, samples.get(first)) {
                (Some(_), Some(next)) if next.time < span_end => end.min(span_end),
                // What nobody felt is crossed at once.
                (Some(_), Some(next)) => end.min(next.time.plus_secs(STANDING_SPAN_S)),
                _ => end,
            };
            let last = samples.partition_point(|s| s.time < until).max(first);
            let inside = &samples[first..last];
            self.rest(inside, until);
            let inside = inside.iter().map(Reading::from);
            for to in inside.chain(reading_at(samples, until)) {
                self.integrate(&from, &to);
                knots.push(self.knot());
                from = to;
            }
        }
        knots
    }

    fn knot(&self) -> StampedPose {
        StampedPose {
            time: self.time,
            world_from_rig: self.state.world_from_rig,
        }
    }

    fn integrate(&mut self, from: &Reading, to: &Reading) {
        let dt = to.time.secs_since(from.time);
        if !(dt > 0.0) {
            return;
        }
        let bias = ImuBias {
            gyro_rad_s: self.state.gyro_bias_rad_s,
            accel_m_s2: self.state.accel_bias_m_s2,
        };
        let change = PreintegratedImu::between(from, to, bias, &self.noise);
        let start = NavState {
            world_from_rig: self.state.world_from_rig,
            velocity_m_s: self.state.velocity_m_s,
        };
        let mut end = change.predict(&start, &bias, &self.state.gravity_m_s2);
        if dt > MAX_SAMPLE_GAP_S {
            // Nobody felt how its velocity changed.
            end.velocity_m_s = start.velocity_m_s;
            end.world_from_rig.translation =
                start.world_from_rig.translation + start.velocity_m_s * dt;
        }
        end.world_from_rig.rotation.renormalize_fast();

        let world_from_start = start.world_from_rig.rotation_matrix();
        let f = transition(&change, &world_from_start);
        let noise = measured(&change, &world_from_start) + self.unseen(dt);
        self.covariance = f * self.covariance * f.transpose() + noise;
        self.reported = f * self.reported * f.transpose() + noise;
        self.state.world_from_rig = end.world_from_rig;
        self.state.velocity_m_s = end.velocity_m_s;
        self.time = to.time;
    }

    /// What samples so far apart do not say, and how biases walk meanwhile.
    fn unseen(&self, dt: f64) -> Matrix18 {
        // What a straight line misses grows with the square of its length.
        let missed = if dt > MAX_SAMPLE_GAP_S {
            1.0
        } else if dt > SURE_SAMPLE_GAP_S {
            (dt / MAX_SAMPLE_GAP_S).powi(2)
        } else {
            0.0
        };
        let velocity_m_s = missed * UNSEEN_ACCELERATION_M_S2 * dt;
        let mut variance = SVector::<f64, 18>::zeros();
        for (at, sigma) in [
            (0, missed * UNSEEN_RATE_RAD_S * dt),
            (3, 0.5 * velocity_m_s * dt),
            (VELOCITY, velocity_m_s),
            (GYRO_BIAS, self.noise.gyro_bias_walk * dt.sqrt()),
            (ACCEL_BIAS, self.noise.accel_bias_walk * dt.sqrt()),
        ] {
            variance.fixed_rows_mut::<3>(at).fill(sigma * sigma);
        }
        Matrix18::from_diagonal(&variance)
    }

    /// How far the pose may be off against the map: covariance of `[rotation, translation]`.
    pub fn reported_covariance(&self) -> Matrix6<f64> {
        self.reported.fixed_view::<6, 6>(0, 0).into()
    }

    /// The gyroscope's bias, and how well it is known to a walk that is begun again at `begun`: twice the variance, as that takes the scans that
    /// told it once more, and by how much it may have walked since.
    pub(in crate::odometry) fn known_bias(&self, begun: Timestamp) -> KnownBias {
        let walked = self.noise.gyro_bias_walk.powi(2) * self.time.secs_since(begun).max(0.0);
        KnownBias {
            rad_s: self.state.gyro_bias_rad_s,
            sigma_rad_s: Vector3::from_fn(|k, _| {
                let at = GYRO_BIAS + k;
                (2.0 * self.reported[(at, at)] + walked).sqrt()
            }),
        }
    }

    /// Takes the estimate for less certain: its covariance by so many times, 1 or more.
    pub fn widen(&mut self, factor: f64) {
        self.covariance *= factor;
        self.reported *= factor;
    }

    /// The predicted pose as a prior for registration.
    pub fn pose_prior(&self) -> PosePrior {
        let covariance: Matrix6<f64> = self.covariance.fixed_view::<6, 6>(0, 0).into();
        PosePrior {
            world_from_rig: self.state.world_from_rig,
            information: covariance
                .cholesky()
                .map_or_else(Matrix6::zeros, |c| c.inverse()),
        }
    }

    /// Takes in the pose found from [`InertialFilter::pose_prior`] and a scan that gave `information` on it, of which `lasting` is what it
    /// adds to those before it, with which it shares its errors.
    pub fn correct(
        &mut self,
        world_from_rig: &Se3,
        information: &Matrix6<f64>,
        lasting: &Matrix6<f64>,
    ) {
        let p = &self.covariance;
        let prior: Matrix6<f64> = p.fixed_view::<6, 6>(0, 0).into();
        let Some(prior_cholesky) = prior.cholesky() else {
            return;
        };
        // The pose is already the best of prior and scan; the rest of the state follows it by its correlation.
        let deviation: Vector6<f64> = self.state.world_from_rig.local(world_from_rig);
        let all_by_pose = p.fixed_view::<18, 6>(0, 0) * prior_cholesky.inverse();
        let delta = all_by_pose * deviation;
        self.state.add(&delta);
        self.state.world_from_rig = *world_from_rig;
        if let Some(seen) = once_seen(p, information) {
            self.covariance = seen;
        }
        if let Some(seen) = once_seen(&self.reported, lasting) {
            self.reported = seen;
        }
    }
}

/// How the error state at the end of a change depends on that at its start.
fn transition(change: &PreintegratedImu, world_from_start: &Matrix3<f64>) -> Matrix18 {
    let end_from_start = change.rotation.inverse().to_rotation_matrix().into_inner();
    let end_from_world = end_from_start * world_from_start.transpose();
    let (secs, by) = (change.duration_secs, &change.by_bias);
    let mut f = Matrix18::identity();
    for (row, column, block) in [
        (0, 0, end_from_start),
        (0, GYRO_BIAS, by.rotation_by_gyro),
        (3, 0, -end_from_start * so3::hat(&change.position_m)),
        (3, 3, end_from_start),
        (3, VELOCITY, end_from_world * secs),
        (3, GYRO_BIAS, end_from_start * by.position_by_gyro),
        (3, ACCEL_BIAS, end_from_start * by.position_by_accel),
        (3, GRAVITY, end_from_world * (0.5 * secs * secs)),
        (
            VELOCITY,
            0,
            -world_from_start * so3::hat(&change.velocity_m_s),
        ),
        (VELOCITY, GYRO_BIAS, world_from_start * by.velocity_by_gyro),
        (
            VELOCITY,
            ACCEL_BIAS,
            world_from_start * by.velocity_by_accel,
        ),
        (VELOCITY, GRAVITY, Matrix3::identity() * secs),
    ] {
        f.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
    }
    f
}

/// What the samples' noise makes of the error state at the end of a change.
fn measured(change: &PreintegratedImu, world_from_start: &Matrix3<f64>) -> Matrix18 {
    let end_from_start = change.rotation.inverse().to_rotation_matrix().into_inner();
    // The change is ordered rotation, velocity, position, the last two in the frame of its start.
    let mut by_change = SMatrix::<f64, 18, 9>::zeros();
    for (row, column, block) in [
        (0, 0, Matrix3::identity()),
        (VELOCITY, 3, *world_from_start),
        (3, 6, end_from_start),
    ] {
        by_change
            .fixed_view_mut::<3, 3>(row, column)
            .copy_from(&block);
    }
    by_change * change.covariance * by_change.transpose()
}
