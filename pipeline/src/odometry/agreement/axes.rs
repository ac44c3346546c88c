//! Whether the axes of gyroscope and accelerometer are those of the rig.
//!
//! Of the 48 ways in which three axes can be exchanged and turned round, the one that a sensor has must fit the scans best. A rig that is right by its word
//! is told from a wrong one by how much better another fits, and not by how well it fits itself: how well an IMU and scans fit at all is
//! different for each. A carrier that hardly moves does not tell, and then all fit alike. An IMU that hangs upside down is right as long as its rig says so.

use lsfb_geometry::{Matrix6, Vector3, Vector6};
use lsfb_solver::gauss_newton::{Next, NormalEquations, minimise};
use nalgebra::Matrix3x6;

use super::triples::Triple;
use super::turns::{MIN_SPANS, Turns, cost, residuals, scatter, weight};
use crate::odometry::OdometryWarning;

/// Another way is taken for the right one where it explains so many more squares, and so many times as much.
const LEAST_EXPLAINED: f64 = 16.0;
const LEAST_RATIO: f64 = 1.3;
/// Turns and accelerations are known no better than this: radians and m/s².
const LEAST_SIGMA_RAD: f64 = 5e-4;
const LEAST_SIGMA_M_S2: f64 = 0.01;
/// Fewer triples of scans tell nothing, more tell no more.
const MIN_TRIPLES: usize = 8;
const MAX_TRIPLES: usize = 1000;
/// Each scan is in so many triples.
const SHARED: f64 = 6.0;
/// An accelerometer's bias, and the attitude of the scans against gravity as such, m/s².
const BIAS_M_S2: f64 = 0.2;
/// Gravity beforehand, m/s²: nothing is known.
const GRAVITY_M_S2: f64 = 1e3;
const ROUNDS: u32 = 8;
/// Forces that differ by less are the same, m/s².
const OTHER_M_S2: f64 = 0.1;

/// Which of a sensor's axes, and with which sign, is each axis of the rig.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Arrangement {
    axes: [usize; 3],
    signs: [f64; 3],
}

/// As a sensor should be.
const AS_IT_IS: Arrangement = Arrangement {
    axes: [0, 1, 2],
    signs: [1.0; 3],
};

/// A sensor of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sensor {
    Gyroscope,
    Accelerometer,
}

/// Axes that are not as they should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WrongAxes {
    right: Arrangement,
}

impl Arrangement {
    fn all() -> impl Iterator<Item = Self> {
        const ORDERS: [[usize; 3]; 6] = [
            [0, 1, 2],
            [1, 2, 0],
            [2, 0, 1],
            [0, 2, 1],
            [2, 1, 0],
            [1, 0, 2],
        ];
        let sign = |bits: u32, axis: u32| if bits >> axis & 1 == 1 { -1.0 } else { 1.0 };
        ORDERS.into_iter().flat_map(move |axes| {
            (0..8).map(move |bits| Self {
                axes,
                signs: [sign(bits, 0), sign(bits, 1), sign(bits, 2)],
            })
        })
    }

    /// Whether a right hand becomes a left one.
    fn is_mirror(&self) -> bool {
        let [a, b, _] = self.axes;
        let is_odd = (a + 1) % 3 != b;
        is_odd != (self.signs.iter().product::<f64>() < 0.0)
    }

    fn apply(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let of = |k: usize| self.signs[k] * v[self.axes[k]];
        Vector3::new(of(0), of(1), of(2))
    }

    /// The force in the world that an accelerometer of these axes has.
    fn force(&self, triple: &Triple) -> Vector3<f64> {
        let of = |k: usize| triple.forces[self.axes[k]].column(k) * self.signs[k];
        of(0) + of(1) + of(2)
    }
}

impl std::fmt::Display for Arrangement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let of = |k: usize| {
            let sign = if self.signs[k] < 0.0 { "-" } else { "" };
            format!("{sign}{}", ["x", "y", "z"][self.axes[k]])
        };
        write!(f, "({}, {}, {})", of(0), of(1), of(2))
    }
}

impl WrongAxes {
    /// As it is said.
    pub fn warning(&self, sensor: Sensor) -> OdometryWarning {
        let sensor = match sensor {
            Sensor::Gyroscope => "gyroscope",
            Sensor::Accelerometer => "accelerometer",
        };
        OdometryWarning::ImuAxes {
            sensor: sensor.to_owned(),
            right: self.right.to_string(),
        }
    }
}

/// The right axes of a gyroscope that has others.
pub(super) fn of_gyroscope(turns: &Turns) -> Option<WrongAxes> {
    let (straight, mirrored) = (turns.late(0.0), turns.mirrored());
    if straight.len() < MIN_SPANS {
        return None;
    }
    let left = |arrangement: &Arrangement| {
        let turns = match arrangement.is_mirror() {
            true => &mirrored,
            false => &straight,
        };
        residuals(turns, |by_gyro| arrangement.apply(by_gyro))
    };
    let tried: Vec<_> = Arrangement::all().map(|a| (a, left(&a))).collect();
    let sigma = tried.iter().map(|(_, all)| scatter(all));
    let sigma_rad = sigma.fold(f64::INFINITY, f64::min).max(LEAST_SIGMA_RAD);
    let costs = tried.iter().map(|(arrangement, all)| {
        let sum: f64 = all.iter().map(|r| cost(r, sigma_rad)).sum();
        (*arrangement, sum)
    });
    wrong(costs)
}

