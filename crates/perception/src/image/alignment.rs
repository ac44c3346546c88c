//! How two images are turned to each other, roughly: registered as a whole, by a rotation and a translation before a wall at
//! constant distance. What is followed from corner to corner makes it exact.

use lsfb_geometry::{Camera, UnitQuaternion, Vector2, Vector3};
use lsfb_types::Image;
use nalgebra::{SVector, Vector6};

use super::gray::Gray;
use lsfb_solver::gauss_newton::{NormalEquations, minimise, until_shorter_than};

/// Width of the images that are registered as a whole, coarse first, pixels.
const WIDTHS: [u32; 2] = [64, 160];
/// Widest image in which corners are followed, pixels.
const FINE_WIDTH: u32 = 640;
/// Levels of the pyramid in which they are followed at most, and the narrowest one, pixels.
const FINE_LEVELS: u32 = 4;
const LEAST_WIDTH: u32 = 60;
const ITERATIONS: u32 = 8;
/// A step shorter than this ends the search: radians, and shares of the distance.
const SHORTEST: f64 = 1e-5;
/// Brightness error at which a pixel's weight is halved, in units of the image's contrast.
const SCALE: f64 = 0.4;
/// Weight of no translation at all: a twentieth of the distance is a standard deviation where contrast errs by a tenth.
const REST: f64 = 4.0;
/// Pixels that must be seen in both images.
const MIN_PIXELS: usize = 200;

/// An image ready to be compared with its neighbours.
#[derive(Clone, Debug)]
pub struct Frame {
    /// When it was taken, seconds.
    pub time_s: f64,
    /// Contrast, registered as a whole.
    levels: Vec<Gray>,
    /// Brightness in which corners are followed, each half as wide as the one before.
    pub(super) fine: Vec<Gray>,
}

impl Frame {
    /// Of an image taken at `time_s` with a camera of its size.
    pub fn new(time_s: f64, image: &Image, camera: &Camera) -> Self {
        let level = |width: &u32| {
            let factor = (image.width / width).max(1);
            Gray::reduced(image, camera, factor).contrast()
        };
        let factor = image.width.div_ceil(FINE_WIDTH).max(1);
        Self {
            time_s,
            levels: WIDTHS.iter().map(level).collect(),
            fine: (0..FINE_LEVELS)
                .map(|k| factor << k)
                .filter(|f| image.width / f >= LEAST_WIDTH)
                .map(|f| Gray::reduced(image, camera, f).smoothed())
                .collect(),
        }
    }
}

/// One image to another.
#[derive(Clone, Copy, Debug)]
pub struct Alignment {
    /// Directions of the first camera in the second.
    pub b_from_a: UnitQuaternion<f64>,
    /// Translation over the distance of the scene.
    pub shift: Vector3<f64>,
}

/// How two images are turned, and moved over the distance of the scene; `None` where they do not fit.
pub fn align(a: &Frame, b: &Frame) -> Option<Alignment> {
    let mut unknowns = (UnitQuaternion::identity(), Vector3::zeros());
    for (first, second) in a.levels.iter().zip(&b.levels) {
        let width = first.width();
        let rays: Vec<(f64, Vector3<f64>)> = first
            .values
            .iter()
            .enumerate()
            .step_by(3)
            .filter_map(|(k, value)| {
                let pixel = Vector2::new((k % width) as f64, (k / width) as f64);
                Some((f64::from(*value), first.camera.unproject(&pixel)?))
            })
            .collect();
        let terms = |(b_from_a, shift): &(UnitQuaternion<f64>, Vector3<f64>)| {
            contrast_errors(&rays, second, b_from_a, shift)
        };
        unknowns = minimise(unknowns, ITERATIONS, terms, until_shorter_than(SHORTEST))?.value;
    }
    let (b_from_a, shift) = unknowns;
    Some(Alignment { b_from_a, shift })
}

fn contrast_errors(
    rays: &[(f64, Vector3<f64>)],
    second: &Gray,
    b_from_a: &UnitQuaternion<f64>,
    shift: &Vector3<f64>,
) -> Option<NormalEquations<6>> {
    let mut terms = NormalEquations::default();
    let mut count = 0;
    for (value, ray) in rays {
        let point = b_from_a * ray + shift;
        let Some(seen) = second.camera.project_with_jacobian(&point) else {
            continue;
        };
        let (Some(there), Some(gradient)) =
            (second.value(&seen.pixel), second.gradient(&seen.pixel))
        else {
            continue;
        };
        let error = there - value;
        let weight = 1.0 / (1.0 + (error / SCALE).powi(2));
        // R exp(φ) a moves by R (φ × a), and g · R (φ × a) = φ · (a × Rᵀ g).
        let by_shift = seen.pixel_by_point.transpose() * gradient;
        let by_turn = ray.cross(&b_from_a.inverse_transform_vector(&by_shift));
        let derivative: SVector<f64, 6> = Vector6::new(
            by_turn.x, by_turn.y, by_turn.z, by_shift.x, by_shift.y, by_shift.z,
        );
        terms.add(error, &derivative, weight);
        count += 1;
    }
    for k in 0..3 {
        terms.information[(3 + k, 3 + k)] += REST;
        terms.gradient[3 + k] += REST * shift[k];
    }
    (count >= MIN_PIXELS).then_some(terms)
}
