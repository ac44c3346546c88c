//! A camera against the gyroscope: when, and turned how.
//!
//! Between two images a camera turns with `ω`; the gyroscope, which is turned by `R` and reads `τ` later, says `R ω̄(t + τ) + b`.
//! Rotation, bias and time offset are found over all pairs of images, each weighed by what it knows of the three axes.
//! Pairs follow each other without overlap. Standard deviations come from how unlike the seconds of the recording are: what they pull
//! by at the minimum, summed as squares.

use std::collections::BTreeMap;

use lsfb_geometry::IntegratedGyro;
use lsfb_geometry::{Matrix3, RigCamera, UnitQuaternion, Vector3, so3};
use lsfb_perception::image::{Pair, relative_rotation};
use lsfb_perception::statistics::median;
use lsfb_solver::gauss_newton::{NormalEquations, minimise, until_shorter_than};
use nalgebra::{SMatrix, SVector, Vector1};
use rayon::prelude::*;

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
const ITERATIONS: u32 = 10;
/// A step shorter than this ends the search: radians, rad/s, seconds.
const SHORTEST: f64 = 1e-9;
/// Span in which errors of pairs may depend on each other, seconds.
const BLOCK_S: f64 = 1.0;
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
pub(super) enum Inconclusive {
    TooFewPairs(usize),
    TooLittleTurning(f64),
    EndOfSearch(f64),
}

/// How a camera turned over each pair; those in which it cannot be told are left out.
fn turns(pairs: &[Pair], mounted: &RigCamera, gyro: &IntegratedGyro) -> Vec<Turn> {
    let camera_from_rig = mounted.rig_from_camera.rotation.inverse();
    let found = pairs.par_iter().map(|pair| {
        let span_s = pair.to_s - pair.from_s;
        let rate = gyro.mean_rate(pair.from_s, pair.to_s)?;
        // Of two answers the one beside the gyroscope's is right; that of the images as a whole serves where the rig is wrong.
        let expected = so3::exp(&(camera_from_rig * rate * -span_s));
        let found = relative_rotation(&pair.tracks, &[expected, pair.b_from_a])?;
        Some(Turn {
            from_s: pair.from_s,
            to_s: pair.to_s,
            rate: -so3::log(&found.b_from_a) / span_s,
            covariance: found.information.try_inverse()? / (span_s * span_s),
        })
    });
    found.collect::<Vec<_>>().into_iter().flatten().collect()
}

