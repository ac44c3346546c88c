//! Pairs of images with a known homography: a real image and what it would look like from elsewhere, in another light, or out of focus.

use lsfb_geometry::{Matrix3, Vector2, Vector3};
use lsfb_types::Image;
use nalgebra::{SMatrix, SVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

/// What sets the second image apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A plane seen obliquely.
    Viewpoint,
    /// 1.4 to 2.5 times as large or as small.
    Scale,
    /// The camera turned about its axis, by 20° to 180°.
    Rotation,
    /// Another exposure, contrast and a shade across the image.
    Light,
    /// Out of focus.
    Blur,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Viewpoint,
        Self::Scale,
        Self::Rotation,
        Self::Light,
        Self::Blur,
    ];

    /// For tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Viewpoint => "viewpoint",
            Self::Scale => "scale",
            Self::Rotation => "rotation",
            Self::Light => "light",
            Self::Blur => "blur",
        }
    }
}

/// An image changed in a known way.
pub struct Warped {
    /// As large as the image it comes from; what lies outside of that is mirrored at its rim.
    pub image: Image,
    /// Pixels of the original to pixels of this one.
    pub target_from_source: Matrix3<f64>,
}

/// How far corners move at most, share of the image's side: obliquely seen, and as in two photographs of one view, which never
/// have the same pixels.
const OBLIQUE: f64 = 0.18;
const SLIGHT: f64 = 0.03;
/// Noise of the second image, grey levels.
const NOISE: f64 = 2.0;

/// The image changed; the same for the same seed.
pub fn warp(source: &Image, kind: Kind, seed: u64) -> Warped {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let size = [source.width, source.height].map(f64::from);
    let reach = match kind {
        Kind::Viewpoint => OBLIQUE,
        _ => SLIGHT,
    };
    let mut target_from_source = corners_moved(size, reach, &mut rng);
    match kind {
        Kind::Scale => {
            let factor: f64 = rng.random_range(1.4..2.5);
            let factor = if rng.random_bool(0.5) {
                factor
            } else {
                factor.recip()
            };
            target_from_source = about_centre(size, 0.0, factor) * target_from_source;
        }
        Kind::Rotation => {
            let degrees: f64 = rng.random_range(20.0..180.0);
            let turn = if rng.random_bool(0.5) {
                degrees
            } else {
                -degrees
            };
            target_from_source = about_centre(size, turn.to_radians(), 1.0) * target_from_source;
        }
        Kind::Viewpoint | Kind::Light | Kind::Blur => {}
    }
    let source_from_target = target_from_source.try_inverse().unwrap_or_default();
    let mut values = resampled(source, &source_from_target);
    match kind {
        Kind::Light => shade(&mut values, source.width as usize, &mut rng),
        Kind::Blur => {
            let sigma_px = rng.random_range(1.0..2.5);
            blur(&mut values, source.width as usize, sigma_px);
        }
        _ => {}
    }
    // The sum of three even deviates is nearly normal, and of half the variance of its width.
    let mut noise = || (0..3).map(|_| rng.random_range(-1.0..1.0)).sum::<f64>() * NOISE;
    let pixels = values.iter().map(|v| (v + noise()).round() as u8).collect();
    Warped {
        image: Image {
            pixels,
            ..source.clone()
        },
        target_from_source,
    }
}

/// Where a homography takes a pixel; `None` behind its horizon.
pub fn moved(homography: &Matrix3<f64>, pixel: [f64; 2]) -> Option<[f64; 2]> {
    let at = homography * Vector3::new(pixel[0], pixel[1], 1.0);
    (at.z > 1e-9).then(|| [at.x / at.z, at.y / at.z])
}

/// Turned and scaled about the middle of the image.
fn about_centre(size: [f64; 2], turn_rad: f64, factor: f64) -> Matrix3<f64> {
    let [x, y] = size.map(|side| (side - 1.0) / 2.0);
    let (sin, cos) = (factor * turn_rad.sin(), factor * turn_rad.cos());
    Matrix3::new(
        cos,
        -sin,
        x - cos * x + sin * y,
        sin,
        cos,
        y - sin * x - cos * y,
        0.0,
        0.0,
        1.0,
    )
}

