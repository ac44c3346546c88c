//! IMU samples between two instants, summed up once so that the optimisation need not go through them again.
//!
//! Forster, Carlone, Dellaert, Scaramuzza, "On-Manifold Preintegration for Real-Time Visual-Inertial Odometry",
//! TRO 2017. Between samples angular velocity and specific force are straight lines. Along these the motion is integrated to fourth order in the
//! sample period: rotations by the Magnus expansion, velocity and position by Gauss' rule. The noise takes the force
//! and the rotation in the middle of each piece.
//!
//! Factors of an optimisation sum up many pieces; the odometry's filter takes one at a time.

use lsfb_geometry::{ImuNoiseModel, Matrix3, Se3, UnitQuaternion, Vector3, so3};
use lsfb_types::{ImuSample, STANDARD_GRAVITY_M_S2, Stamped, Timestamp};
use nalgebra::{SMatrix, Vector6};

mod reading;

pub use reading::{Reading, reading_at};

/// 9 × 9, ordered rotation, velocity, position.
pub type Matrix9 = SMatrix<f64, 9, 9>;

/// Gravity in a level world, z up, m/s².
pub fn standard_gravity_m_s2() -> Vector3<f64> {
    Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2)
}

/// Constant errors of the IMU over a short time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuBias {
    /// Added to every angular velocity, rad/s.
    pub gyro_rad_s: Vector3<f64>,
    /// Added to every specific force, m/s².
    pub accel_m_s2: Vector3<f64>,
}

/// Errors that stay the same, of the IMU and of the world in which its motion is sought: of what is read beyond the bias `1 - s` is true, `s`
/// the scale error of the axis, and so of lengths in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuErrors {
    /// Share by which the gyroscope's axes read too much.
    pub gyro_scale: Vector3<f64>,
    /// The same of the accelerometer's.
    pub accel_scale: Vector3<f64>,
    /// Shares of one axis that another of the gyroscope's reads too, and the other way round: y and z, x and z, x and y. With the scale it is
    /// the symmetric part of what its axes are off; the rest, a turn, is that of the cameras.
    pub gyro_shear: Vector3<f64>,
    /// The same of the accelerometer's.
    pub accel_shear: Vector3<f64>,
    /// By how much the accelerometer reads forces turned on the gyroscope's axes: `exp(turn)` of the true ones, radians.
    pub accel_turn_rad: Vector3<f64>,
    /// By how much the accelerometer's readings are later than the gyroscope's of the same stamp (their filters differ), seconds.
    pub accel_delay_s: f64,
    /// Share by which lengths in the world are too large: a map's scale.
    pub world_scale: f64,
}

impl ImuErrors {
    /// What of an angular velocity without bias is true.
    pub fn true_turn_rate(&self, read: &Vector3<f64>) -> Vector3<f64> {
        read - scaled_and_sheared(read) * self.gyro_axes()
    }

    /// Scale and shear of the gyroscope.
    pub fn gyro_axes(&self) -> Vector6<f64> {
        joined(&self.gyro_scale, &self.gyro_shear)
    }

    /// Scale and shear of the accelerometer.
    pub fn accel_axes(&self) -> Vector6<f64> {
        joined(&self.accel_scale, &self.accel_shear)
    }
}

fn joined(a: &Vector3<f64>, b: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
}

/// How much of what is read one unit of each axis' scale, and of each pair's shear, takes away.
fn scaled_and_sheared(read: &Vector3<f64>) -> Matrix3xN<6> {
    let (x, y, z) = (read.x, read.y, read.z);
    Matrix3xN::from_row_slice(&[
        x, 0.0, 0.0, 0.0, z, y, //
        0.0, y, 0.0, z, 0.0, x, //
        0.0, 0.0, z, y, x, 0.0,
    ])
}

/// Pose and velocity of the rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NavState {
    /// Pose of the rig, whose frame is the IMU's.
    pub world_from_rig: Se3,
    /// Velocity in the world, m/s.
    pub velocity_m_s: Vector3<f64>,
}

/// 3 × `N`.
type Matrix3xN<const N: usize> = SMatrix<f64, 3, N>;

