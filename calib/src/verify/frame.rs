//! Images made smaller with their cameras, and how two of them are turned to each other, roughly: registered as a whole, by a
//! rotation and a translation before a wall at constant distance. `tracks.rs` and `relative.rs` make it exact.

use lsfb_geometry::camera::MAX_PARAMETERS;
use lsfb_geometry::{Camera, Matrix6, UnitQuaternion, Vector2, Vector3, Vector6, so3};
use lsfb_types::Image;
use nalgebra::Matrix1x6;

/// Width of the images that are registered as a whole, coarse first, pixels.
const WIDTHS: [u32; 2] = [64, 160];
/// Widest image in which corners are followed, pixels.
const FINE_WIDTH: u32 = 640;
/// Levels of the pyramid in which they are followed at most, and the narrowest one, pixels.
const FINE_LEVELS: u32 = 4;
const LEAST_WIDTH: u32 = 60;
const ITERATIONS: usize = 8;
/// Brightness error at which a pixel's weight is halved, in units of the image's contrast.
const SCALE: f64 = 0.4;
/// Weight of no translation at all: a twentieth of the distance is a standard deviation where contrast errs by a tenth.
const REST: f64 = 4.0;

/// A reduced image with its camera.
#[derive(Clone)]
pub(super) struct Gray {
    pub camera: Camera,
    pub values: Vec<f32>,
}

/// An image ready to be compared with its neighbours.
#[derive(Clone)]
pub(super) struct Frame {
    pub time_s: f64,
    /// Contrast, registered as a whole.
    levels: Vec<Gray>,
    /// Brightness in which corners are followed, each half as wide as the one before.
    pub fine: Vec<Gray>,
}

impl Frame {
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

impl Gray {
    /// Means over squares of pixels.
    pub fn reduced(image: &Image, camera: &Camera, factor: u32) -> Self {
        let (width, height) = (image.width / factor, image.height / factor);
        Self {
            camera: reduced(camera, f64::from(factor), width, height),
            values: averaged(image, factor),
        }
    }

    /// Exposure changes: what is compared is contrast, not brightness.
    fn contrast(mut self) -> Self {
        let n = self.values.len().max(1) as f32;
        let mean = self.values.iter().sum::<f32>() / n;
        let squares = self.values.iter().map(|v| (v - mean).powi(2));
        let spread = (squares.sum::<f32>() / n).sqrt();
        for value in &mut self.values {
            *value = (*value - mean) / spread.max(1.0);
        }
        self
    }

    /// Each pixel with its neighbours, 1 : 2 : 1 both ways: finer than that nothing can be followed.
    fn smoothed(mut self) -> Self {
        let (width, height) = (self.width(), self.height());
        for row in self.values.chunks_exact_mut(width.max(1)) {
            let mut before = row[0];
            for x in 1..width.saturating_sub(1) {
                let own = row[x];
                row[x] = 0.25 * (before + 2.0 * own + row[x + 1]);
                before = own;
            }
        }
        let mut before = self.values[..width.min(self.values.len())].to_vec();
        for y in 1..height.saturating_sub(1) {
            for (x, above) in before.iter_mut().enumerate() {
                let own = self.values[y * width + x];
                let below = self.values[(y + 1) * width + x];
                self.values[y * width + x] = 0.25 * (*above + 2.0 * own + below);
                *above = own;
            }
        }
        self
    }

    pub fn width(&self) -> usize {
        self.camera.width as usize
    }

    pub fn height(&self) -> usize {
        self.camera.height as usize
    }

    pub fn at(&self, x: usize, y: usize) -> f64 {
        f64::from(self.values[y * self.width() + x])
    }

    /// A square of `N` × `N` values a pixel apart around a place between pixels, row by row; `None` where it is not all inside.
    pub fn window<const N: usize>(&self, middle: &Vector2<f64>) -> Option<[[f64; N]; N]> {
        let first = middle.map(|c| c - (N / 2) as f64);
        let last = first.map(|c| c + N as f64);
        let (width, height) = (self.width(), self.height());
        let inside =
            first.x >= 0.0 && first.y >= 0.0 && last.x < width as f64 && last.y < height as f64;
        if !inside {
            return None;
        }
        let (i, j) = (first.x as usize, first.y as usize);
        let (u, v) = (first.x - i as f64, first.y - j as f64);
        let mut out = [[0.0; N]; N];
        for (y, out) in out.iter_mut().enumerate() {
            let start = (j + y) * width + i;
            let above = self.values.get(start..=start + N)?;
            let below = self.values.get(start + width..=start + width + N)?;
            let down = |x: usize| {
                let (a, b) = (f64::from(above[x]), f64::from(below[x]));
                a + (b - a) * v
            };
            let mut left = down(0);
            for (x, out) in out.iter_mut().enumerate() {
                let right = down(x + 1);
                *out = left + (right - left) * u;
                left = right;
            }
        }
        Some(out)
    }

