//! Whether the images turn as the gyroscope says, axis by axis.
//!
//! The rotation between neighbouring images follows from what is followed through them, whatever the translation. Beside the gyroscope's
//! over the same time it shows a sign, a unit or an order of axes that is wrong: the images' turns are then the gyroscope's times a matrix
//! that is far from one. A search for a beginning tries such a walk at every place in vain.

use lsfb_geometry::{Matrix3, UnitQuaternion, Vector3, so3};
use lsfb_perception::image::{Track, relative_rotation};
use lsfb_perception::statistics::median;
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

use super::TrackedWalk;
use crate::Error;
use crate::preintegration::{ImuBias, PreintegratedImu};

/// Pairs of images that are compared at most, and at least.
const MOST_PAIRS: usize = 150;
const FEWEST_PAIRS: usize = 12;
/// Farthest apart that two images may be, seconds.
const APART_SECS: f64 = 0.35;
/// Error of a turn by images that is expected, radians: it limits what a pair counts.
const TURN_SIGMA_RAD: f64 = 2e-3;
/// Standard deviation of the matrix about one, so loose that it only matters for an axis about which nothing turns.
const LOOSE: f64 = 1.0;
/// Pairs farther off than so many medians count less.
const ROBUST_MEDIANS: f64 = 3.0;
const ROUNDS: usize = 8;
/// The matrix explains the images where what is left of their turns is this share of what is left without it, and this share of them.
const EXPLAINED: f64 = 0.4;
const LEFT_OF_ALL: f64 = 0.3;
/// An axis is wrong where the images turn by so much less or more, or otherwise, than the gyroscope: far beyond what a camera that is
/// turned against its rig file does.
const WRONG: f64 = 0.6;

/// Turns between two images in the rig's frame, radians.
struct Turn {
    gyro: Vector3<f64>,
    images: Vector3<f64>,
    secs: f64,
}

/// [`Error::GyroContradicts`] where signs, units or axes of the gyroscope are not those of the images.
pub(super) fn check_turns(walk: &TrackedWalk) -> Result<(), Error> {
    let turns = turns(walk);
    if turns.len() < FEWEST_PAIRS {
        return Ok(());
    }
    let Some(images_by_gyro) = fit(&turns) else {
        return Ok(());
    };
    let off = images_by_gyro - Matrix3::identity();
    let worst = (0..3).max_by(|a, b| off.column(*a).norm().total_cmp(&off.column(*b).norm()));
    match worst {
        Some(axis) if off.column(axis).norm() > WRONG => Err(Error::GyroContradicts {
            axis: ['x', 'y', 'z'][axis],
            images: images_by_gyro.column(axis).into_owned().into(),
        }),
        _ => Ok(()),
    }
}

/// The matrix that makes the images' turns of the gyroscope's; `None` where it explains them no better than none.
fn fit(turns: &[Turn]) -> Option<Matrix3<f64>> {
    type Unknowns = SVector<f64, 12>;
    let mut weights = vec![1.0; turns.len()];
    let (mut by_gyro, mut bias) = (Matrix3::identity(), Vector3::zeros());
    let left = |turn: &Turn, by: &Matrix3<f64>, bias: &Vector3<f64>| {
        (turn.images - by * turn.gyro - bias * turn.secs).norm()
    };
    for _ in 0..ROUNDS {
        let mut information = SMatrix::<f64, 12, 12>::identity() * LOOSE.powi(-2);
        let mut right = Unknowns::zeros();
        for (row, value) in Matrix3::<f64>::identity().transpose().iter().enumerate() {
            right[row] = value * LOOSE.powi(-2);
        }
        for (turn, weight) in turns.iter().zip(&weights) {
            for axis in 0..3 {
                let mut by = Unknowns::zeros();
                by.fixed_rows_mut::<3>(3 * axis).copy_from(&turn.gyro);
                by[9 + axis] = turn.secs;
                let weight = weight * TURN_SIGMA_RAD.powi(-2);
                information += by * by.transpose() * weight;
                right += by * (turn.images[axis] * weight);
            }
        }
        let found = information.cholesky()?.solve(&right);
        by_gyro = Matrix3::from_fn(|row, column| found[3 * row + column]);
        bias = found.fixed_rows::<3>(9).into_owned();
        let sizes: Vec<f64> = turns.iter().map(|t| left(t, &by_gyro, &bias)).collect();
        let usual = median(sizes.clone())?.max(f64::EPSILON);
        let share = |size: &f64| (ROBUST_MEDIANS * usual / size.max(f64::EPSILON)).min(1.0);
        weights = sizes.iter().map(share).collect();
    }
    let usual = |by: &Matrix3<f64>, bias: &Vector3<f64>| {
        median(turns.iter().map(|t| left(t, by, bias)).collect())
    };
    let explained = usual(&by_gyro, &bias)?;
    let as_it_is = usual(&Matrix3::identity(), &Vector3::zeros())?;
    let all = usual(&Matrix3::zeros(), &Vector3::zeros())?;
    (explained < EXPLAINED * as_it_is && explained < LEFT_OF_ALL * all).then_some(by_gyro)
}

fn turns(walk: &TrackedWalk) -> Vec<Turn> {
    let frames = &walk.frames;
    let step = (frames.len() / MOST_PAIRS).max(1);
    let firsts: Vec<usize> = (0..frames.len().saturating_sub(1)).step_by(step).collect();
    let turns = firsts.into_par_iter().flat_map_iter(|first| {
        (0..walk.cameras.len()).filter_map(move |camera| turn(walk, first, camera))
    });
    turns.collect()
}

/// Of a camera from one frame to the next.
fn turn(walk: &TrackedWalk, first: usize, camera: usize) -> Option<Turn> {
    let (a, b) = (&walk.frames[first], &walk.frames[first + 1]);
    let secs = b.time.secs_since(a.time);
    if secs > APART_SECS {
        return None;
    }
    let none = ImuBias::default();
    let between = PreintegratedImu::integrate(&walk.imu, a.time, b.time, none, &walk.noise).ok()?;
    let model = &walk.cameras[camera];
    let ray = |pixel| Some(model.camera.unproject(pixel)?.normalize());
    let seen = |sights: &[super::Sight]| {
        let own = sights.iter().filter(|s| s.camera == camera);
        own.map(|s| (s.track, s.pixel)).collect::<Vec<_>>()
    };
    let mut later = seen(&b.sights);
    later.sort_by_key(|(track, _)| *track);
    let tracks: Vec<Track> = seen(&a.sights)
        .iter()
        .filter_map(|(track, pixel)| {
            let k = later.binary_search_by_key(track, |(t, _)| *t).ok()?;
            Some(Track {
                first: ray(pixel)?,
                second: ray(&later[k].1)?,
            })
        })
        .collect();
    let rig_from_camera = model.rig_from_camera.rotation;
    let as_gyro = rig_from_camera.inverse() * between.rotation.inverse() * rig_from_camera;
    // The order matters little: answers that fit about as well are taken near the first, and a camera at rest is most often right.
    let starts = [UnitQuaternion::identity(), as_gyro, as_gyro.inverse()];
    let found = relative_rotation(&tracks, &starts)?;
    let a_from_b = rig_from_camera * found.b_from_a.inverse() * rig_from_camera.inverse();
    Some(Turn {
        gyro: so3::log(&between.rotation),
        images: so3::log(&a_from_b),
        secs,
    })
}