/// Derivatives of the preintegrated changes by the bias (`N` is 3), or by scale and shear (6).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BiasJacobians<const N: usize> {
    /// Tangent of the rotation by the gyroscope's.
    pub rotation_by_gyro: Matrix3xN<N>,
    /// Velocity by the gyroscope's.
    pub velocity_by_gyro: Matrix3xN<N>,
    /// Velocity by the accelerometer's.
    pub velocity_by_accel: Matrix3xN<N>,
    /// Position by the gyroscope's.
    pub position_by_gyro: Matrix3xN<N>,
    /// Position by the accelerometer's.
    pub position_by_accel: Matrix3xN<N>,
}

/// One piece between two samples, as the derivatives of the changes need it.
struct Piece {
    secs: f64,
    /// Tangent of the piece's rotation by the angular velocity.
    turn_by_rate: Matrix3<f64>,
    /// The piece's rotation backwards.
    turned: Matrix3<f64>,
    /// Where its forces are summed up.
    places: [GaussPoint; 3],
}

/// One of Gauss' points on a piece.
struct GaussPoint {
    /// For how long its force counts, and from then on to the end of the piece, seconds.
    secs: f64,
    left_secs: f64,
    /// Tangent of the rotation since the piece's begin by the angular velocity, and that rotation backwards.
    turn_by_rate: Matrix3<f64>,
    turned: Matrix3<f64>,
    /// Rotation from the start, and what a turn there does to the force.
    rotation: Matrix3<f64>,
    force_by_rotation: Matrix3<f64>,
}

impl<const N: usize> BiasJacobians<N> {
    fn none() -> Self {
        Self {
            rotation_by_gyro: Matrix3xN::zeros(),
            velocity_by_gyro: Matrix3xN::zeros(),
            velocity_by_accel: Matrix3xN::zeros(),
            position_by_gyro: Matrix3xN::zeros(),
            position_by_accel: Matrix3xN::zeros(),
        }
    }

    /// Goes on by a piece. `taken` says how much of angular velocity and force one unit of each parameter takes away.
    fn advance(&mut self, piece: &Piece, [from_rate, from_force]: [&Matrix3xN<N>; 2]) {
        self.position_by_gyro += self.velocity_by_gyro * piece.secs;
        self.position_by_accel += self.velocity_by_accel * piece.secs;
        for place in &piece.places {
            let turned = place.turned * self.rotation_by_gyro - place.turn_by_rate * from_rate;
            let by_gyro = place.force_by_rotation * turned * place.secs;
            let by_accel = place.rotation * from_force * place.secs;
            self.velocity_by_gyro += by_gyro;
            self.velocity_by_accel -= by_accel;
            self.position_by_gyro += by_gyro * place.left_secs;
            self.position_by_accel -= by_accel * place.left_secs;
        }
        self.rotation_by_gyro =
            piece.turned * self.rotation_by_gyro - piece.turn_by_rate * from_rate;
    }
}

/// What the IMU says about the motion from one instant to another, in the rig frame of the first, without gravity.
#[derive(Clone, Debug, PartialEq)]
pub struct PreintegratedImu {
    /// From the first instant to the second, seconds.
    pub duration_secs: f64,
    /// Rotation of the rig, `start_from_end`.
    pub rotation: UnitQuaternion<f64>,
    /// Change of velocity, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Change of position beyond that of constant velocity, metres.
    pub position_m: Vector3<f64>,
    /// The bias that was subtracted.
    pub bias: ImuBias,
    /// How the changes depend on it.
    pub by_bias: BiasJacobians<3>,
    /// How they depend on scale and shear, which were taken for none.
    pub by_scale: BiasJacobians<6>,
    /// How velocity and position depend on the turn of the accelerometer's axes, which was taken for none.
    pub by_turn: [Matrix3<f64>; 2],
    /// How velocity and position depend on the accelerometer's delay, which was taken for none.
    pub by_delay: [Vector3<f64>; 2],
    /// Covariance of `[rotation, velocity, position]` from the white noise.
    pub covariance: Matrix9,
}

