//! A camera against the gyroscope: when, and turned how.
//!
//! Between two images a camera turns with `ω`; the gyroscope, which is turned by `R` and reads `τ` later, says `R ω̄(t + τ) + b`.
//! Rotation, bias and time offset are found over all pairs of images, each weighed by what it knows of the three axes.
//! Standard deviations come from leaving out a tenth of the recording at a time: errors of neighbouring pairs are
//! not independent, and what a tenth more or less changes is what another recording would.

use lsfb_geometry::{Matrix3, UnitQuaternion, Vector3, so3};
use nalgebra::{Rotation3, SMatrix, SVector};

use super::frame::{Frame, register};
use super::gyro::Gyro;
use super::relative::relative;
use super::tracks::follow;

/// Offsets searched, seconds.
const REACH_S: f64 = 0.15;
const STEP_S: f64 = 0.002;
/// Spread of the angular velocity about the second most used axis that a rotation needs, rad/s.
const MIN_TURNING: f64 = 0.04;
/// Pairs of images needed.
const MIN_PAIRS: usize = 30;
/// What the gyroscope and the integration over a pair err by, rad/s.
const FLOOR_RAD_S: f64 = 1.5e-3;
/// Normalized errors at which the weight of a pair is halved.
const ROBUST_SCALE: f64 = 3.0;
const ITERATIONS: usize = 10;
/// Parts of the recording that are left out in turn.
const PARTS: usize = 10;
/// Span over which the gyroscope's rate of change is read, seconds.
const SLOPE_S: f64 = 0.005;

/// A camera's angular velocity between two images.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    pub from_s: f64,
    pub to_s: f64,
    /// In the camera, rad/s.
    pub rate: Vector3<f64>,
    /// What is not known of it, (rad/s)².
    pub covariance: Matrix3<f64>,
}

/// What the gyroscope says of a camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    /// To be added to the camera's times beyond what the rig says, seconds.
    pub offset_s: f64,
    pub offset_sigma_s: f64,
    /// Rotation of the rig in the camera.
    pub camera_from_rig: UnitQuaternion<f64>,
    pub rotation_sigma_rad: f64,
    pub pairs: usize,
    /// Root mean square of the angular velocity, rad/s.
    pub rate_rad_s: f64,
}

/// Why nothing can be said.
pub(super) enum Silent {
    TooFewPairs(usize),
    TooLittleTurning(f64),
    EndOfSearch(f64),
}

/// Angular velocity between two images; `None` where they do not fit.
pub(super) fn turn(a: &Frame, b: &Frame) -> Option<Turn> {
    let span_s = b.time_s - a.time_s;
    if span_s <= 0.0 {
        return None;
    }
    let guess = register(a, b)?;
    let found = relative(&follow(a, b, &guess), &guess)?;
    Some(Turn {
        from_s: a.time_s,
        to_s: b.time_s,
        rate: -so3::log(&found.b_from_a) / span_s,
        covariance: found.information.try_inverse()? / (span_s * span_s),
    })
}

