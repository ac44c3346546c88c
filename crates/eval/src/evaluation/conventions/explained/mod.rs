//! Errors that have one cause, which the figures do not show: another point of the body, a clock that runs at another rate or jumps, axes in
//! units of their own. Each is fitted beside a similarity, by least squares, and named where it leaves less than half of the errors.

use lsfb_geometry::{Matrix3, StampedPose, Vector3, so3};
use lsfb_types::{Finding, Verdict};
use nalgebra::{Matrix4, Matrix4x3, SMatrix, SVector, Vector4};

use super::{LEAST_OFFSET_SECS, LESS, MOST_PAIRS, error_m, speed};
use crate::alignment::{AlignmentMode, align};
use crate::association::PosePair;

/// Longer levers are no part of one body, metres.
const LONGEST_LEVER_M: f64 = 5.0;
/// Times between which an offset of the clocks runs evenly.
const KNOTS: usize = 8;
/// By how much changing offsets must lessen the errors of rotation, too: along a straight way they look like a path that is too long.
const LESS_TURNED: f64 = 0.7;
/// Smaller errors of orientation are not looked at, radians rms.
const LEAST_LATE_RAD: f64 = 0.01;
/// Axes that differ by less in their units are none of another unit.
const LEAST_AXIS: f64 = 0.02;
/// Cosine between axes that are units' and not a shear's.
const SHEAR: f64 = 0.05;
/// Unknown numbers of a similarity.
const SIMILARITY: usize = 7;
/// A pivot that is smaller than this share of the largest is not known.
const LEAST_PIVOT: f64 = 1e-9;

/// Evenly taken pairs, with the truth's velocity (m/s) and angular velocity in its body (rad/s).
struct Sampled {
    pair: PosePair,
    velocity_m_s: Vector3<f64>,
    turning_rad_s: Vector3<f64>,
    /// From 0 at the first to 1 at the last.
    time: f64,
}

fn sampled(pairs: &[PosePair]) -> Vec<Sampled> {
    let (Some(first), Some(last)) = (pairs.first(), pairs.last()) else {
        return Vec::new();
    };
    let all_secs = last.truth.time.secs_since(first.truth.time);
    let step = pairs.len().div_ceil(MOST_PAIRS).max(1);
    let of = |i: usize| {
        let pair = *pairs.get(i)?;
        Some(Sampled {
            pair,
            velocity_m_s: speed(pairs, i)?,
            turning_rad_s: turning(pairs, i)?,
            time: pair.truth.time.secs_since(first.truth.time) / all_secs,
        })
    };
    (0..pairs.len()).step_by(step).filter_map(of).collect()
}

/// The truth's angular velocity at a pair in its body, rad/s, between the pairs around it.
fn turning(pairs: &[PosePair], i: usize) -> Option<Vector3<f64>> {
    let around = |pose: &StampedPose| (pose.time, pose.world_from_rig.rotation);
    let (before, from) = around(&pairs.get(i.saturating_sub(1))?.truth);
    let (after, to) = around(&pairs.get((i + 1).min(pairs.len() - 1))?.truth);
    let secs = after.secs_since(before);
    Some(match secs > 0.0 {
        true => so3::local(&from, &to) / secs,
        false => Vector3::zeros(),
    })
}

/// Coefficients of the columns that leave least of the residuals, and what they leave, rms; `None` where the columns do not tell all of them.
fn least_squares<const N: usize>(
    rows: &[(SMatrix<f64, 3, N>, Vector3<f64>)],
) -> Option<(SVector<f64, N>, f64)> {
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut right = SVector::<f64, N>::zeros();
    for (columns, residual) in rows {
        normal += columns.transpose() * columns;
        right += columns.transpose() * residual;
    }
    let size = normal.diagonal().map(|d| d.sqrt());
    if !size.iter().all(|d| *d > 0.0) {
        return None;
    }
    // Columns of one size: a pivot is then the share that no other column has.
    let scaled = SMatrix::<f64, N, N>::from_fn(|i, j| normal[(i, j)] / size[i] / size[j]);
    let factor = scaled.cholesky()?;
    let lower = factor.l_dirty();
    if (0..N).any(|i| lower[(i, i)] * lower[(i, i)] < LEAST_PIVOT) {
        return None;
    }
    let found = factor
        .solve(&right.component_div(&size))
        .component_div(&size);
    let square = |(columns, residual): &(SMatrix<f64, 3, N>, Vector3<f64>)| {
        (residual - columns * found).norm_squared()
    };
    let sum: f64 = rows.iter().map(square).sum();
    Some((found, (sum / rows.len().max(1) as f64).sqrt()))
}