/// The preintegrated changes corrected to another bias, to first order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectedChange {
    /// Rotation of the rig, `start_from_end`.
    pub rotation: UnitQuaternion<f64>,
    /// Tangent by which the rotation was corrected.
    pub rotation_correction: Vector3<f64>,
    /// Change of velocity, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Change of position, metres.
    pub position_m: Vector3<f64>,
}

/// Places and weights of Gauss' rule with three points on a piece of length one.
const GAUSS: [(f64, f64); 3] = [
    (0.112_701_665_379_258_3, 5.0 / 18.0),
    (0.5, 8.0 / 18.0),
    (0.887_298_334_620_741_7, 5.0 / 18.0),
];

/// An angular velocity on a straight line.
struct Turning {
    rate: Vector3<f64>,
    slope: Vector3<f64>,
    /// Axes that turn themselves: `ω × ω'` / 12.
    coning: Vector3<f64>,
}

impl Turning {
    /// From its values at both ends of a piece.
    fn of([first, last]: [Vector3<f64>; 2], secs: f64) -> Self {
        let slope = (last - first) / secs;
        Self {
            rate: first,
            slope,
            coning: first.cross(&slope) / 12.0,
        }
    }

    /// Logarithm of the rotation up to a time after its begin: the first two terms of the Magnus expansion, an error of fifth order.
    fn until(&self, secs: f64) -> Vector3<f64> {
        (self.rate + self.slope * (0.5 * secs) + self.coning * (secs * secs)) * secs
    }
}

/// Stands for the noise of an IMU whose samples are weighed against nothing, or that is not there.
pub const NO_WEIGHT: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 1e-3,
    accel_noise_density: 1e-2,
    gyro_bias_walk: 1e-4,
    accel_bias_walk: 1e-3,
};

/// A pause of the IMU too long to be bridged.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("no IMU samples from {from} s to {to} s: at most {longest_secs} s are bridged")]
pub struct ImuGap {
    /// The last sample before it, or where samples should begin.
    pub from: Timestamp,
    /// The first behind it, or where samples should end.
    pub to: Timestamp,
    /// The longest that is, seconds.
    pub longest_secs: f64,
}

/// Longest pause between samples that is bridged by a straight line, seconds.
const LONGEST_PAUSE_SECS: f64 = 0.05;

impl PreintegratedImu {
    /// No time at all: where summing begins.
    pub fn nothing(bias: ImuBias) -> Self {
        Self {
            duration_secs: 0.0,
            rotation: UnitQuaternion::identity(),
            velocity_m_s: Vector3::zeros(),
            position_m: Vector3::zeros(),
            bias,
            by_bias: BiasJacobians::none(),
            by_scale: BiasJacobians::none(),
            by_turn: [Matrix3::zeros(); 2],
            by_delay: [Vector3::zeros(); 2],
            covariance: Matrix9::zeros(),
        }
    }

    /// Integrates `samples`, which are in order of time and reach from `start` to `end`.
    ///
    /// [`ImuGap`] where they leave more than 50 ms open, at an end or between.
    pub fn integrate(
        samples: &[Stamped<ImuSample>],
        start: Timestamp,
        end: Timestamp,
        bias: ImuBias,
        noise: &ImuNoiseModel,
    ) -> Result<Self, ImuGap> {
        let first = samples
            .partition_point(|s| s.time <= start)
            .saturating_sub(1);
        let last = samples.partition_point(|s| s.time < end);
        let readings: Vec<Reading> = samples
            .get(first..(last + 1).min(samples.len()))
            .unwrap_or_default()
            .iter()
            .map(Reading::from)
            .collect();
        check_coverage(&readings, start, end)?;

        let mut sum = Self::nothing(bias);
        for (k, pair) in readings.windows(2).enumerate() {
            // The first and last pieces are held where the samples begin or stop just inside.
            let from = if k == 0 { start } else { pair[0].time };
            let to = if k + 2 == readings.len() {
                end
            } else {
                pair[1].time
            };
            if to > from {
                let [from, to] = [from, to].map(|t| Reading::between(&pair[0], &pair[1], t));
                sum.advance(&from, &to, noise);
            }
        }
        Ok(sum)
    }

