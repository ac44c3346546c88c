//! Whether the images turn as the gyroscope says, axis by axis.
//!
//! The rotation between neighbouring images follows from what is followed through them, whatever the translation. Beside the gyroscope's
//! over the same time it shows a sign, a unit or an order of axes that is wrong: the images' turns are then the gyroscope's times a matrix
//! that is far from one. A search for a beginning tries such a walk at every place in vain.

use lsfb_geometry::{UnitQuaternion, so3};
use lsfb_perception::image::{Track, relative_rotation};
use nalgebra::SMatrix;
use rayon::prelude::*;

use super::TrackedWalk;
use crate::ground_truth::sensor_axes::{
    Measured, Unknowns, as_it_is, fit, usually_left, wrong_axis,
};
use crate::{Error, Refusal};
use lsfb_perception::imu::{ImuBias, PreintegratedImu};

/// Pairs of images that are compared at most, and at least.
const MOST_PAIRS: usize = 150;
const FEWEST_PAIRS: usize = 12;
/// Farthest apart that two images may be, seconds.
const APART_SECS: f64 = 0.35;
/// Error of a turn by images that is expected, radians: it limits what a pair counts.
const TURN_SIGMA_RAD: f64 = 2e-3;
/// Standard deviation of the gyroscope's bias, so loose that the images tell it, rad/s.
const BIAS_SIGMA_RAD_S: f64 = 1.0;
/// The matrix explains the images where what is left of their turns is this share of what is left without it, and this share of them.
const EXPLAINED: f64 = 0.4;
const LEFT_OF_ALL: f64 = 0.3;

/// [`Refusal::GyroContradicts`] where signs, units or axes of the gyroscope are not those of the images.
pub(super) fn check_turns(walk: &TrackedWalk) -> Result<(), Error> {
    let turns = turns(walk);
    if turns.len() < FEWEST_PAIRS {
        return Ok(());
    }
    match explaining(&turns).as_ref().and_then(wrong_axis) {
        Some((axis, images)) => Err(Refusal::GyroContradicts { axis, images }.into()),
        None => Ok(()),
    }
}

/// The matrix that makes the images' turns of the gyroscope's; `None` where it explains them no better than none.
fn explaining(turns: &[Measured]) -> Option<Unknowns> {
    let found = fit(turns, [TURN_SIGMA_RAD, BIAS_SIGMA_RAD_S])?;
    let explained = usually_left(turns, &found)?;
    let without = usually_left(turns, &as_it_is())?;
    let all = usually_left(turns, &Unknowns::zeros())?;
    (explained < EXPLAINED * without && explained < LEFT_OF_ALL * all).then_some(found)
}

/// Turns between two images in the rig's frame, radians, with how they follow from the gyroscope's.
fn turns(walk: &TrackedWalk) -> Vec<Measured> {
    let frames = &walk.frames;
    let step = (frames.len() / MOST_PAIRS).max(1);
    let firsts: Vec<usize> = (0..frames.len().saturating_sub(1)).step_by(step).collect();
    let turns = firsts.into_par_iter().flat_map_iter(|first| {
        (0..walk.cameras.len()).filter_map(move |camera| turn(walk, first, camera))
    });
    turns.collect()
}

/// Of a camera from one frame to the next.
fn turn(walk: &TrackedWalk, first: usize, camera: usize) -> Option<Measured> {
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
    let gyro = so3::log(&between.rotation);
    let mut by_unknowns = SMatrix::<f64, 3, 12>::zeros();
    for axis in 0..3 {
        for (k, turned) in gyro.iter().enumerate() {
            by_unknowns[(axis, 3 * axis + k)] = *turned;
        }
        by_unknowns[(axis, 9 + axis)] = secs;
    }
    Some(Measured {
        value: so3::log(&a_from_b),
        by_unknowns,
    })
}
