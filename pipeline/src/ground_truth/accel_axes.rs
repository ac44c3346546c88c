//! Which way the accelerometer's axes point by the places at which images were found, whatever the solve made of both.
//!
//! It is asked where a walk is refused: axes, signs or units that are wrong bend a walk so that parts of the map seem to contradict each other.
//! How the velocity changes between three places follows from them alone. Beside what the accelerometer read meanwhile, turned as the images
//! were, it shows the forces to be its readings times a matrix: one where all is right.

use std::path::Path;

use lsfb_geometry::{StampedPose, Trajectory};
use nalgebra::SMatrix;

use super::sensor_axes::{Measured, as_it_is, fit, usually_left, wrong_axis};
use super::walk::Walk;
use crate::{Error, Refusal};
use lsfb_perception::imu::standard_gravity_m_s2;

/// From the middle of three places to the others, seconds: where the second difference of positions tells most.
const NEAREST_SECS: f64 = 0.2;
const FARTHEST_SECS: f64 = 0.6;
/// Fewest of such triples.
const FEWEST: usize = 10;
/// Longest pause of the samples among them, seconds.
const LONGEST_PAUSE_SECS: f64 = 0.05;
/// Error of a change of velocity that is expected, m/s: it limits what one counts.
const CHANGE_SIGMA_M_S: f64 = 0.1;
/// Standard deviation of a bias, m/s².
const BIAS_SIGMA_M_S2: f64 = 0.3;
/// The matrix is believed where what it leaves is this share of what is left without it.
const EXPLAINED: f64 = 0.5;

/// An axis of the accelerometer that does not read what the device feels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Misread {
    pub axis: char,
    /// What is felt along x, y and z of the IMU where that axis reads 1.
    pub felt: [f64; 3],
}

impl Misread {
    pub fn refusal(self, path: &Path) -> Error {
        Error::Refused(Refusal::AccelContradicts {
            path: path.to_owned(),
            axis: self.axis,
            felt: self.felt,
        })
    }
}

/// The axis that is farthest off, if one is; places that contradict one another explain nothing, and are `None`.
pub(super) fn misread_axis(walk: &Walk) -> Option<Misread> {
    let changes = changes(walk);
    if changes.len() < FEWEST {
        return None;
    }
    let found = fit(&changes, [CHANGE_SIGMA_M_S, BIAS_SIGMA_M_S2])?;
    if usually_left(&changes, &found)? > EXPLAINED * usually_left(&changes, &as_it_is())? {
        return None;
    }
    let (axis, felt) = wrong_axis(&found)?;
    Some(Misread { axis, felt })
}

/// Changes of the velocity, with how they follow from the readings.
fn changes(walk: &Walk) -> Vec<Measured> {
    let localized = walk.frames.iter().filter_map(|frame| {
        Some(StampedPose {
            time: frame.time,
            world_from_rig: frame.localized?.world_from_rig,
        })
    });
    let trajectory = Trajectory::new(localized.collect());
    let poses = trajectory.poses();
    let triples = poses.iter().enumerate().filter_map(|(k, middle)| {
        let is_apart = |other: &&StampedPose| {
            let apart = other.time.secs_since(middle.time).abs();
            (NEAREST_SECS..FARTHEST_SECS).contains(&apart)
        };
        let before = poses[..k].iter().find(is_apart)?;
        let after = poses[k + 1..].iter().rev().find(is_apart)?;
        change(walk, &trajectory, [before, middle, after])
    });
    triples.collect()
}

/// Between three places: the difference of the mean velocities before and after the second is the acceleration weighted by a triangle.
fn change(
    walk: &Walk,
    trajectory: &Trajectory,
    [before, middle, after]: [&StampedPose; 3],
) -> Option<Measured> {
    let secs = |pose: &StampedPose| pose.time.secs_since(middle.time);
    let (from, to) = (secs(before), secs(after));
    let velocity = |a: &StampedPose, b: &StampedPose, secs: f64| {
        (b.world_from_rig.translation - a.world_from_rig.translation) / secs
    };
    let gained = velocity(middle, after, to) - velocity(before, middle, -from);
    let first = walk.imu.partition_point(|s| s.time < before.time);
    let end = walk.imu.partition_point(|s| s.time <= after.time);
    let mut by_unknowns = SMatrix::<f64, 3, 12>::zeros();
    let mut area = 0.0;
    for pair in walk.imu[first..end.max(first)].windows(2) {
        let step = pair[1].time.secs_since(pair[0].time);
        if step > LONGEST_PAUSE_SECS {
            return None;
        }
        let at = pair[0].time.secs_since(middle.time);
        let weight = step
            * if at < 0.0 {
                1.0 - at / from
            } else {
                1.0 - at / to
            };
        let turn = trajectory.at(pair[0].time)?.rotation.to_rotation_matrix();
        let turn = turn.into_inner() * weight;
        for column in 0..3 {
            for (row, read) in pair[0].sample.specific_force_m_s2.iter().enumerate() {
                let mut entries = by_unknowns.column_mut(3 * column + row);
                entries += turn.column(column) * *read;
            }
            let mut entries = by_unknowns.column_mut(9 + column);
            entries += turn.column(column);
        }
        area += weight;
    }
    (area > 0.8 * 0.5 * (to - from)).then(|| Measured {
        by_unknowns,
        value: gained - standard_gravity_m_s2() * area,
    })
}