/// Residuals of the best similarity, with its own seven columns first and those of a cause behind them.
fn beside_similarity<const N: usize>(
    some: &[Sampled],
    cause: impl Fn(&Sampled, usize) -> Vector3<f64>,
) -> Option<(SVector<f64, N>, f64)> {
    let pairs: Vec<PosePair> = some.iter().map(|s| s.pair).collect();
    let alignment = align(&pairs, AlignmentMode::Sim3).ok()?;
    let count = some.len() as f64;
    let places = || some.iter().map(|s| s.pair.truth.world_from_rig.translation);
    let middle = places().sum::<Vector3<f64>>() / count;
    let rows: Vec<_> = some
        .iter()
        .map(|s| {
            let truth = s.pair.truth.world_from_rig.translation;
            let found = alignment.apply(&s.pair.estimate.world_from_rig.translation);
            let from_middle = found - middle;
            let columns = SMatrix::<f64, 3, N>::from_fn(|row, column| match column {
                0..3 => Vector3::ith(column, 1.0).cross(&from_middle)[row],
                3..6 => f64::from(u8::from(row == column - 3)),
                6 => from_middle[row],
                more => cause(s, more - SIMILARITY)[row],
            });
            (columns, truth - found)
        })
        .collect();
    least_squares(&rows)
}

/// Error of the sampled pairs in their best place and size, where that is less than the given one of all pairs: those between them may
/// hold a few that are far off.
fn error_of(some: &[Sampled], best_m: f64) -> f64 {
    let pairs: Vec<PosePair> = some.iter().map(|s| s.pair).collect();
    let own_m = error_m(&pairs, AlignmentMode::Sim3);
    own_m.map_or(best_m, |own_m| own_m.min(best_m))
}

/// Whether the estimate is of another point of the body that the truth is of.
pub fn lever(pairs: &[PosePair], best_m: f64) -> Option<Finding> {
    let some = sampled(pairs);
    let best_m = error_of(&some, best_m);
    let (found, left_m) = beside_similarity::<{ SIMILARITY + 3 }>(&some, |s, axis| {
        -(s.pair.truth.world_from_rig.rotation * Vector3::ith(axis, 1.0))
    })?;
    let lever = Vector3::from_fn(|row, _| found[SIMILARITY + row]);
    (left_m < LESS * best_m && lever.norm() > left_m && lever.norm() < LONGEST_LEVER_M).then(|| {
        let [x, y, z] = lever.into();
        let what = format!(
            "the estimate seems to track another point than the truth, at ({x:.3}, {y:.3}, {z:.3}) m in the truth's body frame: for this point its error would be {left_m:.4} m rms instead of {best_m:.4} m"
        );
        Finding::new("lever", Verdict::Warn, "positions", what)
            .value(lever.norm(), "m")
            .remedy("express both in one body frame: `lsfb align` estimates the transform between them")
    })
}

