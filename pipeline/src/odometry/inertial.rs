//! The inertial half: an error-state filter that predicts the pose between scans and learns velocity, biases and
//! gravity from the registered poses.
//!
//! Error state, in this order: rotation and translation of the pose (right perturbation), velocity, gyroscope bias,
//! accelerometer bias, gravity; three components each. Model as in Xu et al., "FAST-LIO2", eq. (1)–(8), with the pose
//! error in the tangent of SE(3).

use lsfb_geometry::{
    ImuNoiseModel, Matrix3, Matrix6, Se3, StampedPose, UnitQuaternion, Vector3, Vector6, so3,
};
use lsfb_perception::lidar::PosePrior;
use lsfb_types::{ImuSample, Stamped, Timestamp};
use nalgebra::{SMatrix, SVector};

use super::uncertainty::once_seen;

type Matrix18 = SMatrix<f64, 18, 18>;

const VELOCITY: usize = 6;
const GYRO_BIAS: usize = 9;
const ACCEL_BIAS: usize = 12;
const GRAVITY: usize = 15;

/// Standard gravity, m/s².
pub const GRAVITY_M_S2: f64 = 9.80665;

/// Beyond this the motion between two samples is not what they say, seconds: steps shake at a few hertz, and a straight line
/// between samples still follows that.
const MAX_SAMPLE_GAP_S: f64 = 0.08;
/// Longer than this between two samples a straight line between them misses some of the motion, seconds.
const SURE_SAMPLE_GAP_S: f64 = 0.02;
/// Means over a scan that differ from those at the start by more than this are the first step, rad/s and m/s².
const STANDING_RATE_RAD_S: f64 = 0.03;
const STANDING_FORCE_M_S2: f64 = 0.2;
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

/// Mean angular velocity and specific force of a carrier that stands.
#[derive(Clone, Copy, Debug)]
struct Standing {
    angular_velocity: Vector3<f64>,
    specific_force: Vector3<f64>,
}

impl Standing {
    /// Whether the mean over samples is still the same.
    fn goes_on(&self, samples: &[Stamped<ImuSample>]) -> bool {
        let n = samples.len().max(1) as f64;
        let turns = samples.iter().map(|s| Reading::from(s).angular_velocity);
        let forces = samples.iter().map(|s| Reading::from(s).specific_force);
        (turns.sum::<Vector3<f64>>() / n - self.angular_velocity).norm() < STANDING_RATE_RAD_S
            && (forces.sum::<Vector3<f64>>() / n - self.specific_force).norm() < STANDING_FORCE_M_S2
    }
}

/// Angular velocity and specific force at one time.
#[derive(Clone, Copy)]
struct Reading {
    time: Timestamp,
    angular_velocity: Vector3<f64>,
    specific_force: Vector3<f64>,
}

impl From<&Stamped<ImuSample>> for Reading {
    fn from(s: &Stamped<ImuSample>) -> Self {
        Self {
            time: s.time,
            angular_velocity: s.sample.angular_velocity_rad_s.into(),
            specific_force: s.sample.specific_force_m_s2.into(),
        }
    }
}

impl Reading {
    fn between(a: &Self, b: &Self, time: Timestamp) -> Self {
        let span = b.time.secs_since(a.time);
        let fraction = if span > 0.0 {
            (time.secs_since(a.time) / span).clamp(0.0, 1.0)
        } else {
            1.0
        };
        Self {
            time,
            angular_velocity: a.angular_velocity.lerp(&b.angular_velocity, fraction),
            specific_force: a.specific_force.lerp(&b.specific_force, fraction),
        }
    }
}

/// Reading at `time`, linear between samples, the nearest one outside them.
fn reading_at(samples: &[Stamped<ImuSample>], time: Timestamp) -> Option<Reading> {
    let next = samples.partition_point(|s| s.time < time);
    match (
        next.checked_sub(1).and_then(|i| samples.get(i)),
        samples.get(next),
    ) {
        (Some(a), Some(b)) => Some(Reading::between(&a.into(), &b.into(), time)),
        (Some(only), None) | (None, Some(only)) => Some(Reading {
            time,
            ..only.into()
        }),
        (None, None) => None,
    }
}

