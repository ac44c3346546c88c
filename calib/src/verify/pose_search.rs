//! The pose of a camera to the LiDAR at which their mutual information is largest: rotation first, from afar, then all six
//! numbers by Newton's method on differences.
//!
//! How well it is known: with `g` the derivative of each view's log likelihood and `H` the second derivative of their sum,
//! `H⁻¹ (Σ g gᵀ) H⁻¹` is what other views of the same place would have changed (White 1982).

use lsfb_geometry::{Matrix6, Se3, Vector6};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::alignment::{Score, best_turn, turned};
use super::mutual_information::{Likelihood, mutual_information};
use super::view::View;

/// Step of differences, pixels: wide enough that grey values between pixels look smooth.
const STEP_PX: f64 = 0.75;
const ITERATIONS: usize = 14;
/// Share of the largest curvature below which there is none.
const FLAT: f64 = 1e-3;
/// Longest step, in those of differences.
const LONGEST: f64 = 4.0;
/// A step shorter than this ends the search, in those of differences.
const SHORTEST: f64 = 0.02;

/// What was found.
#[derive(Clone, Debug)]
pub(super) struct Found {
    /// The camera's pose on the rig.
    pub rig_from_camera: Se3,
    /// Covariance of its error, perturbed on the right: rotation (rad), then translation (m) in the camera's axes; zero rows for what
    /// was held.
    pub covariance: Matrix6<f64>,
}

/// Steps of differences for each number.
pub(super) struct Steps(pub [f64; 6]);

impl Steps {
    /// As long as their effect in the image asks for, for things at the middle distance.
    pub fn of(views: &[&View], rig_from_camera: &Se3) -> Option<Self> {
        let camera_from_rig = rig_from_camera.inverse();
        let focal_px = views.first()?.edges.gray.camera.focal_px()[0];
        let mut depths: Vec<f64> = views
            .iter()
            .flat_map(|v| v.returns.iter().step_by(37))
            .map(|r| (camera_from_rig * r.position).norm())
            .collect();
        depths.sort_by(f64::total_cmp);
        let angle = STEP_PX / focal_px;
        let way = angle * depths.get(depths.len() / 2)?;
        Some(Self([angle, angle, angle, way, way, way]))
    }
}

/// Rotation alone, from within 2.5°.
pub(super) fn turned_best(views: &[&View], rig_from_camera: &Se3) -> Se3 {
    let turn = best_turn(views, rig_from_camera, Score::MutualInformation);
    turned(rig_from_camera, &turn)
}

/// The maximum over some of the six numbers; `None` where there is none near.
pub(super) fn maximum(
    views: &[&View],
    start: &Se3,
    steps: &Steps,
    free: &[usize],
) -> Option<Found> {
    let mut pose = *start;
    for _ in 0..ITERATIONS {
        let local = Local::at(views, &pose, steps, free);
        let step = local.newton()?;
        let length = step.norm();
        let step = if length > LONGEST {
            step * (LONGEST / length)
        } else {
            step
        };
        // Shorter until the score is no lower.
        let mut share = 1.0;
        let next = loop {
            let next = pose.retract(&spread(&(&step * share), steps, free));
            if mutual_information(views, &next.inverse()) >= local.value {
                break Some(next);
            }
            share *= 0.5;
            if share * length < SHORTEST {
                break None;
            }
        };
        match next {
            Some(next) => pose = next,
            None => break,
        }
        if share * length < SHORTEST {
            break;
        }
    }
    let covariance = covariance(views, &pose, steps, free)?;
    Some(Found {
        rig_from_camera: pose,
        covariance,
    })
}

/// Numbers of some axes, in steps, as a tangent.
fn spread(step: &DVector<f64>, steps: &Steps, free: &[usize]) -> Vector6<f64> {
    let mut delta = Vector6::zeros();
    for (value, k) in step.iter().zip(free) {
        delta[*k] = value * steps.0[*k];
    }
    delta
}

/// Value, gradient and second derivative of the mutual information, in steps.
struct Local {
    value: f64,
    gradient: DVector<f64>,
    curvature: DMatrix<f64>,
}

