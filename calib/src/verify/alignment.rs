//! LiDAR against images without a target, by one of two scores whose maximum over small rotations about the camera's axes
//! says by how much the camera is turned: mutual information (`mutual_information.rs`), or edges.
//!
//! Steps in range fall on edges of brightness where the rig is right.
//! `J(T) = Σ step(p) · E(project(T p)) / Σ step(p)`, where `E` is the image's gradient with a falloff around each edge
//! (Levinson and Thrun, "Automatic Online Calibration of Cameras and Lasers", 2013).

use lsfb_geometry::{Camera, Se3, Vector3, so3};
use lsfb_types::Image;
use rayon::prelude::*;

use super::frame::Gray;
use super::mutual_information::{Return, mutual_information};

/// Factor of the falloff per pixel of the reduced image, and the share that does not fall off to neighbours.
const FALLOFF: f32 = 0.92;
const OWN: f32 = 0.33;
/// Widest image used, pixels.
const MAX_WIDTH: u32 = 640;
/// Steps in range that count in full, and that begin to count, metres.
const FULL_STEP_M: f64 = 1.0;
const LEAST_STEP_M: f64 = 0.3;

/// A return with how far what lies beside it is behind it.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepPoint {
    /// In the rig at the image's time, metres.
    pub position: Vector3<f64>,
    pub weight: f64,
}

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Score {
    Edges,
    MutualInformation,
}

/// Edges of an image, with falloff.
pub(super) struct EdgeImage {
    pub camera: Camera,
    width: usize,
    strength: Vec<f32>,
    pub gray: Vec<f32>,
}

/// An image with the steps of the scan nearest in time.
pub(super) struct View {
    pub edges: EdgeImage,
    pub steps: Vec<StepPoint>,
    pub returns: Vec<Return>,
}

impl EdgeImage {
    pub fn new(image: &Image, camera: &Camera) -> Self {
        let factor = image.width.div_ceil(MAX_WIDTH).max(1);
        let gray = Gray::reduced(image, camera, factor);
        let (width, height) = (gray.width(), gray.height());
        let at = |x: usize, y: usize| gray.values[y * width + x];
        let mut strength = vec![0f32; width * height];
        for y in 1..height.saturating_sub(1) {
            for x in 1..width.saturating_sub(1) {
                let dx = at(x + 1, y) - at(x - 1, y);
                let dy = at(x, y + 1) - at(x, y - 1);
                strength[y * width + x] = dx.abs().max(dy.abs());
            }
        }
        // Half of the strongest gradients count in full: a lamp is not worth a hundred door frames.
        let mut sorted: Vec<f32> = strength.iter().step_by(7).copied().collect();
        sorted.sort_by(f32::total_cmp);
        let full = sorted
            .get(sorted.len() * 19 / 20)
            .copied()
            .unwrap_or(1.0)
            .max(1e-3);
        for s in &mut strength {
            *s = (*s / full).min(1.0);
        }
        let mut far = strength.clone();
        spread(&mut far, width, height);
        for (s, f) in strength.iter_mut().zip(&far) {
            *s = OWN * *s + (1.0 - OWN) * f;
        }
        // Less the image's mean, so that busy images do not draw points onto them.
        let mean = strength.iter().sum::<f32>() / strength.len().max(1) as f32;
        for s in &mut strength {
            *s -= mean;
        }
        Self {
            camera: gray.camera,
            width,
            strength,
            gray: gray.values,
        }
    }

    /// The image between pixels where a point is seen.
    pub fn at(&self, values: &[f32], point_in_camera: &Vector3<f64>) -> Option<f64> {
        if point_in_camera.z < 0.2 {
            return None;
        }
        let pixel = self.camera.project(point_in_camera)?;
        let inside = pixel.x >= 0.0
            && pixel.y >= 0.0
            && pixel.x < self.width as f64 - 1.0
            && pixel.y < f64::from(self.camera.height) - 1.0;
        if !inside {
            return None;
        }
        let (i, j) = (pixel.x as usize, pixel.y as usize);
        let (u, v) = (pixel.x - i as f64, pixel.y - j as f64);
        let value = |i: usize, j: usize| f64::from(values[j * self.width + i]);
        let top = value(i, j) * (1.0 - u) + value(i + 1, j) * u;
        let bottom = value(i, j + 1) * (1.0 - u) + value(i + 1, j + 1) * u;
        Some(top * (1.0 - v) + bottom * v)
    }
}

