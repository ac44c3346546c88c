//! Images made smaller, with their cameras.

use lsfb_geometry::camera::MAX_PARAMETERS;
use lsfb_geometry::{Camera, Vector2};
use lsfb_types::Image;

use super::Around;

/// An image of real values with its camera.
#[derive(Clone, Debug)]
pub struct Gray {
    /// The lens, for this size.
    pub camera: Camera,
    /// Row by row.
    pub values: Vec<f32>,
}

impl Gray {
    /// The image as it is.
    pub fn new(image: &Image, camera: &Camera) -> Self {
        Self::reduced(image, camera, 1)
    }

    /// Means over squares of `factor` × `factor` pixels.
    pub fn reduced(image: &Image, camera: &Camera, factor: u32) -> Self {
        let (width, height) = (image.width / factor, image.height / factor);
        Self {
            camera: reduced(camera, f64::from(factor), width, height),
            values: averaged(image, factor),
        }
    }

    /// With mean zero and spread one: exposure changes, contrast is compared.
    pub fn contrast(mut self) -> Self {
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
    pub fn smoothed(mut self) -> Self {
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

    /// Columns.
    pub fn width(&self) -> usize {
        self.camera.width as usize
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.camera.height as usize
    }

    /// The value of a pixel inside.
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

    /// The pixels around a place; `None` outside.
    fn around(&self, at: &Vector2<f64>) -> Option<Around> {
        Around::new(self.width(), &self.values, at)
    }

    /// The value between pixels; `None` outside.
    pub fn value(&self, at: &Vector2<f64>) -> Option<f64> {
        Some(self.around(at)?.value())
    }

    /// The gradient between pixels; `None` outside.
    pub fn gradient(&self, at: &Vector2<f64>) -> Option<Vector2<f64>> {
        Some(self.around(at)?.gradient())
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