impl Local {
    fn at(views: &[&View], pose: &Se3, steps: &Steps, free: &[usize]) -> Self {
        let n = free.len();
        let mut trials = vec![DVector::zeros(n)];
        let unit = |k: usize, sign: f64| {
            let mut v = DVector::zeros(n);
            v[k] = sign;
            v
        };
        for k in 0..n {
            trials.extend([unit(k, 1.0), unit(k, -1.0)]);
        }
        for i in 0..n {
            for k in i + 1..n {
                trials.extend([unit(i, 1.0) + unit(k, 1.0), unit(i, -1.0) + unit(k, -1.0)]);
            }
        }
        let values: Vec<f64> = trials
            .par_iter()
            .map(|t| mutual_information(views, &pose.retract(&spread(t, steps, free)).inverse()))
            .collect();
        let value = values[0];
        let (up, down) = (|k: usize| values[1 + 2 * k], |k: usize| values[2 + 2 * k]);
        let mut curvature = DMatrix::zeros(n, n);
        for k in 0..n {
            curvature[(k, k)] = up(k) + down(k) - 2.0 * value;
        }
        let mut at = 1 + 2 * n;
        for i in 0..n {
            for k in i + 1..n {
                let both = values[at] + values[at + 1];
                let mixed = 0.5 * (both - up(i) - down(i) - up(k) - down(k) + 2.0 * value);
                curvature[(i, k)] = mixed;
                curvature[(k, i)] = mixed;
                at += 2;
            }
        }
        Self {
            value,
            gradient: DVector::from_fn(n, |k, _| 0.5 * (up(k) - down(k))),
            curvature,
        }
    }

    /// Uphill, also where the score bends upwards.
    fn newton(&self) -> Option<DVector<f64>> {
        let eigen = self.curvature.clone().symmetric_eigen();
        let most = eigen.eigenvalues.amax();
        if !(most > 0.0) {
            return None;
        }
        let along = eigen.eigenvectors.transpose() * &self.gradient;
        let step = along.zip_map(&eigen.eigenvalues, |g, e| g / e.abs().max(FLAT * most));
        Some(&eigen.eigenvectors * step)
    }
}

fn covariance(views: &[&View], pose: &Se3, steps: &Steps, free: &[usize]) -> Option<Matrix6<f64>> {
    let n = free.len();
    let local = Local::at(views, pose, steps, free);
    let likelihood = Likelihood::at(views, &pose.inverse());
    let mut eigen = (-local.curvature * likelihood.total).symmetric_eigen();
    let most = eigen.eigenvalues.max();
    if !(most > 0.0) {
        return None;
    }
    // Where there is no maximum next to nothing is known.
    eigen.eigenvalues.apply(|e| *e = e.max(FLAT * most));
    let inverse = eigen.recompose().try_inverse()?;
    let gradients: Vec<DVector<f64>> = views
        .par_iter()
        .map(|view| {
            DVector::from_fn(n, |k, _| {
                let mut unit = DVector::zeros(n);
                unit[k] = 1.0;
                let up = pose.retract(&spread(&unit, steps, free)).inverse();
                let down = pose.retract(&spread(&-unit, steps, free)).inverse();
                0.5 * (likelihood.of(view, &up) - likelihood.of(view, &down))
            })
        })
        .collect();
    let mean = gradients.iter().sum::<DVector<f64>>() / views.len() as f64;
    let mut meat = DMatrix::zeros(n, n);
    for g in &gradients {
        meat += (g - &mean) * (g - &mean).transpose();
    }
    // Few views know their own spread less well.
    let freedom = (views.len() as f64 - n as f64).max(1.0);
    let in_steps = &inverse * meat * &inverse * (views.len() as f64 / freedom);
    let mut covariance = Matrix6::zeros();
    for (i, a) in free.iter().enumerate() {
        for (k, b) in free.iter().enumerate() {
            covariance[(*a, *b)] = in_steps[(i, k)] * steps.0[*a] * steps.0[*b];
        }
    }
    Some(covariance)
}
