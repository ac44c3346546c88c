//! The gyroscope's bias from tracks, whatever the translation.
//!
//! Rays of one point from two places span a plane that holds the line between these places: when the rotation is right, the normals of all
//! these planes are at right angles to one direction (Kneip and Lynen, "Direct Optimization of Frame-to-Frame Rotation", ICCV 2013). The
//! least eigenvalue of the normals' moment matrix measures how far they are from that; here it is minimised over the bias.

use std::ops::Range;

use lsfb_geometry::{Matrix3, Vector3};
use lsfb_solver::gauss_newton::{NormalEquations, minimise_damped};

use super::sights::Tracks;
use crate::ground_truth::walk::Walk;
use lsfb_perception::imu::{ImuBias, PreintegratedImu};

/// Apart at least and in the aim, seconds: far enough to show a rotation, near enough to share tracks.
const APART_SECS: f64 = 0.3;
/// Tracks that two images must share.
const FEWEST_SHARED: usize = 12;
/// Steps tried at most.
const MAX_TRIALS: u32 = 30;
/// For derivatives by differences, rad/s.
const STEP_RAD_S: f64 = 1e-5;

/// Two images of one camera, and the rotation that the gyroscope says lies between.
struct Pair {
    rig_from_camera: Matrix3<f64>,
    between: PreintegratedImu,
    rays: Vec<[Vector3<f64>; 2]>,
}

impl Pair {
    /// Root of the least eigenvalue of the moment matrix of normals: a sine of an angle.
    fn error(&self, bias: &Vector3<f64>) -> f64 {
        let change = self.between.corrected(&ImuBias {
            gyro_rad_s: *bias,
            ..self.between.bias
        });
        let turn = change.rotation.to_rotation_matrix().into_inner();
        let first_from_second = self.rig_from_camera.transpose() * turn * self.rig_from_camera;
        let normals = self
            .rays
            .iter()
            .map(|[a, b]| a.cross(&(first_from_second * b)));
        let moments: Matrix3<f64> = normals.map(|n| n * n.transpose()).sum();
        let mean = moments / self.rays.len() as f64;
        mean.symmetric_eigenvalues().min().max(0.0).sqrt()
    }
}

/// The bias, rad/s, from images within a window; `None` where they share too few tracks.
pub(super) fn estimate(
    walk: &Walk,
    tracks: &Tracks,
    window: &Range<usize>,
) -> Option<Vector3<f64>> {
    let pairs = pairs(walk, tracks, window);
    if pairs.len() < 3 {
        return None;
    }
    let cost = |bias: &Vector3<f64>| pairs.iter().map(|p| p.error(bias).powi(2)).sum::<f64>();
    let terms = |bias: &Vector3<f64>| {
        let mut equations = NormalEquations::<3>::default();
        for pair in &pairs {
            let derivative = Vector3::from_fn(|axis, _| {
                let mut step = Vector3::zeros();
                step[axis] = STEP_RAD_S;
                (pair.error(&(bias + step)) - pair.error(&(bias - step))) / (2.0 * STEP_RAD_S)
            });
            equations.add(pair.error(bias), &derivative, 1.0);
        }
        equations
    };
    let (bias, _) = minimise_damped(Vector3::zeros(), MAX_TRIALS, terms, cost);
    Some(bias)
}

fn pairs(walk: &Walk, tracks: &Tracks, window: &Range<usize>) -> Vec<Pair> {
    let mut pairs = Vec::new();
    let mut first = window.start;
    while first < window.end {
        let time = walk.frames[first].time;
        let later = first + 1..window.end;
        let Some(second) = later
            .clone()
            .find(|k| walk.frames[*k].time.secs_since(time) >= APART_SECS)
        else {
            break;
        };
        let until = walk.frames[second].time;
        let none = ImuBias::default();
        if let Ok(between) = PreintegratedImu::integrate(&walk.imu, time, until, none, &walk.noise)
        {
            for (k, camera) in walk.cameras.iter().enumerate() {
                let rays = tracks.shared(k, first, second).into_iter();
                let ray = |pixel| camera.camera().unproject(&pixel);
                let rays: Vec<_> = rays.filter_map(|[a, b]| Some([ray(a)?, ray(b)?])).collect();
                if rays.len() >= FEWEST_SHARED {
                    pairs.push(Pair {
                        rig_from_camera: camera.camera_from_rig().inverse().rotation_matrix(),
                        between: between.clone(),
                        rays,
                    });
                }
            }
        }
        first += (second - first).div_ceil(2);
    }
    pairs
}