impl InertialFilter {
    /// Starts at the world's origin at `time`, level by the mean specific force of `samples`, heading along x.
    /// While the carrier stands the mean angular velocity is the gyroscope bias. `None` without samples.
    pub fn start(
        samples: &[Stamped<ImuSample>],
        time: Timestamp,
        noise: &ImuNoiseModel,
    ) -> Option<Self> {
        if samples.is_empty() {
            return None;
        }
        let n = samples.len() as f64;
        let mean = |f: fn(&ImuSample) -> [f64; 3]| -> Vector3<f64> {
            samples
                .iter()
                .map(|s| Vector3::from(f(&s.sample)))
                .sum::<Vector3<f64>>()
                / n
        };
        let force = mean(|s| s.specific_force_m_s2);
        let rate = mean(|s| s.angular_velocity_rad_s);
        let spread = |f: fn(&ImuSample) -> [f64; 3], mean: &Vector3<f64>| -> f64 {
            let squares: f64 = samples
                .iter()
                .map(|s| (Vector3::from(f(&s.sample)) - mean).norm_squared())
                .sum();
            (squares / n).sqrt()
        };
        let stands = rate.norm() < 0.05
            && spread(|s| s.angular_velocity_rad_s, &rate) < 0.05
            && spread(|s| s.specific_force_m_s2, &force) < 0.5;

        // Only the horizontal part of the rotation is known from gravity; the shortest arc leaves the heading at 0. Upside down
        // there is no shortest one, and half a turn about any horizontal axis will do.
        let half_turn =
            || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let rotation =
            UnitQuaternion::rotation_between(&force, &Vector3::z()).unwrap_or_else(half_turn);
        let forward = rotation * Vector3::x();
        let heading = so3::exp(&Vector3::new(0.0, 0.0, -forward.y.atan2(forward.x)));
        let mut variance = SVector::<f64, 18>::zeros();
        let mut set = |at: usize, sigma: f64| variance.fixed_rows_mut::<3>(at).fill(sigma * sigma);
        // The start defines the world, so its pose is exact; what is uncertain is where gravity points in it.
        set(0, 1e-5);
        set(3, 1e-5);
        set(VELOCITY, if stands { 0.05 } else { 2.0 });
        set(GYRO_BIAS, if stands { 0.003 } else { 0.02 });
        set(ACCEL_BIAS, 0.1);
        set(GRAVITY, if stands { 0.1 } else { 1.0 });
        // The length of gravity is known.
        variance[GRAVITY + 2] = 0.01f64.powi(2);
        Some(Self {
            state: InertialState {
                world_from_rig: Se3::new(heading * rotation, Vector3::zeros()),
                velocity_m_s: Vector3::zeros(),
                gyro_bias_rad_s: if stands { rate } else { Vector3::zeros() },
                accel_bias_m_s2: Vector3::zeros(),
                gravity_m_s2: Vector3::new(0.0, 0.0, -GRAVITY_M_S2),
            },
            covariance: Matrix18::from_diagonal(&variance),
            reported: Matrix18::from_diagonal(&variance),
            standing: stands.then_some(Standing {
                angular_velocity: rate,
                specific_force: force,
            }),
            time,
            noise: noise.clone(),
        })
    }

    /// The estimate at [`InertialFilter::time`].
    pub fn state(&self) -> &InertialState {
        &self.state
    }

    /// Time of the estimate.
    pub fn time(&self) -> Timestamp {
        self.time
    }

    /// Whether it has not moved since the start, as far as an IMU can tell.
    pub fn stands(&self) -> bool {
        self.standing.is_some()
    }