/// Whether the clocks run apart, or one of them jumps: offsets that run evenly between a few times explain positions and orientations.
pub fn running_clock(pairs: &[PosePair], best_m: f64) -> Option<Finding> {
    let some = sampled(pairs);
    let best_m = error_of(&some, best_m);
    let weight = |s: &Sampled, knot: usize| {
        let at = s.time * (KNOTS - 1) as f64;
        (1.0 - (at - knot as f64).abs()).max(0.0)
    };
    let (found, left_m) = beside_similarity::<{ SIMILARITY + KNOTS }>(&some, |s, knot| {
        s.velocity_m_s * weight(s, knot)
    })?;
    if !(left_m < LESS * best_m) {
        return None;
    }
    let offsets = found.rows_range(SIMILARITY..).into_owned();
    // The turn between the bodies is part of neither.
    let off = |s: &Sampled| {
        let [truth, estimate] = [s.pair.truth, s.pair.estimate].map(|p| p.world_from_rig.rotation);
        (truth, estimate)
    };
    let world: Matrix3<f64> = some
        .iter()
        .map(|s| {
            let (truth, estimate) = off(s);
            *(truth * estimate.inverse()).to_rotation_matrix().matrix()
        })
        .sum();
    let world = so3::nearest(&world)?;
    let turned: Vec<(SMatrix<f64, 3, 7>, Vector3<f64>)> = some
        .iter()
        .map(|s| {
            let (truth, estimate) = off(s);
            let aligned = world * estimate;
            let late_secs: f64 = (0..KNOTS).map(|knot| weight(s, knot) * offsets[knot]).sum();
            let in_world = truth.inverse().to_rotation_matrix();
            let columns = SMatrix::<f64, 3, 7>::from_fn(|row, column| match column {
                0..3 => f64::from(u8::from(row == column)),
                3..6 => in_world.matrix()[(row, column - 3)],
                _ => -s.turning_rad_s[row] * late_secs,
            });
            (columns, so3::local(&truth, &aligned))
        })
        .collect();
    let without: Vec<(SMatrix<f64, 3, 6>, Vector3<f64>)> = turned
        .iter()
        .map(|(columns, off)| (columns.fixed_columns::<6>(0).into_owned(), *off))
        .collect();
    let ((scale, left_rad), (_, before_rad)) = (least_squares(&turned)?, least_squares(&without)?);
    // By orientations it is the same time, roughly.
    if !(left_rad < LESS_TURNED * before_rad && (0.5..2.0).contains(&scale[6])) {
        return None;
    }
    let (least, most) = (offsets.min(), offsets.max());
    let what = format!(
        "the clocks run at different rates: the estimate's stamps seem {least:.3} to {most:.3} s late; without that its error would be {left_m:.4} m rms instead of {best_m:.4} m"
    );
    let finding = Finding::new("clock", Verdict::Warn, "stamps", what).value(most - least, "s");
    Some(finding.remedy("stamp both with one clock, or align them in parts with `lsfb align`"))
}

/// Whether the orientations alone are late or early: positions and orientations of a row are then of different times.
pub fn late_turns(aligned: &[PosePair]) -> Option<Finding> {
    let rows: Vec<(SMatrix<f64, 3, 7>, Vector3<f64>)> = sampled(aligned)
        .iter()
        .map(|s| {
            let [truth, estimate] =
                [s.pair.truth, s.pair.estimate].map(|p| p.world_from_rig.rotation);
            let in_world = truth.inverse().to_rotation_matrix();
            let columns = SMatrix::<f64, 3, 7>::from_fn(|row, column| match column {
                0..3 => f64::from(u8::from(row == column)),
                3..6 => in_world.matrix()[(row, column - 3)],
                _ => -s.turning_rad_s[row],
            });
            (columns, so3::local(&truth, &estimate))
        })
        .collect();
    let turned: Vec<(SMatrix<f64, 3, 6>, Vector3<f64>)> = rows
        .iter()
        .map(|(columns, off)| (columns.fixed_columns::<6>(0).into_owned(), *off))
        .collect();
    let ((found, left_rad), (_, before_rad)) = (least_squares(&rows)?, least_squares(&turned)?);
    let late_secs = found[6];
    (left_rad < LESS * before_rad
        && before_rad > LEAST_LATE_RAD
        && late_secs.abs() > LEAST_OFFSET_SECS)
        .then(|| {
            let side = if late_secs > 0.0 { "late" } else { "early" };
            let what = format!(
                "the estimate's orientations seem {:.3} s {side}, but its positions do not: without that the rotation error would be {:.2}° rms instead of {:.2}°",
                late_secs.abs(),
                left_rad.to_degrees(),
                before_rad.to_degrees()
            );
            Finding::new("late-orientations", Verdict::Warn, "orientations", what)
                .value(late_secs, "s")
                .remedy("write position and orientation of the same time into a row")
        })
}

