//! Gaussian images of one octave. Their differences are formed where they are looked at: stored, they would double the memory of
//! large images.

use lsfb_types::Image;

/// Blur that a sharp photograph already has, pixels (Lowe, section 3.3).
const CAMERA_BLUR_PX: f32 = 0.5;

/// Pixels handled together: enough to keep the partial sums in registers.
const LANES: usize = 16;

/// A floating-point image, 0 black to 1 white.
#[derive(Clone, Debug, Default)]
pub(crate) struct Plane {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

impl Plane {
    pub fn resize(&mut self, width: usize, height: usize) {
        self.width = width;
        self.height = height;
        self.values.resize(width * height, 0.0);
    }

    pub fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width..][..self.width]
    }

    fn row_mut(&mut self, y: usize) -> &mut [f32] {
        &mut self.values[y * self.width..][..self.width]
    }
}

/// Gaussians of increasing blur. Kept between images, so that its memory is touched for the first time only once.
#[derive(Clone, Debug, Default)]
pub(crate) struct Octave {
    pub gaussians: Vec<Plane>,
    scratch: Vec<f32>,
}

impl Octave {
    /// Takes the camera's image and blurs it to `sigma` (in pixels of the first octave).
    pub fn start(&mut self, image: &Image, doubled: bool, sigma: f32) {
        self.hold(2);
        let (base, rest) = self.gaussians.split_at_mut(1);
        // The next level's memory holds the sharp image until that level is filled.
        let source = &mut rest[0];
        let blur = if doubled {
            double(image, source);
            2.0 * CAMERA_BLUR_PX
        } else {
            copy(image, source);
            CAMERA_BLUR_PX
        };
        let kernel = kernel((sigma * sigma - blur * blur).max(0.01).sqrt());
        blur_into(source, &mut base[0], &kernel, &mut self.scratch);
    }

    /// Begins the next octave with every second pixel of the Gaussian that has twice the base blur.
    pub fn halve(&mut self, previous: &Octave, scales: usize) {
        let from = &previous.gaussians[scales];
        self.hold(1);
        let base = &mut self.gaussians[0];
        base.resize(from.width / 2, from.height / 2);
        for y in 0..base.height {
            let row = from.row(2 * y);
            for (to, from) in base.row_mut(y).iter_mut().zip(row.iter().step_by(2)) {
                *to = *from;
            }
        }
    }

    /// Adds the remaining Gaussians of an octave with `scales` detection levels.
    pub fn fill(&mut self, scales: usize, sigma: f32) {
        self.hold(scales + 3);
        self.gaussians.truncate(scales + 3);
        let step = 2.0f32.powf(1.0 / scales as f32);
        for level in 1..scales + 3 {
            let before = sigma * step.powi(level as i32 - 1);
            let kernel = kernel(before * (step * step - 1.0).sqrt());
            let (done, rest) = self.gaussians.split_at_mut(level);
            blur_into(&done[level - 1], &mut rest[0], &kernel, &mut self.scratch);
        }
    }

    /// Number of differences: one fewer than Gaussians.
    pub fn differences(&self) -> usize {
        self.gaussians.len().saturating_sub(1)
    }

    /// Width and height, pixels; zero before the octave is filled.
    pub fn size(&self) -> [usize; 2] {
        self.gaussians
            .first()
            .map_or([0; 2], |g| [g.width, g.height])
    }

    /// Gaussian `level + 1` less Gaussian `level`, at one pixel.
    pub fn difference(&self, level: usize, x: usize, y: usize) -> f32 {
        let (sharp, blurred) = (&self.gaussians[level], &self.gaussians[level + 1]);
        let at = y * sharp.width + x;
        blurred.values[at] - sharp.values[at]
    }

    /// The same, a row at a time.
    pub fn difference_row(&self, level: usize, y: usize, row: &mut Vec<f32>) {
        let (sharp, blurred) = (
            self.gaussians[level].row(y),
            self.gaussians[level + 1].row(y),
        );
        row.clear();
        row.extend(blurred.iter().zip(sharp).map(|(b, s)| b - s));
    }

    /// At least this many planes, those of the image before among them.
    fn hold(&mut self, count: usize) {
        if self.gaussians.len() < count {
            self.gaussians.resize_with(count, Plane::default);
        }
    }
}

fn copy(image: &Image, plane: &mut Plane) {
    plane.resize(image.width as usize, image.height as usize);
    for (to, from) in plane.values.iter_mut().zip(&image.pixels) {
        *to = f32::from(*from) * (1.0 / 255.0);
    }
}

/// Pixel `(x, y)` of the image becomes `(2x, 2y)`; those between are averages. No shift, unlike a centred resize.
fn double(image: &Image, plane: &mut Plane) {
    let (width, height) = (image.width as usize, image.height as usize);
    plane.resize(2 * width, 2 * height);
    for y in 0..height {
        let row = &image.pixels[y * width..][..width];
        let below = &image.pixels[(y + 1).min(height - 1) * width..][..width];
        let (even, odd) = plane.values[4 * y * width..][..4 * width].split_at_mut(2 * width);
        for x in 0..width {
            let right = (x + 1).min(width - 1);
            let [a, b] = [f32::from(row[x]), f32::from(row[right])];
            let [c, d] = [f32::from(below[x]), f32::from(below[right])];
            even[2 * x] = a * (1.0 / 255.0);
            even[2 * x + 1] = (a + b) * (0.5 / 255.0);
            odd[2 * x] = (a + c) * (0.5 / 255.0);
            odd[2 * x + 1] = (a + b + c + d) * (0.25 / 255.0);
        }
    }
}

