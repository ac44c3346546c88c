//! Patches of images found again in others (Lucas and Kanade): moved until they agree, brightness and contrast of the whole patch
//! left aside.

use lsfb_geometry::Vector2;
use nalgebra::Matrix2;

use super::gray::Gray;
use lsfb_solver::gauss_newton::{Next, NormalEquations, minimise};

/// Edge of a patch, and with its neighbours; pixels in it.
const EDGE: usize = 9;
const WIDER: usize = EDGE + 2;
const PIXELS: usize = EDGE * EDGE;
/// Half of it, without its middle.
const HALF: i32 = (EDGE / 2) as i32;
const ITERATIONS: u32 = 20;
/// A step shorter than this ends the search, pixels; one longer than half the patch leads elsewhere.
const STILL_PX: f64 = 0.01;
const LEAP_PX: f64 = 4.0;
/// Grey levels by which a patch must differ from its mean, as a norm.
const LEAST_CONTRAST: f64 = 1.0;

/// What an image looks like around a place.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Less their mean, over their norm.
    values: [f64; PIXELS],
    gradients: [Vector2<f64>; PIXELS],
    /// Sum of the squares of the gradients.
    structure: Matrix2<f64>,
}

/// How a patch is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchSearch {
    /// Pixels there by pixels here.
    pub there_by_here: Matrix2<f64>,
    /// Share of the variance that may be left.
    pub most_left: f64,
}

impl Patch {
    /// Half the edge of a patch, pixels.
    pub const HALF_PX: f64 = HALF as f64;

    /// Around a place; `None` where it is not all inside, or blank.
    pub fn new(image: &Gray, middle: &Vector2<f64>) -> Option<Self> {
        let window = image.window::<WIDER>(middle)?;
        let mut values = [0.0; PIXELS];
        let mut gradients = [Vector2::zeros(); PIXELS];
        for y in 0..EDGE {
            for x in 0..EDGE {
                values[y * EDGE + x] = window[y + 1][x + 1];
                let by_x = window[y + 1][x + 2] - window[y + 1][x];
                let by_y = window[y + 2][x + 1] - window[y][x + 1];
                gradients[y * EDGE + x] = 0.5 * Vector2::new(by_x, by_y);
            }
        }
        let norm = normalize(&mut values)?;
        let mean = gradients.iter().sum::<Vector2<f64>>() / PIXELS as f64;
        let mut structure = Matrix2::zeros();
        for gradient in &mut gradients {
            *gradient = (*gradient - mean) / norm;
            structure += *gradient * gradient.transpose();
        }
        Some(Self {
            values,
            gradients,
            structure,
        })
    }

    /// Where in another image it is; `None` where it is not found near `start`.
    pub fn find(
        &self,
        image: &Gray,
        start: &Vector2<f64>,
        search: &PatchSearch,
    ) -> Option<Vector2<f64>> {
        let warp = &search.there_by_here;
        let mut left = f64::INFINITY;
        // The unknown is the way from `start`, in pixels of the patch.
        let terms = |way: &Vector2<f64>| {
            let there = seen(image, &(start + warp * way), warp)?;
            let mut terms = NormalEquations {
                information: self.structure,
                ..NormalEquations::default()
            };
            left = 0.0;
            for ((there, here), gradient) in there.iter().zip(&self.values).zip(&self.gradients) {
                let error = there - here;
                terms.gradient += gradient * error;
                left += error * error;
            }
            Some(terms)
        };
        let inspect = |step: &mut Vector2<f64>| {
            let length_px = (warp * *step).norm();
            if length_px < STILL_PX {
                Next::Settled
            } else if length_px > LEAP_PX {
                Next::Abandoned
            } else {
                Next::Iterate
            }
        };
        let found = minimise(Vector2::zeros(), ITERATIONS, terms, inspect)?;
        (found.settled && left < search.most_left).then(|| start + warp * found.value)
    }
}

/// The values of another image where a patch would be; `None` where it is not all inside, or blank.
fn seen(image: &Gray, middle: &Vector2<f64>, warp: &Matrix2<f64>) -> Option<[f64; PIXELS]> {
    let mut values = [0.0; PIXELS];
    if *warp == Matrix2::identity() {
        let window = image.window::<EDGE>(middle)?;
        values.copy_from_slice(window.as_flattened());
    } else {
        let sides = (-HALF..=HALF).flat_map(|y| (-HALF..=HALF).map(move |x| (x, y)));
        for (value, (x, y)) in values.iter_mut().zip(sides) {
            let offset = Vector2::new(f64::from(x), f64::from(y));
            *value = image.value(&(middle + warp * offset))?;
        }
    }
    normalize(&mut values)?;
    Some(values)
}

/// Takes the mean off and makes the norm one, which it gives; `None` where the patch is blank.
fn normalize(values: &mut [f64; PIXELS]) -> Option<f64> {
    let mean = values.iter().sum::<f64>() / PIXELS as f64;
    let norm = values
        .iter()
        .map(|v| (v - mean).powi(2))
        .sum::<f64>()
        .sqrt();
    if !(norm > LEAST_CONTRAST) {
        return None;
    }
    for value in values {
        *value = (*value - mean) / norm;
    }
    Some(norm)
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Camera;

    use super::*;

    fn image(value: impl Fn(Vector2<f64>) -> f64) -> Gray {
        let values = (0..60 * 60).map(|k| {
            let pixel = Vector2::new(f64::from(k % 60), f64::from(k / 60));
            value(pixel) as f32
        });
        Gray {
            camera: Camera::pinhole(60, 60, [50.0; 2], [29.5; 2]),
            values: values.collect(),
        }
    }

    #[test]
    fn a_patch_is_found_turned_brighter_and_elsewhere() {
        let blob = |p: Vector2<f64>| {
            let d = p - Vector2::new(30.0, 30.0);
            100.0 + 60.0 * (0.4 * d.x).sin() * (0.3 * d.y + 0.5).cos()
        };
        let warp = Matrix2::new(0.96, -0.2, 0.2, 0.96);
        let there_px = Vector2::new(31.7, 28.4);
        let back = warp.try_inverse().expect("a turn");
        let other = image(|p| 30.0 + 0.7 * blob(Vector2::new(30.0, 30.0) + back * (p - there_px)));
        let patch = Patch::new(&image(blob), &Vector2::new(30.0, 30.0)).expect("inside");
        let search = PatchSearch {
            there_by_here: warp,
            most_left: 0.1,
        };
        let found = patch.find(&other, &Vector2::new(30.5, 29.5), &search);
        assert!(
            (found.expect("found") - there_px).norm() < 0.05,
            "{found:?}"
        );
        let blank = image(|_| 100.0);
        assert!(Patch::new(&blank, &Vector2::new(30.0, 30.0)).is_none());
        assert!(
            patch
                .find(&blank, &Vector2::new(30.0, 30.0), &search)
                .is_none()
        );
    }
}