/// Each corner moves by up to `reach` of the sides.
fn corners_moved(size: [f64; 2], reach: f64, rng: &mut ChaCha8Rng) -> Matrix3<f64> {
    let [w, h] = size.map(|side| side - 1.0);
    let corners = [[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]];
    let mut rows = SMatrix::<f64, 8, 8>::zeros();
    let mut right = SVector::<f64, 8>::zeros();
    for (k, [x, y]) in corners.into_iter().enumerate() {
        let mut off = |side: f64| rng.random_range(-reach..reach) * side;
        let to = [x + off(w), y + off(h)];
        for (axis, target) in to.into_iter().enumerate() {
            let row = 2 * k + axis;
            for (column, value) in [x, y, 1.0].into_iter().enumerate() {
                rows[(row, 3 * axis + column)] = value;
            }
            rows[(row, 6)] = -x * target;
            rows[(row, 7)] = -y * target;
            right[row] = target;
        }
    }
    // Corners that move by less than a quarter of a side stay a convex quadrangle.
    let solved = rows.lu().solve(&right).unwrap_or_default();
    Matrix3::from_row_slice(&[solved.as_slice(), &[1.0]].concat())
}

/// The image as a homography shows it: the mean of nine samples a pixel, so that what gets smaller does not flicker.
fn resampled(source: &Image, source_from_target: &Matrix3<f64>) -> Vec<f64> {
    const OFFSETS: [f64; 3] = [-1.0 / 3.0, 0.0, 1.0 / 3.0];
    let mut values = Vec::with_capacity(source.pixels.len());
    for y in 0..source.height {
        for x in 0..source.width {
            let mut sum = 0.0;
            for dy in OFFSETS {
                for dx in OFFSETS {
                    let at = [f64::from(x) + dx, f64::from(y) + dy];
                    sum += moved(source_from_target, at).map_or(0.0, |at| sampled(source, at));
                }
            }
            values.push(sum / 9.0);
        }
    }
    values
}

/// Between four pixels; beyond the rim as in a mirror.
fn sampled(image: &Image, at: [f64; 2]) -> f64 {
    let sides = [image.width as usize, image.height as usize];
    let place = |axis: usize| {
        let last = (sides[axis] - 1) as f64;
        let folded = at[axis].rem_euclid(2.0 * last.max(1.0));
        let inside = folded.min(2.0 * last - folded).clamp(0.0, last);
        let low = (inside.floor() as usize).min(sides[axis].saturating_sub(2));
        (low, inside - low as f64)
    };
    let [(x, right), (y, down)] = [place(0), place(1)];
    let value = |x: usize, y: usize| {
        let index = y.min(sides[1] - 1) * sides[0] + x.min(sides[0] - 1);
        f64::from(image.pixels[index])
    };
    let row = |y: usize| value(x, y) * (1.0 - right) + value(x + 1, y) * right;
    row(y) * (1.0 - down) + row(y + 1) * down
}

/// Another exposure and contrast, brighter on one side than on the other.
fn shade(values: &mut [f64], width: usize, rng: &mut ChaCha8Rng) {
    let gamma = f64::powf(2.0, rng.random_range(-1.0..1.0));
    let gain = rng.random_range(0.5..1.3);
    let slope = Vector2::new(rng.random_range(-0.5..0.5), rng.random_range(-0.5..0.5));
    let height = (values.len() / width.max(1)).max(1);
    for (index, value) in values.iter_mut().enumerate() {
        let at = Vector2::new(
            (index % width) as f64 / width as f64 - 0.5,
            (index / width) as f64 / height as f64 - 0.5,
        );
        let shade = 1.0 + slope.dot(&at);
        *value = (255.0 * gain * shade * (*value / 255.0).powf(gamma)).clamp(0.0, 255.0);
    }
}