/// Compares turns with the gyroscope; times of the turns are those the rig says.
pub(super) fn agree(turns: &[Turn], gyro: &Gyro) -> Result<Agreement, Silent> {
    let usable: Vec<Turn> = turns
        .iter()
        .filter(|t| {
            gyro.angle(t.from_s - 1.1 * REACH_S).is_some()
                && gyro.angle(t.to_s + 1.1 * REACH_S).is_some()
        })
        .copied()
        .collect();
    if usable.len() < MIN_PAIRS {
        return Err(Silent::TooFewPairs(usable.len()));
    }
    let (start, kept) = coarse(usable, gyro);
    if kept.len() < MIN_PAIRS {
        return Err(Silent::TooFewPairs(kept.len()));
    }
    if start.offset_s.abs() > REACH_S - 2.0 * STEP_S {
        return Err(Silent::EndOfSearch(start.offset_s));
    }
    let rates: Vec<Vector3<f64>> = kept.iter().map(|t| start.rate(t, gyro)).collect();
    let second = second_turning(&rates);
    if second < MIN_TURNING {
        return Err(Silent::TooLittleTurning(second));
    }
    let all: Vec<&Turn> = kept.iter().collect();
    let found = start.refined(&all, gyro);
    let part = |k: usize| k * PARTS / kept.len();
    let parts: Vec<Fit> = (0..PARTS)
        .map(|left_out| {
            let rest: Vec<&Turn> = kept
                .iter()
                .enumerate()
                .filter(|(k, _)| part(*k) != left_out)
                .map(|k| k.1)
                .collect();
            found.refined(&rest, gyro)
        })
        .collect();
    // The jackknife's variance.
    let grown = (PARTS - 1) as f64 / PARTS as f64;
    let mean_s = parts.iter().map(|p| p.offset_s).sum::<f64>() / PARTS as f64;
    let times = parts.iter().map(|p| (p.offset_s - mean_s).powi(2));
    let turned = |p: &Fit| so3::log(&(p.camera_from_rig * found.camera_from_rig.inverse()));
    let mean = parts.iter().map(turned).sum::<Vector3<f64>>() / PARTS as f64;
    let angles = parts.iter().map(|p| (turned(p) - mean).norm_squared());
    let squares = rates.iter().map(Vector3::norm_squared).sum::<f64>();
    Ok(Agreement {
        offset_s: found.offset_s,
        offset_sigma_s: (grown * times.sum::<f64>()).sqrt(),
        camera_from_rig: found.camera_from_rig,
        rotation_sigma_rad: (grown * angles.sum::<f64>()).sqrt(),
        pairs: kept.len(),
        rate_rad_s: (squares / rates.len() as f64).sqrt(),
    })
}

/// Spread of angular velocities about the second most used axis, rad/s.
fn second_turning(rates: &[Vector3<f64>]) -> f64 {
    let squares: Matrix3<f64> = rates.iter().map(|r| r * r.transpose()).sum();
    let mut spread: Vec<f64> = (squares / rates.len().max(1) as f64)
        .symmetric_eigenvalues()
        .iter()
        .copied()
        .collect();
    spread.sort_by(f64::total_cmp);
    spread[1].max(0.0).sqrt()
}

/// The best of a grid of offsets, and the pairs that fit there.
fn coarse(mut kept: Vec<Turn>, gyro: &Gyro) -> (Fit, Vec<Turn>) {
    let mut best = Fit::at(&kept, gyro, 0.0);
    for round in 0..2 {
        let steps = (REACH_S / STEP_S).round() as i32;
        let mut least = best.cost(&kept, gyro);
        for k in -steps..=steps {
            let fit = Fit::at(&kept, gyro, f64::from(k) * STEP_S);
            let cost = fit.cost(&kept, gyro);
            if cost < least {
                (best, least) = (fit, cost);
            }
        }
        if round == 0 {
            // Pairs that do not fit: something walked by.
            let errors: Vec<f64> = kept.iter().map(|t| best.error(t, gyro).norm()).collect();
            let mut sorted = errors.clone();
            sorted.sort_by(f64::total_cmp);
            let limit = 5.0 * sorted[sorted.len() / 2];
            let mut flags = errors.iter().map(|e| *e <= limit);
            kept.retain(|_| flags.next().unwrap_or(false));
            best = Fit::at(&kept, gyro, best.offset_s);
        }
    }
    (best, kept)
}

/// Rotation, bias and time offset.
#[derive(Clone, Copy)]
struct Fit {
    offset_s: f64,
    camera_from_rig: UnitQuaternion<f64>,
    bias: Vector3<f64>,
}

