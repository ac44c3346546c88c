//! Which way the accelerometer's axes point by the places at which images were found, whatever the solve made of both.
//!
//! It is asked where a walk is refused: axes, signs or units that are wrong bend a walk so that parts of the map seem to contradict each other.
//! How the velocity changes between three places follows from them alone. Beside what the accelerometer read meanwhile, turned as the images
//! were, it shows the forces to be its readings times a matrix: one where all is right.

use std::path::Path;

use lsfb_geometry::{Matrix3, StampedPose, Trajectory, Vector3};
use lsfb_perception::statistics::median;
use nalgebra::{SMatrix, SVector};

use super::walk::Walk;
use crate::Error;
use crate::preintegration::standard_gravity_m_s2;

/// From the middle of three places to the others, seconds: where the second difference of positions tells most.
const NEAREST_SECS: f64 = 0.2;
const FARTHEST_SECS: f64 = 0.6;
/// Fewest of such triples.
const FEWEST: usize = 10;
/// Longest pause of the samples among them, seconds.
const LONGEST_PAUSE_SECS: f64 = 0.05;
/// Error of a change of velocity that is expected, m/s: it limits what one counts.
const CHANGE_SIGMA_M_S: f64 = 0.1;
/// Standard deviation of the matrix about one, so loose that it only matters for an axis along which nothing is felt, and of a bias, m/s².
const LOOSE: f64 = 1.0;
const BIAS_SIGMA_M_S2: f64 = 0.3;
/// Changes farther off than so many medians count less.
const ROBUST_MEDIANS: f64 = 3.0;
const ROUNDS: usize = 8;
/// The matrix is believed where what it leaves is this share of what is left without it.
const EXPLAINED: f64 = 0.5;
/// An axis is wrong where it is so far from one.
const WRONG: f64 = 0.6;

/// An axis of the accelerometer that does not read what the device feels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Misread {
    pub axis: char,
    /// What is felt along x, y and z of the IMU where that axis reads 1.
    pub felt: [f64; 3],
}

impl Misread {
    pub fn refusal(self, path: &Path) -> Error {
        Error::AccelContradicts {
            path: path.to_owned(),
            axis: self.axis,
            felt: self.felt,
        }
    }
}

/// A matrix row by row, then a bias.
type Unknowns = SVector<f64, 12>;

/// A change of velocity, and how it follows from the unknowns.
struct Change {
    by_unknowns: SMatrix<f64, 3, 12>,
    m_s: Vector3<f64>,
}

impl Change {
    fn left(&self, unknowns: &Unknowns) -> f64 {
        (self.m_s - self.by_unknowns * unknowns).norm()
    }
}

/// The axis that is farthest off, if one is; places that contradict one another explain nothing, and are `None`.
pub(super) fn misread_axis(walk: &Walk) -> Option<Misread> {
    let changes = changes(walk);
    if changes.len() < FEWEST {
        return None;
    }
    let prior = prior();
    let mut weights = vec![1.0; changes.len()];
    let mut found = prior;
    for _ in 0..ROUNDS {
        let mut information = SMatrix::<f64, 12, 12>::identity() * LOOSE.powi(-2);
        for k in 9..12 {
            information[(k, k)] = BIAS_SIGMA_M_S2.powi(-2);
        }
        let mut right = information * prior;
        for (change, weight) in changes.iter().zip(&weights) {
            let by = change.by_unknowns.transpose() * (weight * CHANGE_SIGMA_M_S.powi(-2));
            information += by * change.by_unknowns;
            right += by * change.m_s;
        }
        found = information.cholesky()?.solve(&right);
        let sizes: Vec<f64> = changes.iter().map(|c| c.left(&found)).collect();
        let usual = median(sizes.clone())?.max(f64::EPSILON);
        let share = |size: &f64| (ROBUST_MEDIANS * usual / size.max(f64::EPSILON)).min(1.0);
        weights = sizes.iter().map(share).collect();
    }
    let usual = |unknowns: &Unknowns| median(changes.iter().map(|c| c.left(unknowns)).collect());
    if usual(&found)? > EXPLAINED * usual(&prior)? {
        return None;
    }
    let felt_by_read = Matrix3::from_fn(|row, column| found[3 * row + column]);
    let off = felt_by_read - Matrix3::identity();
    let worst = (0..3).max_by(|a, b| off.column(*a).norm().total_cmp(&off.column(*b).norm()))?;
    (off.column(worst).norm() > WRONG).then(|| Misread {
        axis: ['x', 'y', 'z'][worst],
        felt: felt_by_read.column(worst).into_owned().into(),
    })
}

/// A matrix of one, no bias.
fn prior() -> Unknowns {
    let mut prior = Unknowns::zeros();
    for axis in 0..3 {
        prior[4 * axis] = 1.0;
    }
    prior
}

fn changes(walk: &Walk) -> Vec<Change> {
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
) -> Option<Change> {
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
    (area > 0.8 * 0.5 * (to - from)).then(|| Change {
        by_unknowns,
        m_s: gained - standard_gravity_m_s2() * area,
    })
}