/// Compares pairs of images with the gyroscope; their times are those the rig says.
pub(super) fn agree(
    pairs: &[Pair],
    mounted: &RigCamera,
    gyro: &IntegratedGyro,
) -> Result<Agreement, Inconclusive> {
    let usable: Vec<Turn> = turns(pairs, mounted, gyro)
        .into_iter()
        .filter(|t| {
            gyro.angle(t.from_s - 1.1 * REACH_S).is_some()
                && gyro.angle(t.to_s + 1.1 * REACH_S).is_some()
        })
        .collect();
    if usable.len() < MIN_PAIRS {
        return Err(Inconclusive::TooFewPairs(usable.len()));
    }
    let (start, kept) = coarse(usable, gyro);
    if kept.len() < MIN_PAIRS {
        return Err(Inconclusive::TooFewPairs(kept.len()));
    }
    if start.offset_s.abs() > REACH_S - 2.0 * STEP_S {
        return Err(Inconclusive::EndOfSearch(start.offset_s));
    }
    let rates: Vec<Vector3<f64>> = kept.iter().map(|t| start.rate(t, gyro)).collect();
    let second = second_turning(&rates);
    if second < MIN_TURNING {
        return Err(Inconclusive::TooLittleTurning(second));
    }
    let (found, normal) = start
        .refined(&kept, gyro)
        .ok_or(Inconclusive::TooLittleTurning(second))?;
    if found.offset_s.abs() > REACH_S {
        return Err(Inconclusive::EndOfSearch(found.offset_s));
    }
    let covariance = found
        .covariance(&kept, gyro, &normal)
        .ok_or(Inconclusive::TooLittleTurning(second))?;
    let squares = rates.iter().map(Vector3::norm_squared).sum::<f64>();
    Ok(Agreement {
        offset_s: found.offset_s,
        offset_sigma_s: covariance[(6, 6)].sqrt(),
        camera_from_rig: found.camera_from_rig,
        rotation_sigma_rad: covariance.fixed_view::<3, 3>(0, 0).trace().sqrt(),
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
fn coarse(mut kept: Vec<Turn>, gyro: &IntegratedGyro) -> (Fit, Vec<Turn>) {
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
            let limit = 5.0 * median(errors.clone()).unwrap_or(f64::INFINITY);
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
    fn at(turns: &[Turn], gyro: &IntegratedGyro, offset_s: f64) -> Self {
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
        fit.camera_from_rig = so3::nearest(&covariance).unwrap_or_else(UnitQuaternion::identity);
        fit.bias = mean_seen - fit.camera_from_rig * mean_gyro;
        fit
    }

    /// Of the gyroscope over a pair, in its own axes.
    fn rate(&self, turn: &Turn, gyro: &IntegratedGyro) -> Vector3<f64> {
        let span = gyro.mean_rate(turn.from_s + self.offset_s, turn.to_s + self.offset_s);
        // Turns near the ends of the gyroscope's samples were left out before.
        span.unwrap_or_default()
    }

    fn error(&self, turn: &Turn, gyro: &IntegratedGyro) -> Vector3<f64> {
        turn.rate - self.camera_from_rig * self.rate(turn, gyro) - self.bias
    }

    fn cost(&self, turns: &[Turn], gyro: &IntegratedGyro) -> f64 {
        let errors = turns.iter().map(|t| self.error(t, gyro));
        errors.map(|e| e.norm_squared()).sum()
    }

    /// A pair's error in units of what is not known of it, and how it moves with rotation, bias and offset.
    fn term(&self, turn: &Turn, gyro: &IntegratedGyro) -> Option<NormalEquations<7>> {
        let floor = Matrix3::identity() * (FLOOR_RAD_S * FLOOR_RAD_S);
        let information = (turn.covariance + floor).try_inverse()?;
        let error = self.error(turn, gyro);
        let at = |offset_s: f64| Self { offset_s, ..*self }.error(turn, gyro);
        let slope = at(self.offset_s + SLOPE_S) - at(self.offset_s - SLOPE_S);
        let mut by = SMatrix::<f64, 3, 7>::zeros();
        // R exp(φ) ω moves by R (φ × ω).
        let rotation = self.camera_from_rig.to_rotation_matrix().into_inner();
        let by_turn = rotation * so3::hat(&self.rate(turn, gyro));
        by.fixed_columns_mut::<3>(0).copy_from(&by_turn);
        by.fixed_columns_mut::<3>(3)
            .copy_from(&-Matrix3::identity());
        by.set_column(6, &(slope / (2.0 * SLOPE_S)));
        let size = (error.transpose() * information * error)[0];
        let weight = information / (1.0 + size / (ROBUST_SCALE * ROBUST_SCALE));
        Some(NormalEquations {
            information: by.transpose() * weight * by,
            gradient: by.transpose() * weight * error,
        })
    }

    /// Down to the minimum, each pair with its own weight; with the information there.
    fn refined(&self, turns: &[Turn], gyro: &IntegratedGyro) -> Option<(Self, Matrix7)> {
        let terms = |unknowns: &Unknowns| {
            let fit = Self::of(unknowns);
            let mut all = NormalEquations::default();
            for term in turns.iter().filter_map(|t| fit.term(t, gyro)) {
                all.add_all(&term);
            }
            Some(all)
        };
        let start = (
            (self.camera_from_rig, self.bias),
            Vector1::new(self.offset_s),
        );
        let found = minimise(start, ITERATIONS, terms, until_shorter_than(SHORTEST))?;
        Some((Self::of(&found.value), found.information))
    }

    fn of(((camera_from_rig, bias), offset_s): &Unknowns) -> Self {
        Self {
            offset_s: offset_s.x,
            camera_from_rig: *camera_from_rig,
            bias: *bias,
        }
    }

    /// From how much blocks of the recording pull: errors of neighbouring pairs need not be independent.
    fn covariance(
        &self,
        turns: &[Turn],
        gyro: &IntegratedGyro,
        normal: &Matrix7,
    ) -> Option<Matrix7> {
        let mut blocks = BTreeMap::<i64, Vector7>::new();
        for turn in turns {
            let block = (turn.from_s / BLOCK_S).floor() as i64;
            *blocks.entry(block).or_default() += self.term(turn, gyro)?.gradient;
        }
        let pulls: Matrix7 = blocks.values().map(|p| p * p.transpose()).sum();
        let n = blocks.len() as f64;
        let inverse = normal.try_inverse()?;
        // As many blocks fewer as numbers are found from the three axes of each.
        (n > 4.0).then(|| inverse * pulls * inverse * (n / (n - 7.0 / 3.0)))
    }
}

type Matrix7 = SMatrix<f64, 7, 7>;
type Vector7 = SVector<f64, 7>;
/// Rotation, bias and time offset, in the order of their tangents.
type Unknowns = ((UnitQuaternion<f64>, Vector3<f64>), Vector1<f64>);
