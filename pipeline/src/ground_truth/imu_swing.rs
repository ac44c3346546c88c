//! Whether images and IMU contradict each other at one frequency.
//!
//! Within a few frames the IMU is far firmer than images: forces and rates that swing (a mount that vibrates, vibration that aliases or that a filter
//! turns over) are taken into the path as they are, and hardly anything of them is left in the IMU's own residuals. What is left is in the images,
//! spread over all frames: in each of them far below what one image tells, in all of them together not. So the pull of the images on each pose
//! is looked at by frequency: where images err at random, all frequencies have alike of it.

use std::f64::consts::{LN_2, TAU};

use lsfb_geometry::{Vector3, Vector6};
use lsfb_perception::statistics::median;
use serde::{Deserialize, Serialize};

use super::config::GroundTruthConfig;
use super::optimization::Optimized;
use super::walk::Walk;
use crate::Error;
use crate::residuals::ImuPreintegration;

/// Fewest frames of which frequencies are told apart.
const FEWEST_FRAMES: usize = 64;
/// Below, drift of the biases and errors of the map that go by are as large, Hz.
const LOWEST_HZ: f64 = 1.5;
/// Frequencies on both sides that say what is usual near one, and those next to it that do not: a swing is as wide.
const NEAR: usize = 24;
const NEXT: usize = 3;

/// A motion of one frequency in which images and IMU contradict each other more than in others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImuSwing {
    /// Its frequency, Hz.
    pub hz: f64,
    /// What swings in the samples of one axis, and not in the images.
    pub what: Swinging,
    /// Power of the contradiction over what is usual at frequencies near it: at one frequency it exceeds `x` by chance with a probability of
    /// `exp(-x)`.
    pub times_usual: f64,
    /// Amplitude of positions above which a swing of forces is noticed at any frequency, metres: what images tell, and how many there are.
    pub noticed_from_m: f64,
}

/// How many times as much images may contradict the IMU at one frequency as they do at others near it: right walks, real and simulated, came to
/// 13, as their errors are not all chance; forces that swing by 0.5 m/s² to 64 and more.
pub(super) const LARGEST_SWING: f64 = 30.0;

/// Amplitudes of a swing, and of what it does to the path: as points that the map does not hold swing with the path, they are at least so large.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Swinging {
    /// Specific forces.
    Forces {
        /// Of the forces, m/s².
        m_s2: f64,
        /// Of the path's positions, metres.
        path_m: f64,
    },
    /// Angular velocities.
    Rates {
        /// Of the angular velocities, rad/s.
        rad_s: f64,
        /// Of the path's attitudes, radians.
        path_rad: f64,
    },
}

/// The most unusual of all frequencies; `None` of walks too short or irregular to tell.
pub(super) fn swing(
    walk: &Walk,
    solved: &Optimized,
    config: &GroundTruthConfig,
) -> Result<Option<ImuSwing>, Error> {
    let count = walk.frames.len();
    if count < FEWEST_FRAMES {
        return Ok(None);
    }
    let pulls = pulls(walk, solved)?;
    let begin = walk.frames[0].time;
    let secs: Vec<f64> = walk
        .frames
        .iter()
        .map(|f| f.time.secs_since(begin))
        .collect();
    let steps = secs.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let (length, step) = (secs[count - 1], median(steps).unwrap_or(0.0));
    // Where half of the frames are missing, frequencies are mixed up.
    if step <= 0.0 || length > 2.0 * step * count as f64 {
        return Ok(None);
    }
    let lowest = (LOWEST_HZ * length).ceil() as usize;
    let last = (0.5 * length / step).floor() as usize;
    let firmness = firmness(walk, solved, config);
    let mut most: Option<ImuSwing> = None;
    let mut noticed_from_m: f64 = 0.0;
    // Those below are neighbours all the same.
    let spectrum: Vec<Vector6<f64>> = (1..=last)
        .map(|k| powers(&secs, &pulls, k as f64 / length, length))
        .collect();
    for (axis, firmness) in firmness.iter().enumerate() {
        let powers: Vec<f64> = spectrum.iter().map(|powers| powers[axis]).collect();
        for (k, own) in powers.iter().enumerate().skip(lowest.saturating_sub(1)) {
            let before = &powers[k.saturating_sub(NEAR)..k.saturating_sub(NEXT)];
            let after = powers.get(k + NEXT + 1..(k + NEAR + 1).min(powers.len()));
            let near = [before, after.unwrap_or_default()].concat();
            if near.len() < NEAR / 2 {
                continue;
            }
            // Half of all exponentially distributed numbers are below ln 2 times their mean.
            let usual = median(near).unwrap_or(0.0) / LN_2;
            let times_usual = own / usual.max(f64::MIN_POSITIVE);
            // The window's mean is a half: so much of an amplitude's half is in the sum.
            let path = |power: f64| 4.0 * power.sqrt() / (count as f64 * firmness);
            if axis >= 3 {
                noticed_from_m = noticed_from_m.max(path(LARGEST_SWING * usual));
            }
            if most.is_none_or(|m| times_usual > m.times_usual) {
                let hz = (k + 1) as f64 / length;
                let per_s = TAU * hz;
                let path = path(*own);
                let what = match axis {
                    0..3 => Swinging::Rates {
                        rad_s: path * per_s,
                        path_rad: path,
                    },
                    _ => Swinging::Forces {
                        m_s2: path * per_s * per_s,
                        path_m: path,
                    },
                };
                most = Some(ImuSwing {
                    hz,
                    what,
                    times_usual,
                    noticed_from_m,
                });
            }
        }
    }
    Ok(most.map(|most| ImuSwing {
        noticed_from_m,
        ..most
    }))
}

