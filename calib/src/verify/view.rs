//! An image with its edges, beside what the scan of its time shows.

use lsfb_geometry::{Camera, Vector3};
use lsfb_perception::image::Gray;
use lsfb_types::Image;

/// Factor of the falloff per pixel of the reduced image, and the share that does not fall off to neighbours.
const FALLOFF: f32 = 0.92;
const OWN: f32 = 0.33;
/// Widest image used, pixels.
const MAX_WIDTH: u32 = 640;
/// Nearest that a point may be before the camera, metres.
const NEAREST_M: f64 = 0.2;
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

/// A return with its reflectivity as a bin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Return {
    /// In the rig at the image's time, metres.
    pub position: Vector3<f64>,
    pub bin: usize,
}

/// Edges of an image, with falloff.
pub(super) struct EdgeImage {
    /// How strong the edges are, of the image's mean.
    pub strength: Gray,
    /// Brightness.
    pub gray: Gray,
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
            strength: Gray {
                camera: gray.camera,
                values: strength,
            },
            gray,
        }
    }
}

/// The value of an image where a point is seen; `None` where it is not.
pub(super) fn seen_at(image: &Gray, point_in_camera: &Vector3<f64>) -> Option<f64> {
    if point_in_camera.z < NEAREST_M {
        return None;
    }
    image.value(&image.camera.project(point_in_camera)?)
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
