//! Whether the IMU's clock is the LiDAR's: both see the same turns at the same time.
//!
//! A span that begins and ends with different rates has another turn by a gyroscope whose stamps are late. The delay is sought at which gyroscope
//! and scans agree best. What is left of the gyroscope in the poses of the scans draws it towards 0, never away from it.

use lsfb_geometry::Vector3;
use lsfb_perception::statistics::peak;

use super::turns::{MIN_SPANS, Turns, cost, residuals, scatter, weight};

/// Farthest delay that is tried, in steps of so many seconds.
const STEP_S: f64 = 0.02;
const STEPS: i32 = 50;
/// Spans are known no better than this, radians.
const LEAST_SIGMA_RAD: f64 = 5e-4;
/// A delay is found where it is so many standard deviations long, and the squares that it explains are so many.
const SIGMAS: f64 = 6.0;
const LEAST_EXPLAINED: f64 = 36.0;

/// By how much the stamps of the IMU are late.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ClockOff {
    pub late_s: f64,
    /// Its standard deviation.
    pub sigma_s: f64,
}

/// What is off, where it is off for certain.
pub(super) fn clock_off(turns: &Turns) -> Option<ClockOff> {
    let delay_s = |k: i32| f64::from(k) * STEP_S;
    let tried: Vec<_> = (-STEPS..=STEPS)
        .map(|k| residuals(&turns.late(delay_s(k)), |by_gyro| *by_gyro))
        .collect();
    if tried.iter().any(|all| all.len() < MIN_SPANS) {
        return None;
    }
    let sigma = tried.iter().map(|all| scatter(all));
    let sigma = sigma.fold(f64::INFINITY, f64::min);
    let sigma_rad = sigma.max(LEAST_SIGMA_RAD);
    // At each delay a few spans at the ends may be out of the samples.
    let scores: Vec<f64> = tried
        .iter()
        .map(|all| {
            let costs: f64 = all.iter().map(|r| cost(r, sigma_rad)).sum();
            -costs / all.len().max(1) as f64
        })
        .collect();
    let at = peak(&scores)?;
    let late_s = at * STEP_S + delay_s(-STEPS);
    let best = scores.get(at.round() as usize)?;
    let now = scores.get(STEPS as usize)?;
    let is_at_end = at < 0.5 || at > f64::from(2 * STEPS) - 0.5;
    let left = residuals(&turns.late(late_s), |by_gyro| *by_gyro);
    let information: f64 = slopes(turns, late_s)
        .zip(&left)
        .map(|(slope, r)| slope.norm_squared() * weight(r, sigma_rad))
        .sum();
    let sigma_s = information.sqrt().recip();
    let explained = (best - now) * tried[STEPS as usize].len() as f64;
    let is_off = late_s.abs() > SIGMAS * sigma_s && explained > LEAST_EXPLAINED && !is_at_end;
    is_off.then_some(ClockOff { late_s, sigma_s })
}

/// What a second of delay changes of each span's turn, rad/s.
fn slopes(turns: &Turns, late_s: f64) -> impl Iterator<Item = Vector3<f64>> {
    let before = turns.late(late_s - 0.5 * STEP_S);
    let after = turns.late(late_s + 0.5 * STEP_S);
    let pairs = before.into_iter().zip(after);
    pairs.map(|(a, b)| (b.by_gyro - a.by_gyro) / STEP_S)
}