/// The largest neighbour times a factor, from all sides, in two passes.
fn spread(values: &mut [f32], width: usize, height: usize) {
    for y in 0..height {
        for x in 0..width {
            let mut most = values[y * width + x];
            if x > 0 {
                most = most.max(values[y * width + x - 1] * FALLOFF);
            }
            if y > 0 {
                most = most.max(values[(y - 1) * width + x] * FALLOFF);
            }
            values[y * width + x] = most;
        }
    }
    for y in (0..height).rev() {
        for x in (0..width).rev() {
            let mut most = values[y * width + x];
            if x + 1 < width {
                most = most.max(values[y * width + x + 1] * FALLOFF);
            }
            if y + 1 < height {
                most = most.max(values[(y + 1) * width + x] * FALLOFF);
            }
            values[y * width + x] = most;
        }
    }
}

/// Weight of a return whose neighbours are this much farther, metres.
pub(super) fn step_weight(farther_m: f64) -> Option<f64> {
    (farther_m > LEAST_STEP_M).then(|| (farther_m / FULL_STEP_M).min(1.0).sqrt())
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
            if let Some(strength) = view.edges.at(&view.edges.strength, &point) {
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
    /// About the camera's x, y and z axis, radians: `camera_from_rig` is to be multiplied from the left with its exponential.
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
    camera_from_rig: &Se3,
    by: Score,
) -> Option<Misalignment> {
    let usable = usable(views, by)?;
    let turn = best_turn(&usable, camera_from_rig, by);
    let parts: Vec<Vector3<f64>> = (0..GROUPS)
        .map(|g| {
            let part: Vec<&View> = usable.iter().skip(g).step_by(GROUPS).copied().collect();
            best_turn(&part, camera_from_rig, by)
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
    camera_from_rig: &Se3,
    turn: &Vector3<f64>,
    by: Score,
) -> f64 {
    let off = (0..LEFT_OUT).into_par_iter().map(|out| {
        let rest = views.iter().enumerate();
        let rest: Vec<&View> = rest
            .filter(|(k, _)| k % LEFT_OUT != out)
            .map(|v| *v.1)
            .collect();
        let found = search(&rest, camera_from_rig, turn, (AGAIN_RAD, ROUNDS - 1), by);
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

pub(super) fn turned(camera_from_rig: &Se3, turn: &Vector3<f64>) -> Se3 {
    Se3::new(so3::exp(turn), Vector3::zeros()) * *camera_from_rig
}

/// Axis by axis, then finer.
pub(super) fn best_turn(views: &[&View], camera_from_rig: &Se3, by: Score) -> Vector3<f64> {
    let start = Vector3::zeros();
    search(views, camera_from_rig, &start, (REACH_RAD, ROUNDS), by)
}

fn search(
    views: &[&View],
    camera_from_rig: &Se3,
    start: &Vector3<f64>,
    (mut reach, rounds): (f64, usize),
    by: Score,
) -> Vector3<f64> {
    let mut turn = *start;
    for _ in 0..rounds {
        for axis in [1, 0, 2] {
            turn[axis] = best_along(views, camera_from_rig, &turn, axis, reach, by);
        }
        reach *= 0.45;
    }
    turn
}

/// The best value about one axis: the largest of a grid, refined by its neighbours.
fn best_along(
    views: &[&View],
    camera_from_rig: &Se3,
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
        score(views, &turned(camera_from_rig, &trial), by)
    };
    let scores: Vec<f64> = (-SIDE..=SIDE).map(at).collect();
    let best = scores
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(b.1))
        .map_or(SIDE as usize, |b| b.0);
    let mut offset = best as f64 - f64::from(SIDE);
    if best > 0 && best + 1 < scores.len() {
        let (l, m, r) = (scores[best - 1], scores[best], scores[best + 1]);
        let bend = l + r - 2.0 * m;
        if bend < 0.0 {
            offset += (0.5 * (l - r) / bend).clamp(-0.5, 0.5);
        }
    }
    turn[axis] + offset * step
}
