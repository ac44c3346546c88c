//! How the filter starts: level, and standing or in motion.

use lsfb_geometry::{ImuNoiseModel, Matrix3, Se3, UnitQuaternion, Vector3, so3};
use lsfb_types::{ImuSample, Stamped, Timestamp};
use nalgebra::SVector;

use super::reading::Reading;
use super::{
    ACCEL_BIAS, GRAVITY, GRAVITY_M_S2, GYRO_BIAS, InertialFilter, InertialState, Matrix18, VELOCITY,
};

/// Means over a scan that differ from those at the start by more than this are the first step, rad/s and m/s².
const STANDING_RATE_RAD_S: f64 = 0.03;
const STANDING_FORCE_M_S2: f64 = 0.2;

/// Of a pose that defines the world, radians and metres.
const EXACT: f64 = 1e-5;

/// Mean angular velocity and specific force of a carrier that stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Standing {
    angular_velocity: Vector3<f64>,
    specific_force: Vector3<f64>,
}

impl Standing {
    /// Whether the mean over samples is still the same.
    pub fn goes_on(&self, samples: &[Stamped<ImuSample>]) -> bool {
        let n = samples.len().max(1) as f64;
        let turns = samples.iter().map(|s| Reading::from(s).angular_velocity);
        let forces = samples.iter().map(|s| Reading::from(s).specific_force);
        (turns.sum::<Vector3<f64>>() / n - self.angular_velocity).norm() < STANDING_RATE_RAD_S
            && (forces.sum::<Vector3<f64>>() / n - self.specific_force).norm() < STANDING_FORCE_M_S2
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
        set(0, EXACT);
        set(3, EXACT);
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

    /// Gives a start its velocity, in the world; the pose `secs` later stays what it would have been without.
    pub fn moves(&mut self, velocity_m_s: Vector3<f64>, sigma_m_s: f64, secs: f64) {
        self.state.velocity_m_s = velocity_m_s;
        self.state.world_from_rig.translation -= velocity_m_s * secs;
        let variance = Matrix3::identity() * (sigma_m_s * sigma_m_s);
        for covariance in [&mut self.covariance, &mut self.reported] {
            let mut block = covariance.fixed_view_mut::<3, 3>(VELOCITY, VELOCITY);
            block.copy_from(&variance);
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