    /// The one piece between two readings, however long.
    pub fn between(from: &Reading, to: &Reading, bias: ImuBias, noise: &ImuNoiseModel) -> Self {
        let mut piece = Self::nothing(bias);
        piece.advance(from, to, noise);
        piece
    }

    /// Adds the piece between two readings. Eq. (35)–(43), (A.9) with the middle rotation.
    fn advance(&mut self, from: &Reading, to: &Reading, noise: &ImuNoiseModel) {
        let dt = to.time.secs_since(from.time);
        let gyro = [from.angular_velocity, to.angular_velocity];
        let accel = [from.specific_force, to.specific_force];
        let rate = (gyro[0] + gyro[1]) * 0.5 - self.bias.gyro_rad_s;
        let turning = Turning::of(gyro.map(|read| read - self.bias.gyro_rad_s), dt);
        let angle = turning.until(dt);
        let half = turning.until(0.5 * dt);
        let force = (accel[0] + accel[1]) * 0.5 - self.bias.accel_m_s2;
        let turn = so3::exp(&angle).to_rotation_matrix().into_inner();
        let half_turn = so3::exp(&half);
        let middle = (self.rotation * half_turn)
            .to_rotation_matrix()
            .into_inner();
        let turned_half = half_turn.to_rotation_matrix().into_inner().transpose();
        let force_by_rotation = -middle * so3::hat(&force);
        let turn_by_rate = so3::right_jacobian(&angle) * dt;
        let half_by_rate = so3::right_jacobian(&half) * (0.5 * dt);

        let mut changes = [Vector3::zeros(); 2];
        let places = GAUSS.map(|(share, weight)| {
            let (after_secs, left_secs) = (share * dt, (1.0 - share) * dt);
            let angle = turning.until(after_secs);
            let rotation = (self.rotation * so3::exp(&angle))
                .to_rotation_matrix()
                .into_inner();
            let force = accel[0] + (accel[1] - accel[0]) * share - self.bias.accel_m_s2;
            let velocity = rotation * force * (weight * dt);
            changes[0] += velocity;
            changes[1] += velocity * left_secs;
            GaussPoint {
                secs: weight * dt,
                left_secs,
                turn_by_rate: so3::right_jacobian(&angle) * after_secs,
                turned: so3::exp(&-angle).to_rotation_matrix().into_inner(),
                rotation,
                force_by_rotation: -rotation * so3::hat(&force),
            }
        });
        let piece = Piece {
            secs: dt,
            turn_by_rate,
            turned: turn.transpose(),
            places,
        };
        let ones = Matrix3::identity();
        self.by_bias.advance(&piece, [&ones, &ones]);
        self.by_scale.advance(
            &piece,
            [&scaled_and_sheared(&rate), &scaled_and_sheared(&force)],
        );
        // `exp(-turn) force` is true, of which `turn × force` is missing to first order.
        let turned_back = middle * so3::hat(&force);
        let [velocity, position] = &mut self.by_turn;
        *position += *velocity * dt + turned_back * (0.5 * dt * dt);
        *velocity += turned_back * dt;
        // What is read a delay later is the force of now.
        let gained = middle * (accel[1] - accel[0]);
        let [velocity, position] = &mut self.by_delay;
        *position += *velocity * dt + gained * (0.5 * dt);
        *velocity += gained;

        let mut transition = Matrix9::identity();
        let force_by_start = force_by_rotation * turned_half;
        set(&mut transition, 0, 0, &turn.transpose());
        set(&mut transition, 3, 0, &(force_by_start * dt));
        set(&mut transition, 6, 0, &(force_by_start * (0.5 * dt * dt)));
        set(&mut transition, 6, 3, &(Matrix3::identity() * dt));
        let mut by_noise = SMatrix::<f64, 9, 6>::zeros();
        let force_by_rate = force_by_rotation * half_by_rate;
        let gyro_deviation = noise.gyro_noise_density / dt.sqrt();
        let accel_deviation = noise.accel_noise_density / dt.sqrt();
        for (row, by_gyro, by_accel) in [
            (0, turn_by_rate, Matrix3::zeros()),
            (3, force_by_rate * dt, middle * dt),
            (6, force_by_rate * (0.5 * dt * dt), middle * (0.5 * dt * dt)),
        ] {
            by_noise
                .fixed_view_mut::<3, 3>(row, 0)
                .copy_from(&(by_gyro * gyro_deviation));
            by_noise
                .fixed_view_mut::<3, 3>(row, 3)
                .copy_from(&(by_accel * accel_deviation));
        }
        self.covariance =
            transition * self.covariance * transition.transpose() + by_noise * by_noise.transpose();

        self.position_m += self.velocity_m_s * dt + changes[1];
        self.velocity_m_s += changes[0];
        self.rotation *= so3::exp(&angle);
        self.rotation.renormalize_fast();
        self.duration_secs += dt;
    }