/// By how much the IMU pulls each pose, and so, as a solve rests where pulls are equal, the images against it.
fn pulls(walk: &Walk, solved: &Optimized) -> Result<Vec<Vector6<f64>>, Error> {
    let states = &solved.estimate.states;
    let intervals = walk.preintegrate(0..states.len(), |k| states[k].bias);
    let mut pulls = vec![Vector6::zeros(); states.len()];
    for (k, interval) in intervals.into_iter().enumerate() {
        let Some(samples) = interval.and_then(ImuPreintegration::new) else {
            continue;
        };
        let ends = [&states[k].nav, &states[k + 1].nav];
        let (errors, gravity) = (&solved.imu_errors, &solved.gravity_m_s2);
        let [first, second] = samples.pulls(ends, &states[k].bias, errors, gravity);
        pulls[k] += first;
        pulls[k + 1] += second;
    }
    Ok(pulls)
}

/// How firmly the images of one frame hold its pose by each entry of the tangent, 1/rad² and 1/m², in the mean of all frames.
fn firmness(walk: &Walk, solved: &Optimized, config: &GroundTruthConfig) -> Vector6<f64> {
    let estimate = &solved.estimate;
    let of_sight = |frame: usize, camera: usize, point: &Vector3<f64>, sigma_px: f64| {
        let seen = estimate.pose(frame).inverse() * *point;
        let away_m = seen.norm().max(f64::MIN_POSITIVE);
        let across = seen.map(|v| 1.0 - (v / away_m).powi(2));
        let focal_px = estimate.cameras[camera].camera().focal_px()[0];
        let turn = across * (focal_px / sigma_px).powi(2);
        let shift = turn / away_m.powi(2);
        Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
    };
    let mut sum = Vector6::zeros();
    for (k, frame) in walk.frames.iter().enumerate() {
        for seen in &frame.fixed {
            sum += of_sight(k, seen.camera, &seen.point_in_world, config.map_sigma_px);
        }
    }
    for point in solved.points.iter().filter(|point| point.is_determined()) {
        for seen in point.observations.iter().filter(|seen| seen.used) {
            let at = &point.point_in_world;
            sum += of_sight(seen.frame, seen.camera, at, config.local_sigma_px);
        }
    }
    (sum / walk.frames.len() as f64).map(|v| v.max(f64::MIN_POSITIVE))
}

/// Power of each entry at a frequency, below Hann's window.
fn powers(secs: &[f64], series: &[Vector6<f64>], hz: f64, length: f64) -> Vector6<f64> {
    let (mut real, mut imaginary) = (Vector6::zeros(), Vector6::zeros());
    for (t, values) in secs.iter().zip(series) {
        let weight = 0.5 - 0.5 * (TAU * t / length).cos();
        let (sin, cos) = (TAU * hz * t).sin_cos();
        real += values * (weight * cos);
        imaginary += values * (weight * sin);
    }
    real.component_mul(&real) + imaginary.component_mul(&imaginary)
}