impl Fit {
    /// The best rotation and bias at one offset, all pairs alike.
    fn at(turns: &[Turn], gyro: &Gyro, offset_s: f64) -> Self {
        let mut fit = Self {
            offset_s,
            camera_from_rig: UnitQuaternion::identity(),
            bias: Vector3::zeros(),
        };
        let n = turns.len() as f64;
        let rates: Vec<Vector3<f64>> = turns.iter().map(|t| fit.rate(t, gyro)).collect();
        let mean_gyro = rates.iter().sum::<Vector3<f64>>() / n;
        let mean_seen = turns.iter().map(|t| t.rate).sum::<Vector3<f64>>() / n;
        let mut covariance = Matrix3::zeros();
        for (turn, rate) in turns.iter().zip(&rates) {
            covariance += (turn.rate - mean_seen) * (rate - mean_gyro).transpose();
        }
        let svd = covariance.svd(true, true);
        let rotation = match (svd.u, svd.v_t) {
            (Some(u), Some(v_t)) => {
                let mut sign = Vector3::repeat(1.0);
                sign[svd.singular_values.imin()] = (u * v_t).determinant().signum();
                u * Matrix3::from_diagonal(&sign) * v_t
            }
            _ => Matrix3::identity(),
        };
        fit.camera_from_rig =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        fit.bias = mean_seen - fit.camera_from_rig * mean_gyro;
        fit
    }

    /// Of the gyroscope over a pair, in its own axes.
    fn rate(&self, turn: &Turn, gyro: &Gyro) -> Vector3<f64> {
        let span = gyro.mean_rate(turn.from_s + self.offset_s, turn.to_s + self.offset_s);
        // Turns near the ends of the gyroscope's samples were left out before.
        span.unwrap_or_default()
    }

    fn error(&self, turn: &Turn, gyro: &Gyro) -> Vector3<f64> {
        turn.rate - self.camera_from_rig * self.rate(turn, gyro) - self.bias
    }

    fn cost(&self, turns: &[Turn], gyro: &Gyro) -> f64 {
        let errors = turns.iter().map(|t| self.error(t, gyro));
        errors.map(|e| e.norm_squared()).sum()
    }

    /// Down to the minimum, each pair with its own weight.
    fn refined(&self, turns: &[&Turn], gyro: &Gyro) -> Self {
        let mut fit = *self;
        let floor = Matrix3::identity() * (FLOOR_RAD_S * FLOOR_RAD_S);
        let weights: Vec<Matrix3<f64>> = turns
            .iter()
            .filter_map(|t| (t.covariance + floor).try_inverse())
            .collect();
        if weights.len() < turns.len() {
            return fit;
        }
        for _ in 0..ITERATIONS {
            let mut normal = SMatrix::<f64, 7, 7>::zeros();
            let mut right = SVector::<f64, 7>::zeros();
            for (turn, information) in turns.iter().zip(&weights) {
                let error = fit.error(turn, gyro);
                let size = (error.transpose() * information * error)[0];
                let weight = information / (1.0 + size / (ROBUST_SCALE * ROBUST_SCALE));
                let turned = fit.camera_from_rig * fit.rate(turn, gyro);
                let sooner = Self {
                    offset_s: fit.offset_s - SLOPE_S,
                    ..fit
                };
                let later = Self {
                    offset_s: fit.offset_s + SLOPE_S,
                    ..fit
                };
                let slope = (later.error(turn, gyro) - sooner.error(turn, gyro)) / (2.0 * SLOPE_S);
                let mut by = SMatrix::<f64, 3, 7>::zeros();
                // exp(φ) R ω moves by φ × R ω.
                by.fixed_columns_mut::<3>(0).copy_from(&so3::hat(&turned));
                by.fixed_columns_mut::<3>(3)
                    .copy_from(&-Matrix3::identity());
                by.set_column(6, &slope);
                normal += by.transpose() * weight * by;
                right -= by.transpose() * weight * error;
            }
            let Some(step) = normal.cholesky().map(|c| c.solve(&right)) else {
                break;
            };
            fit.camera_from_rig = so3::exp(&step.fixed_rows::<3>(0).into()) * fit.camera_from_rig;
            fit.bias += step.fixed_rows::<3>(3);
            fit.offset_s = (fit.offset_s + step[6]).clamp(-REACH_S, REACH_S);
            if step.norm() < 1e-9 {
                break;
            }
        }
        fit
    }
}