    /// The changes as they would be with another bias. Eq. (44).
    pub fn corrected(&self, bias: &ImuBias) -> CorrectedChange {
        self.corrected_by(bias, &ImuErrors::default())
    }

    /// The same for an IMU with other errors too, whatever the world's scale: exact in the accelerometer's scale and shear, to first order in
    /// the rest.
    pub fn corrected_by(&self, bias: &ImuBias, errors: &ImuErrors) -> CorrectedChange {
        let gyro = bias.gyro_rad_s - self.bias.gyro_rad_s;
        let accel = bias.accel_m_s2 - self.bias.accel_m_s2;
        let (b, s) = (&self.by_bias, &self.by_scale);
        let (gyro_axes, accel_axes) = (errors.gyro_axes(), errors.accel_axes());
        let rotation_correction = b.rotation_by_gyro * gyro + s.rotation_by_gyro * gyro_axes;
        CorrectedChange {
            rotation: self.rotation * so3::exp(&rotation_correction),
            rotation_correction,
            velocity_m_s: self.velocity_m_s
                + b.velocity_by_gyro * gyro
                + b.velocity_by_accel * accel
                + s.velocity_by_gyro * gyro_axes
                + s.velocity_by_accel * accel_axes
                + self.by_turn[0] * errors.accel_turn_rad
                + self.by_delay[0] * errors.accel_delay_s,
            position_m: self.position_m
                + b.position_by_gyro * gyro
                + b.position_by_accel * accel
                + s.position_by_gyro * gyro_axes
                + s.position_by_accel * accel_axes
                + self.by_turn[1] * errors.accel_turn_rad
                + self.by_delay[1] * errors.accel_delay_s,
        }
    }

    /// State at the second instant, given that at the first; gravity is a vector in the world.
    pub fn predict(
        &self,
        start: &NavState,
        bias: &ImuBias,
        gravity_m_s2: &Vector3<f64>,
    ) -> NavState {
        let change = self.corrected(bias);
        let dt = self.duration_secs;
        let rotation = start.world_from_rig.rotation;
        NavState {
            world_from_rig: Se3::new(
                rotation * change.rotation,
                start.world_from_rig.translation
                    + start.velocity_m_s * dt
                    + gravity_m_s2 * (0.5 * dt * dt)
                    + rotation * change.position_m,
            ),
            velocity_m_s: start.velocity_m_s + gravity_m_s2 * dt + rotation * change.velocity_m_s,
        }
    }
}

fn set(matrix: &mut Matrix9, row: usize, column: usize, block: &Matrix3<f64>) {
    matrix.fixed_view_mut::<3, 3>(row, column).copy_from(block);
}

fn check_coverage(readings: &[Reading], start: Timestamp, end: Timestamp) -> Result<(), ImuGap> {
    let gap = |from: Timestamp, to: Timestamp| ImuGap {
        from,
        to,
        longest_secs: LONGEST_PAUSE_SECS,
    };
    if readings.len() < 2 || end <= start {
        return Err(gap(start, end));
    }
    let mut edges = vec![start];
    edges.extend(readings.iter().map(|r| r.time.clamp(start, end)));
    edges.push(end);
    for pair in edges.windows(2) {
        if pair[1].secs_since(pair[0]) > LONGEST_PAUSE_SECS {
            return Err(gap(pair[0], pair[1]));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