    /// Between pixels, with the gradient; `None` outside.
    pub fn sample(&self, at: &Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        let (width, height) = (self.width(), self.height());
        let inside =
            at.x >= 0.0 && at.y >= 0.0 && at.x < width as f64 - 1.0 && at.y < height as f64 - 1.0;
        if !inside {
            return None;
        }
        let (i, j) = (at.x as usize, at.y as usize);
        let (u, v) = (at.x - i as f64, at.y - j as f64);
        let (a, b, c, d) = (
            self.at(i, j),
            self.at(i + 1, j),
            self.at(i, j + 1),
            self.at(i + 1, j + 1),
        );
        let (top, bottom) = (a + (b - a) * u, c + (d - c) * u);
        let gradient = Vector2::new((b - a) * (1.0 - v) + (d - c) * v, bottom - top);
        Some((top + (bottom - top) * v, gradient))
    }
}

/// An image made smaller: means over squares of pixels.
fn averaged(image: &Image, factor: u32) -> Vec<f32> {
    let (width, height) = (image.width / factor, image.height / factor);
    let mut values = Vec::with_capacity((width * height) as usize);
    let share = 1.0 / (factor * factor) as f32;
    for y in 0..height {
        for x in 0..width {
            let mut sum = 0u32;
            for v in 0..factor {
                let start = ((y * factor + v) * image.width + x * factor) as usize;
                let row = image.pixels.get(start..start + factor as usize);
                sum += row
                    .unwrap_or_default()
                    .iter()
                    .map(|p| u32::from(*p))
                    .sum::<u32>();
            }
            values.push(sum as f32 * share);
        }
    }
    values
}

/// The camera of an image made smaller by averaging squares of pixels.
fn reduced(camera: &Camera, factor: f64, width: u32, height: u32) -> Camera {
    let mut values = [0.0; MAX_PARAMETERS];
    values.copy_from_slice(&camera.lens.parameters().values);
    values[0] /= factor;
    values[1] /= factor;
    values[2] = (values[2] + 0.5) / factor - 0.5;
    values[3] = (values[3] + 0.5) / factor - 0.5;
    Camera {
        width,
        height,
        lens: camera.lens.model().lens(&values),
    }
}

/// One image to another.
pub(super) struct Registered {
    pub b_from_a: UnitQuaternion<f64>,
    /// Translation over the distance of the scene.
    pub shift: Vector3<f64>,
}

/// How two images are turned, and moved over the distance of the scene; `None` where they do not fit.
pub(super) fn register(a: &Frame, b: &Frame) -> Option<Registered> {
    let mut b_from_a = UnitQuaternion::identity();
    // Over the distance of the scene.
    let mut shift = Vector3::zeros();
    for (first, second) in a.levels.iter().zip(&b.levels) {
        let width = first.camera.width as usize;
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
        for _ in 0..ITERATIONS {
            let mut normal = Matrix6::from_diagonal(&Vector6::new(0.0, 0.0, 0.0, REST, REST, REST));
            let mut right = Vector6::zeros();
            right.fixed_rows_mut::<3>(3).copy_from(&(-shift * REST));
            let mut count = 0;
            for (value, ray) in &rays {
                let turned = b_from_a * ray;
                let Some(seen) = second.camera.project_with_jacobian(&(turned + shift)) else {
                    continue;
                };
                let Some((there, gradient)) = second.sample(&seen.pixel) else {
                    continue;
                };
                let error = there - value;
                let weight = 1.0 / (1.0 + (error / SCALE).powi(2));
                // exp(φ) R ray moves by φ × R ray.
                let by_point = gradient.transpose() * seen.pixel_by_point;
                let by_turn = -(by_point * so3::hat(&turned));
                let row = Matrix1x6::new(
                    by_turn.x, by_turn.y, by_turn.z, by_point.x, by_point.y, by_point.z,
                );
                normal += row.transpose() * row * weight;
                right -= row.transpose() * (error * weight);
                count += 1;
            }
            if count < 200 {
                return None;
            }
            let step = normal.cholesky()?.solve(&right);
            b_from_a = so3::exp(&step.fixed_rows::<3>(0).into()) * b_from_a;
            shift += step.fixed_rows::<3>(3);
            if step.norm() < 1e-5 {
                break;
            }
        }
    }
    Some(Registered { b_from_a, shift })
}