/// The same of an accelerometer.
pub(super) fn of_accelerometer(triples: &[Triple]) -> Option<WrongAxes> {
    wrong(of_accelerometer_all(&some_of(triples))?.into_iter())
}

/// Whether the scans tell that the axes of an accelerometer are right as far as the force along a direction of the world depends on them: that every arrangement
/// by which it would be another one fits them worse.
pub(super) fn is_told(triples: &[Triple], along: &Vector3<f64>) -> bool {
    let triples = some_of(triples);
    let Some(costs) = of_accelerometer_all(&triples) else {
        return false;
    };
    let cost_of = |a: &Arrangement| costs.iter().find(|(known, _)| known == a).map(|c| c.1);
    let Some(now) = cost_of(&AS_IT_IS) else {
        return false;
    };
    costs.iter().all(|(arrangement, cost)| {
        let differs = |t: &&Triple| along.dot(&(arrangement.force(t) - AS_IT_IS.force(t)));
        let all: Vec<f64> = triples.iter().map(differs).collect();
        // What stays is taken for gravity.
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let squares: f64 = all.iter().map(|d| (d - mean).powi(2)).sum();
        let is_other = (squares / all.len() as f64).sqrt() > OTHER_M_S2;
        !is_other || cost - now > LEAST_EXPLAINED
    })
}

/// As many as tell anything.
fn some_of(triples: &[Triple]) -> Vec<&Triple> {
    let every = triples.len().div_ceil(MAX_TRIPLES).max(1);
    triples.iter().step_by(every).collect()
}

/// What each arrangement leaves unexplained; `None` where triples are too few.
fn of_accelerometer_all(triples: &[&Triple]) -> Option<Vec<(Arrangement, f64)>> {
    if triples.len() < MIN_TRIPLES {
        return None;
    }
    let sigmas = Arrangement::all().map(|a| {
        let fit = fit(triples, &a, None)?;
        Some(scatter(&fit.residuals))
    });
    let sigma = sigmas.flatten().fold(f64::INFINITY, f64::min);
    let sigma_m_s2 = sigma.max(LEAST_SIGMA_M_S2);
    let costs = Arrangement::all().filter_map(|a| {
        let fit = fit(triples, &a, Some(sigma_m_s2))?;
        let sum: f64 = fit.residuals.iter().map(|r| cost(r, sigma_m_s2)).sum();
        let of_bias = fit.bias.norm_squared() / (BIAS_M_S2 * BIAS_M_S2);
        Some((a, sum / SHARED + of_bias))
    });
    Some(costs.collect())
}

/// What stands out from what is said.
fn wrong(costs: impl Iterator<Item = (Arrangement, f64)>) -> Option<WrongAxes> {
    let costs: Vec<_> = costs.collect();
    let (_, now) = costs.iter().find(|(a, _)| *a == AS_IT_IS)?;
    let (right, least) = costs.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    let is_better = now - least > LEAST_EXPLAINED && *now > LEAST_RATIO * least;
    (*right != AS_IT_IS && is_better).then_some(WrongAxes { right: *right })
}

struct Fit {
    bias: Vector3<f64>,
    residuals: Vec<Vector3<f64>>,
}

/// Bias and gravity of an arrangement by least squares, weighted by a standard deviation or by how they scatter; triples that do not fit lose
/// their weight (Cauchy).
fn fit(triples: &[&Triple], arrangement: &Arrangement, sigma_m_s2: Option<f64>) -> Option<Fit> {
    let forces: Vec<_> = triples.iter().map(|t| arrangement.force(t)).collect();
    let left = |found: &Vector6<f64>| -> Vec<Vector3<f64>> {
        let (bias, gravity) = (found.fixed_rows::<3>(0), found.fixed_rows::<3>(3));
        let each = triples.iter().zip(&forces);
        each.map(|(t, force)| t.seen * (force + t.world_from_rig * bias + gravity - t.by_scans))
            .collect()
    };
    let (b, g) = (BIAS_M_S2.powi(-2), GRAVITY_M_S2.powi(-2));
    let prior = Matrix6::from_diagonal(&Vector6::new(b, b, b, g, g, g));
    let mean: Vector3<f64> = forces.iter().sum::<Vector3<f64>>() / forces.len().max(1) as f64;
    let start = Vector6::new(0.0, 0.0, 0.0, -mean.x, -mean.y, -mean.z);
    let terms = |found: &Vector6<f64>| {
        let residuals = left(found);
        let sigma = sigma_m_s2.unwrap_or_else(|| scatter(&residuals).max(LEAST_SIGMA_M_S2));
        let mut equations = NormalEquations::<6>::default();
        for (triple, r) in triples.iter().zip(&residuals) {
            let mut jacobian = Matrix3x6::zeros();
            jacobian
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&(triple.seen * triple.world_from_rig));
            jacobian
                .fixed_view_mut::<3, 3>(0, 3)
                .copy_from(&triple.seen);
            equations.add_block(r, &jacobian, weight(r, sigma) / SHARED);
        }
        equations.add_prior(found, &prior);
        Some(equations)
    };
    let found = minimise(start, ROUNDS, terms, |_| Next::Iterate)?.value;
    Some(Fit {
        bias: found.fixed_rows::<3>(0).into(),
        residuals: left(&found),
    })
}