/// Whether the axes of the estimate are in units of their own, or one of them says nothing.
pub fn axes(pairs: &[PosePair], best_m: f64) -> Option<Finding> {
    let count = pairs.len() as f64;
    let mean =
        |of: fn(&PosePair) -> Vector3<f64>| pairs.iter().map(of).sum::<Vector3<f64>>() / count;
    let truth = |p: &PosePair| p.truth.world_from_rig.translation;
    let estimate = |p: &PosePair| p.estimate.world_from_rig.translation;
    let (mean_truth, mean_estimate) = (mean(truth), mean(estimate));
    let constant = (0..3).find(|axis| {
        let extent_m = pairs
            .iter()
            .map(|p| (estimate(p) - mean_estimate)[*axis].abs());
        extent_m.fold(0.0, f64::max) < 1e-9
    });
    let mut normal = Matrix4::<f64>::zeros();
    let mut right = Matrix4x3::<f64>::zeros();
    for pair in pairs {
        let mut column = Vector4::zeros();
        column
            .fixed_rows_mut::<3>(0)
            .copy_from(&(estimate(pair) - mean_estimate));
        column[3] = 1.0;
        normal += column * column.transpose();
        right += column * (truth(pair) - mean_truth).transpose();
    }
    if let Some(axis) = constant {
        normal[(axis, axis)] = count;
    }
    let factor = normal.cholesky()?;
    let found = factor.solve(&right);
    // Where the estimate's axes point in the truth's world, and how long its units are there.
    let of_axis: [Vector3<f64>; 3] = [0, 1, 2].map(|axis| found.row(axis).transpose());
    let left = |p: &PosePair| {
        let from = estimate(p) - mean_estimate;
        let placed = of_axis[0] * from.x + of_axis[1] * from.y + of_axis[2] * from.z;
        truth(p) - mean_truth - placed
    };
    let name = ["x", "y", "z"];
    if let Some(axis) = constant {
        let [first, second] = [(axis + 1) % 3, (axis + 2) % 3].map(|k| of_axis[k]);
        let normal = first.cross(&second).try_normalize(0.0)?;
        let across: f64 = pairs.iter().map(|p| left(p).dot(&normal).powi(2)).sum();
        let across_m = (across / count).sqrt();
        let rest_m = (best_m * best_m - across_m * across_m).max(0.0).sqrt();
        return (rest_m < LESS * best_m).then(|| {
            let axis = name[axis];
            let what = format!(
                "{axis} of the estimate is constant: that explains nearly all of the error; the truth leaves this plane by {across_m:.3} m rms"
            );
            Finding::new("axes", Verdict::Warn, "positions", what)
                .value(across_m, "m")
                .remedy("if the system has no third dimension, say so beside the figures; otherwise write the whole position")
        });
    }
    let sum: f64 = pairs.iter().map(|p| left(p).norm_squared()).sum();
    let left_m = (sum / count).sqrt();
    let lengths = of_axis.map(|axis| axis.norm());
    let most = lengths.into_iter().fold(0.0, f64::max);
    let least = lengths.into_iter().fold(f64::INFINITY, f64::min);
    let extent = [0, 1, 2].map(|axis| {
        let squares = pairs
            .iter()
            .map(|p| (estimate(p) - mean_estimate)[axis].powi(2));
        (squares.sum::<f64>() / count).sqrt()
    });
    // Along an axis on which hardly anything moves, a lean of it moves nothing, and is not known.
    let is_shear = (0..3).any(|k| {
        let next = (k + 1) % 3;
        let lean = (of_axis[k].dot(&of_axis[next]) / (lengths[k] * lengths[next])).abs();
        let moved_m = [k, next].map(|axis| lean * lengths[axis] * extent[axis]);
        !(lean < SHEAR || moved_m[0].min(moved_m[1]) < LESS * best_m)
    });
    (left_m < LESS * best_m && !is_shear && most > (1.0 + LEAST_AXIS) * least).then(|| {
        let [x, y, z] = lengths.map(|length| 1.0 / length);
        let what = format!(
            "the estimate's axes have different units: x, y, z are {x:.4}, {y:.4}, {z:.4} of the truth's; with one unit its error would be {left_m:.4} m rms instead of {best_m:.4} m"
        );
        Finding::new("axes", Verdict::Warn, "positions", what)
            .value(most / least, "")
            .remedy("write all three in metres")
    })
}

#[cfg(test)]
mod tests;
