//! How the filter starts: level, and standing or in motion.

use lsfb_geometry::{ImuNoiseModel, Matrix3, Se3, UnitQuaternion, Vector3, so3};
use lsfb_types::{ImuSample, STANDARD_GRAVITY_M_S2, Stamped, Timestamp};
use nalgebra::SVector;

use super::standing::{STANDING_GYRO_RAD_S, STANDING_VELOCITY_M_S, Standing};
use super::{ACCEL_BIAS, GRAVITY, GYRO_BIAS, InertialFilter, InertialState, Matrix18, VELOCITY};

/// Of a pose that defines the world, radians and metres.
const EXACT: f64 = 1e-5;
/// How well the length of gravity is known, m/s².
const GRAVITY_LENGTH_M_S2: f64 = 0.01;
/// What a carrier that feels as if it stood may turn, rad/s, and gather in speed, m/s², while it does not stand.
const QUIET_RAD_S: f64 = 0.01;
const QUIET_M_S2: f64 = 0.3;

/// A gyroscope's bias that is known before the walk begins.
#[derive(Clone, Copy, Debug)]
pub(in crate::odometry) struct KnownBias {
    pub rad_s: Vector3<f64>,
    /// Standard deviation of each component, rad/s.
    pub sigma_rad_s: Vector3<f64>,
}

impl KnownBias {
    /// Whether both may be one: within three standard deviations.
    pub fn agrees(&self, other: &Self) -> bool {
        let apart = (self.rad_s - other.rad_s).abs();
        let sigma = self.sigma_rad_s.zip_map(&other.sigma_rad_s, f64::hypot);
        apart.iter().zip(&sigma).all(|(apart, s)| *apart <= 3.0 * s)
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
        let world_from_imu = heading * rotation;
        let mut variance = SVector::<f64, 18>::zeros();
        let mut set = |at: usize, sigma: f64| variance.fixed_rows_mut::<3>(at).fill(sigma * sigma);
        // The start defines the world, so its pose is exact; what is uncertain is where gravity points in it.
        set(0, EXACT);
        set(3, EXACT);
        let of_velocity = if stands { STANDING_VELOCITY_M_S } else { 2.0 };
        let of_gyro = if stands { STANDING_GYRO_RAD_S } else { 0.02 };
        set(VELOCITY, of_velocity);
        set(GYRO_BIAS, of_gyro);
        set(ACCEL_BIAS, 0.1);
        set(GRAVITY, if stands { 0.1 } else { 1.0 });
        // The length of gravity is known.
        variance[GRAVITY + 2] = GRAVITY_LENGTH_M_S2 * GRAVITY_LENGTH_M_S2;
        Some(Self {
            state: InertialState {
                world_from_rig: Se3::new(world_from_imu, Vector3::zeros()),
                velocity_m_s: Vector3::zeros(),
                gyro_bias_rad_s: if stands { rate } else { Vector3::zeros() },
                accel_bias_m_s2: Vector3::zeros(),
                gravity_m_s2: Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2),
            },
            covariance: Matrix18::from_diagonal(&variance),
            reported: Matrix18::from_diagonal(&variance),
            standing: stands.then_some(Standing {
                angular_velocity: rate,
                force_in_world: world_from_imu * force,
                turned_rad: Vector3::zeros(),
                secs: 0.0,
            }),
            time,
            noise: noise.clone(),
        })
    }

    /// Gives a start the gyroscope's bias.
    pub(in crate::odometry) fn knows_bias(&mut self, known: &KnownBias) {
        self.state.gyro_bias_rad_s = known.rad_s;
        for covariance in [&mut self.covariance, &mut self.reported] {
            for (k, sigma) in known.sigma_rad_s.iter().enumerate() {
                covariance[(GYRO_BIAS + k, GYRO_BIAS + k)] = sigma * sigma;
            }
        }
    }

    /// Gives a start its velocity, in the world; the pose `secs` later stays what it would have been without.
    pub fn moves(&mut self, velocity_m_s: Vector3<f64>, sigma_m_s: f64, secs: f64) {
        self.state.velocity_m_s = velocity_m_s;
        self.state.world_from_rig.translation -= velocity_m_s * secs;
        let mut known: Vec<(usize, f64)> = vec![(VELOCITY, sigma_m_s)];
        if self.standing.take().is_some() {
            // Taken for standing by what it felt: so little it turns and gathers speed at least.
            known.extend([(GYRO_BIAS, QUIET_RAD_S), (GRAVITY, QUIET_M_S2)]);
        }
        for covariance in [&mut self.covariance, &mut self.reported] {
            for (at, sigma) in &known {
                let variance = Matrix3::identity() * (sigma * sigma);
                let mut block = covariance.fixed_view_mut::<3, 3>(*at, *at);
                block.copy_from(&variance);
            }
            // The length of gravity is known.
            covariance[(GRAVITY + 2, GRAVITY + 2)] = GRAVITY_LENGTH_M_S2 * GRAVITY_LENGTH_M_S2;
        }
    }

    /// The pose of now defines the world: it is exact, and nothing is told by it.
    pub fn become_origin(&mut self) {
        for covariance in [&mut self.covariance, &mut self.reported] {
            covariance.fixed_rows_mut::<6>(0).fill(0.0);
            covariance.fixed_columns_mut::<6>(0).fill(0.0);
            for at in 0..6 {
                covariance[(at, at)] = EXACT * EXACT;
            }
        }
    }
}
