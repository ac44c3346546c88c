//! A carrier that stands at the start: its velocity is none, and its gyroscope shows its bias. Without that a map of one scan draws it about by
//! its own noise.

use lsfb_geometry::{Matrix6, Vector3, Vector6};
use lsfb_types::{ImuSample, Stamped, Timestamp};
use nalgebra::SMatrix;

use super::{InertialFilter, Matrix18, VELOCITY};
use lsfb_perception::imu::Reading;

/// Means over this long tell whether it still stands, seconds.
pub(super) const STANDING_SPAN_S: f64 = 0.1;
/// Means that differ from those at the start by more than this are the first step, rad/s and m/s².
const STANDING_RATE_RAD_S: f64 = 0.03;
const STANDING_FORCE_M_S2: f64 = 0.2;
/// Nearer to the start than this, nothing has begun yet: what grows to the first step is no bias.
const QUIET_RATE_RAD_S: f64 = 0.015;
const QUIET_FORCE_M_S2: f64 = 0.08;
/// Who stands sways by so much, m/s, and turns by so much, rad/s.
pub(super) const STANDING_VELOCITY_M_S: f64 = 0.012;
pub(super) const STANDING_GYRO_RAD_S: f64 = 0.006;
/// How far it is from upright then, radians, and from where it stands, at the height of a back and upwards, metres (standard deviations). So a mean
/// rate or velocity over `T` s is off by √2 of that in `T`. The centre of mass of people moves by 3 to 5 mm forwards and back, and less sideways.
const SWAY_RAD: f64 = 0.003;
const SWAY_M: [f64; 3] = [0.0045, 0.0045, 0.001];
/// Of the velocity of a carrier that was taken for standing and was not, m/s.
const UNFELT_VELOCITY_M_S: f64 = 0.3;

/// Mean angular velocity of a carrier that stands, and specific force in the world: in its own axes it would change with each lean of who sways.
#[derive(Clone, Copy, Debug)]
pub(super) struct Standing {
    pub angular_velocity: Vector3<f64>,
    pub force_in_world: Vector3<f64>,
    /// Integral of the measured angular velocity since the start, and over how long it was measured: not over pauses of the IMU.
    pub turned_rad: Vector3<f64>,
    pub secs: f64,
}

impl Standing {
    /// Whether means over samples are still the same.
    fn goes_on(&self, (angular_velocity, force_in_world): (Vector3<f64>, Vector3<f64>)) -> bool {
        (angular_velocity - self.angular_velocity).norm() < STANDING_RATE_RAD_S
            && (force_in_world - self.force_in_world).norm() < STANDING_FORCE_M_S2
    }

    /// Takes in the mean angular velocity over a span. Gives what, measured in each span with the standard deviation below, adds up to the plain mean
    /// since the start: half of that mean and half of this span's.
    ///
    /// That standard deviation goes by how far the carrier sways, 1/s: the mean over `T` s is off by √2 of that in `T`; of the inverse square this is
    /// the span's part.
    fn measured_rate(&mut self, turn: Vector3<f64>, span_s: f64) -> (Vector3<f64>, f64) {
        self.turned_rad += turn * span_s;
        self.secs += span_s;
        let rate = 0.5 * (self.turned_rad / self.secs + turn);
        let stood_s = self.secs.max(STANDING_SPAN_S);
        (rate, 1.0 / (stood_s * span_s).sqrt())
    }
}

impl InertialFilter {
    /// Whether it has not moved since the start, as far as an IMU can tell.
    pub fn stands(&self) -> bool {
        self.standing.is_some()
    }

    /// Takes it that it no longer stands, though it feels nothing.
    pub fn stands_no_more(&mut self) {
        if self.standing.take().is_some() {
            let variance = UNFELT_VELOCITY_M_S * UNFELT_VELOCITY_M_S;
            for covariance in [&mut self.covariance, &mut self.reported] {
                for k in VELOCITY..VELOCITY + 3 {
                    covariance[(k, k)] += variance;
                }
            }
        }
    }

    /// Takes in that it stands, where the samples ahead, up to some time, feel like it.
    pub(super) fn rest(&mut self, samples: &[Stamped<ImuSample>], until: Timestamp) {
        let Some(mut standing) = self.standing.filter(|_| !samples.is_empty()) else {
            return;
        };
        let n = samples.len() as f64;
        let readings = || samples.iter().map(Reading::from);
        let turn = readings().map(|r| r.angular_velocity).sum::<Vector3<f64>>() / n;
        let force = readings().map(|r| r.specific_force).sum::<Vector3<f64>>() / n;
        let force = self.state.world_from_rig.rotation * force;
        if !standing.goes_on((turn, force)) {
            self.standing = None;
            return;
        }
        if (turn - self.state.gyro_bias_rad_s).norm() > QUIET_RATE_RAD_S
            || (force - standing.force_in_world).norm() > QUIET_FORCE_M_S2
        {
            return;
        }
        let span_s = until.secs_since(self.time).clamp(1e-3, STANDING_SPAN_S);
        let (rate, per_sway) = standing.measured_rate(turn, span_s);
        self.standing = Some(standing);
        let bias_off = rate - self.state.gyro_bias_rad_s;
        let mut off = Vector6::zeros();
        let velocity_off = -self.state.velocity_m_s;
        off.fixed_rows_mut::<3>(0).copy_from(&velocity_off);
        off.fixed_rows_mut::<3>(3).copy_from(&bias_off);
        if let Some((delta, covariance)) = measured(&self.covariance, &off, per_sway) {
            self.covariance = covariance;
            self.state.add(&delta);
        }
        if let Some((_, covariance)) = measured(&self.reported, &off, per_sway) {
            self.reported = covariance;
        }
    }
}

/// What measured velocity and gyroscope bias, `off` from those estimated, change of the state, and its covariance then.
fn measured(
    covariance: &Matrix18,
    off: &Vector6<f64>,
    per_sway: f64,
) -> Option<(SMatrix<f64, 18, 1>, Matrix18)> {
    let [x, y, z] = SWAY_M;
    let sway = Vector6::new(x, y, z, SWAY_RAD, SWAY_RAD, SWAY_RAD) * per_sway;
    let noise = Matrix6::from_diagonal(&sway.component_mul(&sway));
    let all = covariance.fixed_columns::<6>(VELOCITY);
    let measured: Matrix6<f64> = covariance.fixed_view::<6, 6>(VELOCITY, VELOCITY).into();
    let gain = all * (measured + noise).cholesky()?.inverse();
    let after = covariance - gain * all.transpose();
    Some((gain * off, (after + after.transpose()) * 0.5))
}
