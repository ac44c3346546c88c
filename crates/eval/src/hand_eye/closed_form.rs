//! A first answer without a guess: rotation, then translation of one body in the other, from motions that both made.

use lsfb_geometry::{Matrix3, Se3, UnitQuaternion, Vector3, so3};
use lsfb_solver::gauss_newton::NormalEquations;
use lsfb_types::median;

use crate::Error;

/// Times between the two poses of a motion, seconds: short ones for fast turns, long ones for large.
const LAGS_SECS: [f64; 3] = [0.5, 1.0, 2.0];
/// Turns below this say nothing about an axis.
const LEAST_TURN_RAD: f64 = 0.03;
/// Angles of one motion may differ by this share and this much between the bodies, or one of them was measured wrongly.
const SAME_TURN: (f64, f64) = (0.1, 0.02);
/// Turns about the second axis that are needed, root mean square over all motions.
const LEAST_SECOND_TURN_RAD: f64 = 0.0175;

/// The same moment in both trajectories.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    pub secs: f64,
    /// `H_T_A`.
    pub estimate: Se3,
    /// `G_T_N`.
    pub reference: Se3,
}

/// How much the bodies turned, about which axes.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Excitation {
    /// Turns about the three axes that are most turned about, degrees rms over 0.5 to 2 s, the largest first.
    pub turn_rms_deg: [f64; 3],
    /// The axis turned about most, in the estimate's body.
    pub main_axis: [f64; 3],
}

/// `N_T_A` and `G_T_H`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pair {
    pub reference_from_estimate_body: Se3,
    pub reference_from_estimate_world: Se3,
}

/// Moments must be in order of time.
pub(super) fn closed_form(moments: &[Moment]) -> Result<(Pair, Excitation), Error> {
    let motions = motions(moments);
    let mut scatter = Matrix3::zeros();
    let mut crossed = Matrix3::zeros();
    for motion in &motions {
        scatter += motion.turn * motion.turn.transpose();
        crossed += motion.reference_turn * motion.turn.transpose();
    }
    let count = motions.len().max(1) as f64;
    let axes = (scatter / count).symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| axes.eigenvalues[*b].total_cmp(&axes.eigenvalues[*a]));
    let rms = order.map(|k| axes.eigenvalues[k].max(0.0).sqrt());
    let excitation = Excitation {
        turn_rms_deg: rms.map(f64::to_degrees),
        main_axis: axes.eigenvectors.column(order[0]).into_owned().into(),
    };
    if !(rms[1] >= LEAST_SECOND_TURN_RAD) {
        return Err(Error::OneAxis {
            first_deg: excitation.turn_rms_deg[0],
            second_deg: excitation.turn_rms_deg[1],
        });
    }
    let rotation = so3::nearest(&crossed).ok_or(Error::Degenerate)?;
    let body = Se3::new(rotation, lever(&motions, &rotation)?);
    Ok((
        Pair {
            reference_from_estimate_body: body,
            reference_from_estimate_world: world(moments, &body),
        },
        excitation,
    ))
}

/// A motion that both made.
struct Motion {
    /// Rotation vector in the estimate's body.
    turn: Vector3<f64>,
    /// In the reference's.
    reference_turn: Vector3<f64>,
    estimate: Se3,
    reference: Se3,
}

fn motions(moments: &[Moment]) -> Vec<Motion> {
    let mut found = Vec::new();
    for lag_secs in LAGS_SECS {
        for from in moments {
            let next = moments.partition_point(|m| m.secs < from.secs + lag_secs);
            let Some(to) = moments
                .get(next)
                .filter(|to| to.secs < from.secs + 1.5 * lag_secs)
            else {
                continue;
            };
            let estimate = from.estimate.inverse() * to.estimate;
            let reference = from.reference.inverse() * to.reference;
            let (turn, reference_turn) =
                (so3::log(&estimate.rotation), so3::log(&reference.rotation));
            let (angle, other) = (turn.norm(), reference_turn.norm());
            let is_same = (angle - other).abs() < SAME_TURN.0 * angle + SAME_TURN.1;
            // Near half a turn the vector may point either way.
            if is_same && angle > LEAST_TURN_RAD && angle.max(other) < 3.0 {
                found.push(Motion {
                    turn,
                    reference_turn,
                    estimate,
                    reference,
                });
            }
        }
    }
    found
}

/// `(R_a − I) t = R_Y t_b − t_a` of all motions, twice: the second time without those that miss by far.
fn lever(motions: &[Motion], rotation: &UnitQuaternion<f64>) -> Result<Vector3<f64>, Error> {
    let equation = |m: &Motion| {
        let left = m.reference.rotation_matrix() - Matrix3::identity();
        (
            left,
            rotation * m.estimate.translation - m.reference.translation,
        )
    };
    let solve = |most_m: f64, near: Option<Vector3<f64>>| {
        let mut equations = NormalEquations::<3>::default();
        for (a, b) in motions.iter().map(equation) {
            if near.is_none_or(|t| (a * t - b).norm() <= most_m) {
                equations.add_block(&-b, &a, 1.0);
            }
        }
        equations.step().ok_or(Error::Degenerate)
    };
    let mut lever = solve(f64::INFINITY, None)?;
    for _ in 0..3 {
        let misses = motions
            .iter()
            .map(equation)
            .map(|(a, b)| (a * lever - b).norm())
            .collect();
        let usual_m = median(misses).unwrap_or(0.0);
        lever = solve(3.0 * usual_m + 1e-9, Some(lever))?;
    }
    Ok(lever)
}

/// The world's pose by the moment that agrees best with the others.
fn world(moments: &[Moment], body: &Se3) -> Se3 {
    let step = (moments.len() / 60).max(1);
    let guesses: Vec<Se3> = moments
        .iter()
        .step_by(step)
        .map(|m| m.reference * *body * m.estimate.inverse())
        .collect();
    let distance = |a: &Se3| {
        let off = moments
            .iter()
            .step_by(step)
            .map(|m| {
                let miss = ((*a * m.estimate).inverse() * m.reference * *body).log();
                miss.norm()
            })
            .collect();
        median(off).unwrap_or(f64::INFINITY)
    };
    let best = guesses
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)));
    best.copied().unwrap_or_else(Se3::identity)
}
