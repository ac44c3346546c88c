//! LiDAR against images without a target, by one of two scores whose maximum over small rotations about the camera's axes
//! says by how much the camera is turned: mutual information (`mutual_information.rs`), or edges.
//!
//! Steps in range fall on edges of brightness where the rig is right.
//! `J(T) = Σ step(p) · E(project(T p)) / Σ step(p)`, where `E` is the image's gradient with a falloff around each edge
//! (Levinson and Thrun, "Automatic Online Calibration of Cameras and Lasers", 2013).

use lsfb_geometry::{Se3, Vector3, Vector6};
use lsfb_perception::statistics::peak;
use rayon::prelude::*;

use super::mutual_information::mutual_information;
use super::view::{View, seen_at};

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Score {
    Edges,
    MutualInformation,
}

/// How well views fit.
fn score(views: &[&View], camera_from_rig: &Se3, by: Score) -> f64 {
    match by {
        Score::Edges => edge_strength(views, camera_from_rig),
        Score::MutualInformation => mutual_information(views, camera_from_rig),
    }
}

/// Mean edge strength below the steps of some views.
fn edge_strength(views: &[&View], camera_from_rig: &Se3) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for view in views {
        for step in &view.steps {
            let point = *camera_from_rig * step.position;
            if let Some(strength) = seen_at(&view.edges.strength, &point) {
                sum += strength * step.weight;
                total += step.weight;
            }
        }
    }
    if total > 0.0 { sum / total } else { 0.0 }
}

/// How a camera would have to be turned for LiDAR and images to fit best.
#[derive(Clone, Copy, Debug)]
pub(super) struct Misalignment {
    /// About the camera's x, y and z axis, radians: its pose on the rig is to be moved by it.
    pub turn: Vector3<f64>,
    /// Standard deviation, from groups of views.
    pub sigma_rad: Vector3<f64>,
}

/// Groups of views whose answers are compared.
const GROUPS: usize = 4;
/// Parts of the views that are left out in turn.
const LEFT_OUT: usize = 6;
/// Rotations searched at first about each axis, radians, and those around one that was found; rounds, each finer.
const REACH_RAD: f64 = 0.045;
const AGAIN_RAD: f64 = 0.02;
const ROUNDS: usize = 4;

/// Views that show enough; `None` with fewer than groups.
pub(super) fn usable(views: &[View], by: Score) -> Option<Vec<&View>> {
    let enough = |v: &&View| match by {
        Score::Edges => v.steps.len() >= 20,
        Score::MutualInformation => v.returns.len() >= 200,
    };
    let usable: Vec<&View> = views.iter().filter(enough).collect();
    (usable.len() >= GROUPS).then_some(usable)
}

/// The best small rotation; `None` with fewer views than groups.
pub(super) fn misalignment(
    views: &[View],
    rig_from_camera: &Se3,
    by: Score,
) -> Option<Misalignment> {
    let usable = usable(views, by)?;
    let turn = best_turn(&usable, rig_from_camera, by);
    let parts: Vec<Vector3<f64>> = (0..GROUPS)
        .map(|g| {
            let part: Vec<&View> = usable.iter().skip(g).step_by(GROUPS).copied().collect();
            best_turn(&part, rig_from_camera, by)
        })
        .collect();
    let mean = parts.iter().sum::<Vector3<f64>>() / GROUPS as f64;
    let variance = parts
        .iter()
        .map(|p| (p - mean).component_mul(&(p - mean)))
        .sum::<Vector3<f64>>()
        / (GROUPS - 1) as f64;
    Some(Misalignment {
        turn,
        sigma_rad: (variance / GROUPS as f64).map(f64::sqrt),
    })
}

/// What a rotation is known to, by how far it moves when a part of the views is left out; the middle one of the parts, so that one in
/// which little is to be seen does not count.
pub(super) fn scatter_rad(
    views: &[&View],
    rig_from_camera: &Se3,
    turn: &Vector3<f64>,
    by: Score,
) -> f64 {
    let off = (0..LEFT_OUT).into_par_iter().map(|out| {
        let rest = views.iter().enumerate();
        let rest: Vec<&View> = rest
            .filter(|(k, _)| k % LEFT_OUT != out)
            .map(|v| *v.1)
            .collect();
        let found = search(&rest, rig_from_camera, turn, (AGAIN_RAD, ROUNDS - 1), by);
        (found - turn).norm()
    });
    let mut off: Vec<f64> = off.collect();
    off.sort_by(f64::total_cmp);
    let middle = 0.5 * (off[(LEFT_OUT - 1) / 2] + off[LEFT_OUT / 2]);
    // As the jackknife has it, of parts that are alike.
    middle * ((LEFT_OUT - 1) as f64).sqrt()
}

/// Whether a rotation is where the search ends.
pub(super) fn at_the_end(turn: &Vector3<f64>) -> bool {
    turn.amax() > 1.6 * REACH_RAD
}

/// A camera's pose, turned about the camera's axes.
pub(super) fn turned(rig_from_camera: &Se3, turn: &Vector3<f64>) -> Se3 {
    rig_from_camera.retract(&Vector6::new(turn.x, turn.y, turn.z, 0.0, 0.0, 0.0))
}

/// Axis by axis, then finer.
pub(super) fn best_turn(views: &[&View], rig_from_camera: &Se3, by: Score) -> Vector3<f64> {
    let start = Vector3::zeros();
    search(views, rig_from_camera, &start, (REACH_RAD, ROUNDS), by)
}

fn search(
    views: &[&View],
    rig_from_camera: &Se3,
    start: &Vector3<f64>,
    (mut reach, rounds): (f64, usize),
    by: Score,
) -> Vector3<f64> {
    let mut turn = *start;
    for _ in 0..rounds {
        for axis in [1, 0, 2] {
            turn[axis] = best_along(views, rig_from_camera, &turn, axis, reach, by);
        }
        reach *= 0.45;
    }
    turn
}

/// The best value about one axis, from a grid.
fn best_along(
    views: &[&View],
    rig_from_camera: &Se3,
    turn: &Vector3<f64>,
    axis: usize,
    reach: f64,
    by: Score,
) -> f64 {
    const SIDE: i32 = 9;
    let step = reach / f64::from(SIDE);
    let at = |k: i32| {
        let mut trial = *turn;
        trial[axis] += f64::from(k) * step;
        score(views, &turned(rig_from_camera, &trial).inverse(), by)
    };
    let scores: Vec<f64> = (-SIDE..=SIDE).map(at).collect();
    let middle = f64::from(SIDE);
    turn[axis] + (peak(&scores).unwrap_or(middle) - middle) * step
}
