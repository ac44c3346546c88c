//! Corners followed from one image to the next: patches moved until they agree (Lucas and Kanade), coarse first, and back again:
//! what does not come back to where it began was not the same thing.

use lsfb_geometry::Vector2;
use nalgebra::Matrix2;

use super::corners::corners;
use super::frame::{Frame, Gray, Registered};

/// Half the edge of a patch, pixels.
const HALF: i64 = 4;
const PATCH: usize = ((2 * HALF + 1) * (2 * HALF + 1)) as usize;
const ITERATIONS: usize = 12;
/// A step shorter than this ends the search, pixels.
const STILL_PX: f64 = 0.01;
/// Farther than this from where it was expected, a patch is another one, pixels.
const FAR_PX: f64 = 12.0;
/// Way there and back that still ends where it began, pixels.
const RETURN_PX: f64 = 0.5;
/// Share of the brightness's variance that may be left.
const MOST_LEFT: f64 = 0.5;
/// Gradients that a corner needs, grey levels squared: several times those of noise.
const FAINT: f64 = 400.0;

/// A corner in two images, as rays in either camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Track {
    pub first: nalgebra::Vector3<f64>,
    pub second: nalgebra::Vector3<f64>,
}

/// Corners of `a` that are found in `b`; `guess` says about where.
pub(super) fn follow(a: &Frame, b: &Frame, guess: &Registered) -> Vec<Track> {
    let [coarse_a, fine_a] = &a.fine;
    let [coarse_b, fine_b] = &b.fine;
    let found = corners(FAINT, fine_a.width(), fine_a.height(), |x, y| {
        fine_a.at(x, y)
    });
    found
        .iter()
        .filter_map(|corner| {
            let ray = fine_a.camera.unproject(corner)?;
            let expected = fine_b
                .camera
                .project(&(guess.b_from_a * ray + guess.shift))?;
            let start = halved(&expected);
            let near = shifted(coarse_a, coarse_b, &halved(corner), &start)?;
            let there = shifted(fine_a, fine_b, corner, &doubled(&near))?;
            let back = shifted(fine_b, fine_a, &there, corner)?;
            let same = (back - corner).norm() < RETURN_PX && (there - expected).norm() < FAR_PX;
            Some(Track {
                first: ray.normalize(),
                second: fine_b.camera.unproject(&there)?.normalize(),
            })
            .filter(|_| same)
        })
        .collect()
}

/// The same place in an image half as wide.
fn halved(pixel: &Vector2<f64>) -> Vector2<f64> {
    pixel.map(|c| 0.5 * (c + 0.5) - 0.5)
}

fn doubled(pixel: &Vector2<f64>) -> Vector2<f64> {
    pixel.map(|c| 2.0 * (c + 0.5) - 0.5)
}

/// Where the patch around `from` in one image lies in another.
fn shifted(
    first: &Gray,
    second: &Gray,
    from: &Vector2<f64>,
    start: &Vector2<f64>,
) -> Option<Vector2<f64>> {
    let mut values = [0.0; PATCH];
    let mut gradients = [Vector2::zeros(); PATCH];
    let mut structure = Matrix2::zeros();
    let (mut mean, mut mean_gradient) = (0.0, Vector2::zeros());
    for (k, offset) in offsets().enumerate() {
        (values[k], gradients[k]) = first.sample(&(from + offset))?;
        mean += values[k] / PATCH as f64;
        mean_gradient += gradients[k] / PATCH as f64;
    }
    // Brightness may change as a whole: only what differs within the patch counts.
    for gradient in &mut gradients {
        *gradient -= mean_gradient;
        structure += *gradient * gradient.transpose();
    }
    let inverse = structure.try_inverse()?;
    let variance: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    let mut at = *start;
    let mut left = f64::INFINITY;
    for _ in 0..ITERATIONS {
        let mut there = [0.0; PATCH];
        for (value, offset) in there.iter_mut().zip(offsets()) {
            *value = second.sample(&(at + offset))?.0;
        }
        let other = there.iter().sum::<f64>() / PATCH as f64;
        let mut right = Vector2::zeros();
        left = 0.0;
        for k in 0..PATCH {
            let error = (there[k] - other) - (values[k] - mean);
            right += gradients[k] * error;
            left += error * error;
        }
        let step = inverse * right;
        at -= step;
        if step.norm() < STILL_PX {
            break;
        }
    }
    (left < MOST_LEFT * variance).then_some(at)
}

fn offsets() -> impl Iterator<Item = Vector2<f64>> {
    (-HALF..=HALF).flat_map(|y| (-HALF..=HALF).map(move |x| Vector2::new(x as f64, y as f64)))
}
