//! A carrier that stands at the start: its velocity is none, and its gyroscope shows its bias. Without that a map of one scan draws it about by
//! its own noise.

use lsfb_geometry::{Matrix6, Vector3, Vector6};
use lsfb_types::{ImuSample, Stamped};
use nalgebra::SMatrix;

use super::reading::Reading;
use super::{InertialFilter, Matrix18, VELOCITY};

/// Means over this long tell whether it still stands, seconds.
pub(super) const STANDING_SPAN_S: f64 = 0.1;
/// Means that differ from those at the start by more than this are the first step, rad/s and m/s².
const STANDING_RATE_RAD_S: f64 = 0.03;
const STANDING_FORCE_M_S2: f64 = 0.2;
/// Nearer to the start than this, nothing has begun yet: what grows to the first step is no bias.
const QUIET_RATE_RAD_S: f64 = 0.015;
const QUIET_FORCE_M_S2: f64 = 0.08;
/// Who stands sways by so much, m/s, and turns by so much, rad/s, until means over spans have told how much it is.
pub(super) const STANDING_VELOCITY_M_S: f64 = 0.01;
pub(super) const STANDING_GYRO_RAD_S: f64 = 0.003;
/// As many spans that turned by that are taken to have been before the first.
const SPANS_BEFORE: f64 = 1.0;
/// Of the velocity of a carrier that was taken for standing and was not, m/s.
const UNFELT_VELOCITY_M_S: f64 = 0.3;

/// Mean angular velocity and specific force of a carrier that stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Standing {
    pub angular_velocity: Vector3<f64>,
    pub specific_force: Vector3<f64>,
    /// Spans since, the mean of their angular velocities, and the sum of the squares of what these are off it.
    spans: f64,
    mean_rad_s: Vector3<f64>,
    off_squares: f64,
}

impl Standing {
    /// As it felt at the start.
    pub fn new(angular_velocity: Vector3<f64>, specific_force: Vector3<f64>) -> Self {
        Self {
            angular_velocity,
            specific_force,
            spans: 0.0,
            mean_rad_s: Vector3::zeros(),
            off_squares: 0.0,
        }
    }

    /// How far the mean angular velocity of a span is from the gyroscope's bias, rad/s: by its noise, and by who stands and sways. Told by how these
    /// means scatter, this one included: people sway more than tripods, and a poor gyroscope is noisier than they sway. Who sways to and fro comes
    /// back, so that means over long are known no worse than if each span were by chance.
    fn sway_rad_s(&mut self, turn: &Vector3<f64>) -> f64 {
        self.spans += 1.0;
        let off = turn - self.mean_rad_s;
        self.mean_rad_s += off / self.spans;
        self.off_squares += off.dot(&(turn - self.mean_rad_s));
        // Of three components each.
        let before = 3.0 * SPANS_BEFORE;
        let after = 3.0 * (self.spans - 1.0);
        let squares = before * STANDING_GYRO_RAD_S.powi(2) + self.off_squares;
        (squares / (before + after)).sqrt()
    }

    /// Whether means over samples are still the same.
    fn goes_on(&self, (angular_velocity, specific_force): (Vector3<f64>, Vector3<f64>)) -> bool {
        (angular_velocity - self.angular_velocity).norm() < STANDING_RATE_RAD_S
            && (specific_force - self.specific_force).norm() < STANDING_FORCE_M_S2
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

    /// Takes in that it stands, where the samples ahead feel like it.
    pub(super) fn rest(&mut self, samples: &[Stamped<ImuSample>]) {
        let Some(mut standing) = self.standing.filter(|_| !samples.is_empty()) else {
            return;
        };
        let n = samples.len() as f64;
        let readings = || samples.iter().map(Reading::from);
        let turn = readings().map(|r| r.angular_velocity).sum::<Vector3<f64>>() / n;
        let force = readings().map(|r| r.specific_force).sum::<Vector3<f64>>() / n;
        if !standing.goes_on((turn, force)) {
            self.standing = None;
            return;
        }
        let bias_off = turn - self.state.gyro_bias_rad_s;
        if bias_off.norm() > QUIET_RATE_RAD_S
            || (force - standing.specific_force).norm() > QUIET_FORCE_M_S2
        {
            return;
        }
        let sway_rad_s = standing.sway_rad_s(&turn);
        self.standing = Some(standing);
        let mut off = Vector6::zeros();
        let velocity_off = -self.state.velocity_m_s;
        off.fixed_rows_mut::<3>(0).copy_from(&velocity_off);
        off.fixed_rows_mut::<3>(3).copy_from(&bias_off);
        if let Some((delta, covariance)) = measured(&self.covariance, &off, sway_rad_s) {
            self.covariance = covariance;
            self.state.add(&delta);
        }
        if let Some((_, covariance)) = measured(&self.reported, &off, sway_rad_s) {
            self.reported = covariance;
        }
    }
}

/// What measured velocity and gyroscope bias, `off` from those estimated, the latter known to `sway_rad_s`, change of the state, and its
/// covariance then.
fn measured(
    covariance: &Matrix18,
    off: &Vector6<f64>,
    sway_rad_s: f64,
) -> Option<(SMatrix<f64, 18, 1>, Matrix18)> {
    let (v, w) = (STANDING_VELOCITY_M_S.powi(2), sway_rad_s.powi(2));
    let noise = Matrix6::from_diagonal(&Vector6::new(v, v, v, w, w, w));
    let all = covariance.fixed_columns::<6>(VELOCITY);
    let measured: Matrix6<f64> = covariance.fixed_view::<6, 6>(VELOCITY, VELOCITY).into();
    let gain = all * (measured + noise).cholesky()?.inverse();
    let after = covariance - gain * all.transpose();
    Some((gain * off, (after + after.transpose()) * 0.5))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Naively everybody was taken to sway by the same: who stood on a tripod was said to have turned by a third of a degree in a minute.
    #[test]
    fn how_much_one_sways_is_told_by_the_spans() {
        for usual_rad_s in [0.0005, 0.01] {
            let mut standing = Standing::new(Vector3::zeros(), Vector3::zeros());
            let bias = Vector3::new(0.02, -0.01, 0.005);
            let mut sway_rad_s = 0.0;
            for k in 0..20 {
                // As often this way as that way, each axis at a pace of its own.
                let signs = Vector3::new(2, 3, 5).map(|n| f64::from(k % (2 * n) / n));
                let off = signs.map(|sign| usual_rad_s * (2.0 * sign - 1.0));
                sway_rad_s = standing.sway_rad_s(&(bias + off));
                if k == 0 {
                    assert!(
                        (sway_rad_s - STANDING_GYRO_RAD_S).abs() < 1e-9,
                        "{sway_rad_s}"
                    );
                }
            }
            // What it began with is a twentieth of it.
            let expected = usual_rad_s.hypot(STANDING_GYRO_RAD_S / 20f64.sqrt());
            let share = sway_rad_s / expected;
            assert!(
                (0.85..1.15).contains(&share),
                "{sway_rad_s} for {usual_rad_s}"
            );
        }
    }
}