/// With a Gaussian, along rows and then along columns; at the rim the outermost pixel counts on.
fn blur(values: &mut [f64], width: usize, sigma_px: f64) {
    let reach = (3.0 * sigma_px).ceil() as i64;
    let weight = |k: i64| (-0.5 * (k as f64 / sigma_px).powi(2)).exp();
    let weights: Vec<f64> = (-reach..=reach).map(weight).collect();
    let total: f64 = weights.iter().sum();
    let height = values.len() / width.max(1);
    for along_rows in [true, false] {
        let before = values.to_vec();
        for (index, value) in values.iter_mut().enumerate() {
            let (x, y) = ((index % width) as i64, (index / width) as i64);
            let sum: f64 = (-reach..=reach)
                .zip(&weights)
                .map(|(k, weight)| {
                    let (dx, dy) = if along_rows { (k, 0) } else { (0, k) };
                    let x = (x + dx).clamp(0, width as i64 - 1) as usize;
                    let y = (y + dy).clamp(0, height as i64 - 1) as usize;
                    weight * before[y * width + x]
                })
                .sum();
            *value = sum / total;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth picture whose value at any place is known.
    fn value(x: f64, y: f64) -> f64 {
        120.0 + 60.0 * (x / 9.0).sin() * (y / 7.0).cos()
    }

    fn picture() -> Image {
        let (width, height) = (160, 120);
        let pixels = (0..width * height)
            .map(|i| value(f64::from(i % width), f64::from(i / width)).round() as u8);
        Image {
            width,
            height,
            pixels: pixels.collect(),
            ..Image::default()
        }
    }

    #[test]
    fn pixels_are_where_the_homography_says() {
        for kind in [Kind::Viewpoint, Kind::Scale, Kind::Rotation] {
            for seed in 0..4 {
                let warped = warp(&picture(), kind, seed);
                let back = warped.target_from_source.try_inverse().expect("invertible");
                let (mut sum, mut count) = (0.0, 0.0);
                for y in (10..110).step_by(5) {
                    for x in (10..150).step_by(5) {
                        let from = moved(&back, [f64::from(x), f64::from(y)]).expect("in front");
                        if from[0] < 2.0 || from[0] > 157.0 || from[1] < 2.0 || from[1] > 117.0 {
                            continue;
                        }
                        let found = warped.image.pixels[(y * 160 + x) as usize];
                        sum += f64::from(found) - value(from[0], from[1]);
                        let off = (f64::from(found) - value(from[0], from[1])).abs();
                        // Noise of three deviates, and what nine samples smooth where the picture shrinks.
                        assert!(off < 14.0, "{kind:?} {seed} {x} {y}: {off}");
                        count += 1.0;
                    }
                }
                assert!(
                    count > 60.0 && (sum / count).abs() < 1.0,
                    "{kind:?} {seed}: {count}"
                );
            }
        }
    }

    #[test]
    fn seeds_make_different_pairs_and_the_same_again() {
        for kind in Kind::ALL {
            let [one, again, other] = [3, 3, 4].map(|seed| warp(&picture(), kind, seed).image);
            assert_eq!(one, again);
            assert_ne!(one, other);
            assert_eq!(one.pixels.len(), 160 * 120);
        }
    }

    #[test]
    fn what_is_out_of_focus_has_less_contrast() {
        let contrast = |image: &Image| {
            let rows = image.pixels.windows(2).map(|p| p[0].abs_diff(p[1]));
            rows.map(f64::from).sum::<f64>()
        };
        let sharp: Vec<u8> = (0..160 * 120)
            .map(|i| if i / 4 % 2 == 0 { 40 } else { 200 })
            .collect();
        let image = Image {
            pixels: sharp,
            ..picture()
        };
        let blurred = warp(&image, Kind::Blur, 1).image;
        assert!(contrast(&blurred) < 0.7 * contrast(&image));
    }
}