/// Half a normalised Gaussian, centre first, cut where it has fallen to a hundredth.
fn kernel(sigma: f32) -> Vec<f32> {
    let radius = (3.0 * sigma).ceil().max(1.0) as usize;
    let mut half: Vec<f32> = (0..=radius)
        .map(|i| (-0.5 * (i as f32 / sigma).powi(2)).exp())
        .collect();
    let sum = half[0] + 2.0 * half[1..].iter().sum::<f32>();
    half.iter_mut().for_each(|w| *w /= sum);
    half
}

/// Separable Gaussian with replicated borders: columns first, one row at a time, so that the row between the two
/// passes stays in the nearest cache.
fn blur_into(source: &Plane, target: &mut Plane, kernel: &[f32], scratch: &mut Vec<f32>) {
    let (width, height, radius) = (source.width, source.height, kernel.len() - 1);
    target.resize(width, height);
    if width == 0 || height == 0 {
        return;
    }
    scratch.clear();
    scratch.resize(width + 2 * radius, 0.0);
    for y in 0..height {
        let rows: Vec<(&[f32], &[f32])> = (1..=radius)
            .map(|i| {
                let (above, below) = (y.saturating_sub(i), (y + i).min(height - 1));
                (source.row(above), source.row(below))
            })
            .collect();
        let middle = &mut scratch[radius..radius + width];
        blur_columns(source.row(y), &rows, kernel, middle);
        let (first, last) = (middle[0], middle[width - 1]);
        scratch[..radius].fill(first);
        scratch[radius + width..].fill(last);
        blur_row(scratch, kernel, target.row_mut(y));
    }
}

fn blur_columns(centre: &[f32], rows: &[(&[f32], &[f32])], kernel: &[f32], out: &mut [f32]) {
    let width = out.len();
    let whole = width - width % LANES;
    for x in (0..whole).step_by(LANES) {
        let mut sum = [0.0f32; LANES];
        for (s, v) in sum.iter_mut().zip(&centre[x..x + LANES]) {
            *s = v * kernel[0];
        }
        for ((above, below), weight) in rows.iter().zip(&kernel[1..]) {
            let (above, below) = (&above[x..x + LANES], &below[x..x + LANES]);
            for i in 0..LANES {
                sum[i] += (above[i] + below[i]) * weight;
            }
        }
        out[x..x + LANES].copy_from_slice(&sum);
    }
    for x in whole..width {
        let mut sum = centre[x] * kernel[0];
        for ((above, below), weight) in rows.iter().zip(&kernel[1..]) {
            sum += (above[x] + below[x]) * weight;
        }
        out[x] = sum;
    }
}

/// `padded` has `kernel.len() - 1` values more than `out` on either side.
fn blur_row(padded: &[f32], kernel: &[f32], out: &mut [f32]) {
    let (width, radius) = (out.len(), kernel.len() - 1);
    let whole = width - width % LANES;
    for x in (0..whole).step_by(LANES) {
        let mut sum = [0.0f32; LANES];
        for (s, v) in sum.iter_mut().zip(&padded[x + radius..][..LANES]) {
            *s = v * kernel[0];
        }
        for (i, weight) in kernel.iter().enumerate().skip(1) {
            let left = &padded[x + radius - i..][..LANES];
            let right = &padded[x + radius + i..][..LANES];
            for lane in 0..LANES {
                sum[lane] += (left[lane] + right[lane]) * weight;
            }
        }
        out[x..x + LANES].copy_from_slice(&sum);
    }
    for x in whole..width {
        let mut sum = padded[x + radius] * kernel[0];
        for (i, weight) in kernel.iter().enumerate().skip(1) {
            sum += (padded[x + radius - i] + padded[x + radius + i]) * weight;
        }
        out[x] = sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blur_keeps_constants_and_has_the_variance_it_was_asked_for() {
        let mut flat = Plane::default();
        flat.resize(37, 21);
        flat.values.fill(0.7);
        let (mut out, mut scratch) = (Plane::default(), Vec::new());
        blur_into(&flat, &mut out, &kernel(2.1), &mut scratch);
        assert!(out.values.iter().all(|v| (v - 0.7).abs() < 1e-5));

        let mut spike = Plane::default();
        spike.resize(41, 41);
        spike.values[20 * 41 + 20] = 1.0;
        blur_into(&spike, &mut out, &kernel(2.0), &mut scratch);
        let (mut variance_x, mut variance_y) = (0.0, 0.0);
        for y in 0..41 {
            for x in 0..41 {
                variance_x += out.values[y * 41 + x] * (x as f32 - 20.0).powi(2);
                variance_y += out.values[y * 41 + x] * (y as f32 - 20.0).powi(2);
            }
        }
        assert!((variance_x.sqrt() - 2.0).abs() < 0.05, "{variance_x}");
        assert!((variance_y.sqrt() - 2.0).abs() < 0.05, "{variance_y}");
    }
}
