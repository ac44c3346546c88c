//! Corners followed from one image to the next: patches moved until they agree (Lucas and Kanade), coarse first, and back again:
//! what does not come back to where it began was not the same thing. What is lost is looked for again where its neighbours went.

use lsfb_geometry::{UnitQuaternion, Vector2, Vector3};
use nalgebra::Matrix2;

use super::corners::corners;
use super::frame::{Frame, Gray, Registered, register};

/// Edge of a patch, and with its neighbours; pixels in it.
const EDGE: usize = 9;
const WIDER: usize = EDGE + 2;
const PATCH: f64 = (EDGE * EDGE) as f64;
const ITERATIONS: usize = 12;
/// A step shorter than this ends the search, pixels; one longer than the patch's half leads elsewhere.
const STILL_PX: f64 = 0.01;
const LEAP_PX: f64 = 4.0;
/// Way there and back that still ends where it began, pixels.
const RETURN_PX: f64 = 0.3;
/// Share of the brightness's variance that may be left.
const MOST_LEFT: f64 = 0.4;
/// Gradients that a corner needs, grey levels squared: several times those of noise.
const FAINT: f64 = 150.0;
/// Neighbours whose ways are tried for what was lost.
const NEIGHBOURS: usize = 3;

/// A corner in two images, as rays in either camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Track {
    pub first: Vector3<f64>,
    pub second: Vector3<f64>,
}

/// Two images of a camera, a tenth of a second apart or so.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    pub from_s: f64,
    pub to_s: f64,
    /// As the images as a whole say it.
    pub b_from_a: UnitQuaternion<f64>,
    pub tracks: Vec<Track>,
}

impl Pair {
    /// `None` where the images do not fit.
    pub fn new(a: &Frame, b: &Frame) -> Option<Self> {
        let guess = register(a, b)?;
        Some(Self {
            from_s: a.time_s,
            to_s: b.time_s,
            b_from_a: guess.b_from_a,
            tracks: follow(a, b, &guess),
        })
    }
}

/// Corners of `a` that are found in `b`; `guess` says about where.
fn follow(a: &Frame, b: &Frame, guess: &Registered) -> Vec<Track> {
    let (Some(fine_a), Some(fine_b)) = (a.fine.first(), b.fine.first()) else {
        return Vec::new();
    };
    let wanted: Vec<(Vector2<f64>, Vector2<f64>)> =
        corners(FAINT, fine_a.width(), fine_a.height(), |x, y| {
            fine_a.at(x, y)
        })
        .into_iter()
        .filter_map(|corner| {
            let ray = fine_a.camera.unproject(&corner)?;
            let turned = guess.b_from_a * ray + guess.shift;
            Some((corner, fine_b.camera.project(&turned)?))
        })
        .collect();
    let mut found: Vec<Option<Vector2<f64>>> = wanted
        .iter()
        .map(|(corner, start)| there_and_back(a, b, corner, start, a.fine.len()))
        .collect();
    let known: Vec<(Vector2<f64>, Vector2<f64>)> = wanted
        .iter()
        .zip(&found)
        .filter_map(|((corner, start), there)| Some((*corner, (*there)? - start)))
        .collect();
    for ((corner, start), there) in wanted.iter().zip(&mut found) {
        if there.is_none() {
            let mut near: Vec<(f64, Vector2<f64>)> = known
                .iter()
                .map(|(place, way)| ((place - corner).norm_squared(), *way))
                .collect();
            near.sort_by(|x, y| x.0.total_cmp(&y.0));
            *there = near
                .iter()
                .take(NEIGHBOURS)
                .find_map(|(_, way)| there_and_back(a, b, corner, &(start + way), 2));
        }
    }
    wanted
        .iter()
        .zip(found)
        .filter_map(|((corner, _), there)| {
            Some(Track {
                first: fine_a.camera.unproject(corner)?.normalize(),
                second: fine_b.camera.unproject(&there?)?.normalize(),
            })
        })
        .collect()
}

/// Where a corner went, from some level on; `None` where it does not come back.
fn there_and_back(
    a: &Frame,
    b: &Frame,
    corner: &Vector2<f64>,
    start: &Vector2<f64>,
    levels: usize,
) -> Option<Vector2<f64>> {
    let there = through(&a.fine, &b.fine, corner, start, levels)?;
    let back = shifted(b.fine.first()?, a.fine.first()?, &there, corner)?;
    ((back - corner).norm() < RETURN_PX).then_some(there)
}

/// Coarse first: a level that shows nothing leaves the guess as it was.
fn through(
    first: &[Gray],
    second: &[Gray],
    from: &Vector2<f64>,
    start: &Vector2<f64>,
    levels: usize,
) -> Option<Vector2<f64>> {
    let mut at = *start;
    for level in (1..levels.min(first.len())).rev() {
        let factor = f64::from(1 << level);
        let smaller = |pixel: &Vector2<f64>| pixel.map(|c| (c + 0.5) / factor - 0.5);
        let near = shifted(&first[level], &second[level], &smaller(from), &smaller(&at));
        at = near.map_or(at, |n| n.map(|c| factor * (c + 0.5) - 0.5));
    }
    shifted(first.first()?, second.first()?, from, &at)
}

/// Where the patch around `from` in one image lies in another.
fn shifted(
    first: &Gray,
    second: &Gray,
    from: &Vector2<f64>,
    start: &Vector2<f64>,
) -> Option<Vector2<f64>> {
    let own = first.window::<WIDER>(from)?;
    let (own_mean, mut gradients) = (inner_mean(&own), [[Vector2::zeros(); EDGE]; EDGE]);
    let mut mean_gradient = Vector2::zeros();
    for (y, row) in gradients.iter_mut().enumerate() {
        for (x, gradient) in row.iter_mut().enumerate() {
            let by_x = own[y + 1][x + 2] - own[y + 1][x];
            let by_y = own[y + 2][x + 1] - own[y][x + 1];
            *gradient = 0.5 * Vector2::new(by_x, by_y);
            mean_gradient += *gradient / PATCH;
        }
    }
    // Brightness may change as a whole: only what differs within the patch counts.
    let mut structure = Matrix2::zeros();
    for gradient in gradients.iter_mut().flatten() {
        *gradient -= mean_gradient;
        structure += *gradient * gradient.transpose();
    }
    let inverse = structure.try_inverse()?;
    let mut at = *start;
    let (mut left, mut variance) = (f64::INFINITY, 0.0);
    for _ in 0..ITERATIONS {
        let there = second.window::<WIDER>(&at)?;
        let mean = inner_mean(&there);
        let mut right = Vector2::zeros();
        (left, variance) = (0.0, 0.0);
        for (y, row) in gradients.iter().enumerate() {
            for (x, gradient) in row.iter().enumerate() {
                let value = own[y + 1][x + 1] - own_mean;
                let error = (there[y + 1][x + 1] - mean) - value;
                right += gradient * error;
                left += error * error;
                variance += value * value;
            }
        }
        let step = inverse * right;
        if step.norm() > LEAP_PX {
            return None;
        }
        at -= step;
        if step.norm() < STILL_PX {
            break;
        }
    }
    (left < MOST_LEFT * variance).then_some(at)
}

/// Mean of a window without its border.
fn inner_mean(window: &[[f64; WIDER]; WIDER]) -> f64 {
    let rows = &window[1..=EDGE];
    rows.iter().flat_map(|row| &row[1..=EDGE]).sum::<f64>() / PATCH
}