    /// Moves the estimate to `end` with the samples around that span; returns the poses on the way, both ends included.
    pub fn predict(&mut self, samples: &[Stamped<ImuSample>], end: Timestamp) -> Vec<StampedPose> {
        let mut knots = vec![self.knot()];
        let first = samples.partition_point(|s| s.time <= self.time);
        let last = samples.partition_point(|s| s.time < end).max(first);
        let inside = &samples[first..last];
        self.standing = self
            .standing
            .filter(|standing| inside.is_empty() || standing.goes_on(inside));
        let Some(mut from) = reading_at(samples, self.time) else {
            return knots;
        };
        let inside = inside.iter().map(Reading::from);
        for to in inside.chain(reading_at(samples, end)) {
            self.integrate(&from, &to);
            knots.push(self.knot());
            from = to;
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
        let s = &self.state;
        let blind = dt > MAX_SAMPLE_GAP_S;
        let rate = (from.angular_velocity + to.angular_velocity) * 0.5 - s.gyro_bias_rad_s;
        let turn = so3::exp(&(rate * dt));
        // Force at mid-time in the attitude of mid-time.
        let force = (from.specific_force + to.specific_force) * 0.5 - s.accel_bias_m_s2;
        let middle = so3::retract(&s.world_from_rig.rotation, &(rate * (0.5 * dt)))
            .to_rotation_matrix()
            .into_inner();
        let acceleration = if blind {
            Vector3::zeros()
        } else {
            middle * force + s.gravity_m_s2
        };
        let start = s.world_from_rig;
        let mut end_rotation = start.rotation * turn;
        end_rotation.renormalize_fast();
        let end = Se3::new(
            end_rotation,
            start.translation + s.velocity_m_s * dt + acceleration * (0.5 * dt * dt),
        );

        let start_from_end = turn.inverse().to_rotation_matrix().into_inner();
        let end_from_world = end.rotation_matrix().transpose();
        let force_by_rotation = middle * so3::hat(&force);
        let mut f = Matrix18::identity();
        let mut set = |row: usize, column: usize, block: Matrix3<f64>| {
            f.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        set(0, 0, start_from_end);
        set(0, GYRO_BIAS, so3::right_jacobian(&(rate * dt)) * -dt);
        set(3, 0, end_from_world * force_by_rotation * (-0.5 * dt * dt));
        set(3, 3, start_from_end);
        set(3, VELOCITY, end_from_world * dt);
        set(3, ACCEL_BIAS, end_from_world * middle * (-0.5 * dt * dt));
        set(3, GRAVITY, end_from_world * (0.5 * dt * dt));
        set(VELOCITY, 0, -force_by_rotation * dt);
        set(VELOCITY, ACCEL_BIAS, middle * -dt);
        set(VELOCITY, GRAVITY, Matrix3::identity() * dt);

        let mut noise = SVector::<f64, 18>::zeros();
        // What a straight line misses grows with the square of its length.
        let missed = if blind {
            1.0
        } else if dt > SURE_SAMPLE_GAP_S {
            (dt / MAX_SAMPLE_GAP_S).powi(2)
        } else {
            0.0
        };
        let mut add = |at: usize, density: f64, unseen: f64| {
            let sigma = missed * unseen * dt;
            let variance = density * density * dt + sigma * sigma;
            noise.fixed_rows_mut::<3>(at).fill(variance);
        };
        add(0, self.noise.gyro_noise_density, UNSEEN_RATE_RAD_S);
        add(3, 0.0, 0.5 * UNSEEN_ACCELERATION_M_S2 * dt);
        add(
            VELOCITY,
            self.noise.accel_noise_density,
            UNSEEN_ACCELERATION_M_S2,
        );
        add(GYRO_BIAS, self.noise.gyro_bias_walk, 0.0);
        add(ACCEL_BIAS, self.noise.accel_bias_walk, 0.0);

        let noise = Matrix18::from_diagonal(&noise);
        self.covariance = f * self.covariance * f.transpose() + noise;
        self.reported = f * self.reported * f.transpose() + noise;
        self.state.world_from_rig = end;
        self.state.velocity_m_s += acceleration * dt;
        self.time = to.time;
    }

    /// How far the pose may be off against the map: covariance of `[rotation, translation]`.
    pub fn reported_covariance(&self) -> Matrix6<f64> {
        self.reported.fixed_view::<6, 6>(0, 0).into()
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
        let s = &mut self.state;
        s.world_from_rig = *world_from_rig;
        s.velocity_m_s += delta.fixed_rows::<3>(VELOCITY);
        s.gyro_bias_rad_s += delta.fixed_rows::<3>(GYRO_BIAS);
        s.accel_bias_m_s2 += delta.fixed_rows::<3>(ACCEL_BIAS);
        s.gravity_m_s2 += delta.fixed_rows::<3>(GRAVITY);
        if let Some(seen) = once_seen(p, information) {
            self.covariance = seen;
        }
        if let Some(seen) = once_seen(&self.reported, lasting) {
            self.reported = seen;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_types::ImuSample;

    const NOISE: ImuNoiseModel = ImuNoiseModel {
        gyro_noise_density: 1e-4,
        accel_noise_density: 1e-3,
        gyro_bias_walk: 1e-5,
        accel_bias_walk: 1e-4,
    };

    /// Samples at 200 Hz of an IMU at rest, turned by `world_from_rig`.
    fn at_rest(
        world_from_rig: &UnitQuaternion<f64>,
        gyro_bias: [f64; 3],
    ) -> Vec<Stamped<ImuSample>> {
        let force = world_from_rig.inverse() * Vector3::new(0.0, 0.0, GRAVITY_M_S2);
        (0..400)
            .map(|i| Stamped {
                time: Timestamp::from_nanos(i * 5_000_000),
                arrival: Timestamp::from_nanos(i * 5_000_000),
                device_ticks: 0,
                sample: ImuSample {
                    angular_velocity_rad_s: gyro_bias,
                    specific_force_m_s2: force.into(),
                },
            })
            .collect()
    }

    #[test]
    fn starts_level_with_heading_zero_and_stays() {
        let tilted = so3::exp(&Vector3::new(0.2, -0.1, 0.0));
        let samples = at_rest(&tilted, [0.004, -0.002, 0.001]);
        let zero = Timestamp::from_nanos(0);
        let mut filter = InertialFilter::start(&samples[..20], zero, &NOISE).expect("samples");
        let knots = filter.predict(&samples, Timestamp::from_nanos(1_002_500_000));
        assert_eq!(knots.len(), 202);
        let end = filter.state();
        assert_eq!(filter.time().nanos(), 1_002_500_000);
        assert!(end.world_from_rig.translation.norm() < 1e-9);
        let forward = end.world_from_rig.rotation * Vector3::x();
        assert!(forward.y.abs() < 1e-9);
        let up = end.world_from_rig.rotation.inverse() * Vector3::z();
        assert!((up - tilted.inverse() * Vector3::z()).norm() < 1e-9);
    }

    #[test]
    fn upside_down_is_level_too() {
        let samples = at_rest(
            &UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI),
            [0.0; 3],
        );
        // Exactly upside down, where no shortest way leads to level.
        let exactly: Vec<_> = samples
            .iter()
            .cloned()
            .map(|mut s| {
                s.sample.specific_force_m_s2 = [0.0, 0.0, -GRAVITY_M_S2];
                s
            })
            .collect();
        for samples in [samples, exactly] {
            let zero = Timestamp::from_nanos(0);
            let mut filter = InertialFilter::start(&samples, zero, &NOISE).expect("samples");
            let up = filter.state().world_from_rig.rotation * -Vector3::z();
            assert!((up - Vector3::z()).norm() < 1e-6, "{up}");
            filter.predict(&samples, Timestamp::from_nanos(500_000_000));
            assert!(filter.state().velocity_m_s.norm() < 1e-6);
        }
    }

    /// Naively a gap of 45 ms was taken for even motion, and a second at 1 m/s² cost several centimetres a second.
    #[test]
    fn a_gap_of_45_ms_is_bridged_by_its_ends() {
        let samples: Vec<_> = at_rest(&UnitQuaternion::identity(), [0.0; 3])
            .into_iter()
            .enumerate()
            .filter(|(i, _)| i.is_multiple_of(20) || i % 20 > 8)
            .map(|(_, mut s)| {
                s.sample.specific_force_m_s2[0] = 1.0;
                s
            })
            .collect();
        let zero = Timestamp::from_nanos(0);
        let mut filter = InertialFilter::start(&samples[..1], zero, &NOISE).expect("samples");
        // The start takes what it feels for up: here the world is known.
        filter.state.world_from_rig = Se3::identity();
        filter.predict(&samples, Timestamp::from_nanos(1_000_000_000));
        let velocity = filter.state().velocity_m_s;
        assert!((velocity.x - 1.0).abs() < 0.01, "{velocity}");
    }

    #[test]
    fn a_gap_widens_the_prior() {
        let samples = at_rest(&UnitQuaternion::identity(), [0.0; 3]);
        let (zero, end) = (Timestamp::from_nanos(0), Timestamp::from_nanos(600_000_000));
        let information = |samples: &[Stamped<ImuSample>]| {
            let mut filter = InertialFilter::start(&samples[..20], zero, &NOISE).expect("samples");
            filter.predict(samples, end);
            filter.pose_prior().information
        };
        let whole = information(&samples);
        let mut holed = samples.clone();
        holed.drain(20..110);
        let gap = information(&holed);
        for i in 0..6 {
            assert!(gap[(i, i)] < 0.1 * whole[(i, i)], "{i}: {gap} {whole}");
        }
    }

    #[test]
    fn poses_teach_the_accelerometer_bias() {
        let samples: Vec<_> = at_rest(&UnitQuaternion::identity(), [0.0; 3])
            .into_iter()
            .map(|mut s| {
                s.sample.specific_force_m_s2[2] += 0.05;
                s
            })
            .collect();
        let zero = Timestamp::from_nanos(0);
        let mut filter = InertialFilter::start(&samples[..20], zero, &NOISE).expect("samples");
        let information = Matrix6::identity() * 1e6;
        for i in 1..19 {
            filter.predict(&samples, Timestamp::from_nanos(i * 100_000_000));
            filter.correct(&Se3::identity(), &information, &information);
        }
        let state = filter.state();
        // The length of gravity is known to a centimetre per second squared: the rest is bias.
        assert!((state.accel_bias_m_s2.z - 0.05).abs() < 0.005, "{state:?}");
        assert!(state.velocity_m_s.norm() < 2e-3, "{state:?}");
    }
}
