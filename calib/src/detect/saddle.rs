//! Points where dark and light meet in four sectors.

use std::f64::consts::{PI, TAU};

use lsfb_geometry::Vector2;
use lsfb_types::Image;

use super::sample;

/// An image smoothed by the binomial 1 4 6 4 1, as wide as the original.
pub(super) struct Blurred {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

/// A saddle: four rays of edges by rising angle, and whether the sector behind the first is dark. The others alternate.
pub(super) struct Saddle {
    pub position: Vector2<f64>,
    /// The rays as unit vectors.
    pub directions: [Vector2<f64>; 4],
    /// Whether the sector from ray 0 to ray 1 is dark.
    first_is_dark: bool,
    /// Difference of the sectors' brightness.
    pub contrast: f32,
    strength: f32,
}

impl Saddle {
    /// Directions of the two edges, each through both of its rays.
    pub fn edges(&self) -> [Vector2<f64>; 2] {
        [0, 1].map(|k| (self.directions[k] - self.directions[k + 2]).normalize())
    }

    /// Sine of the angle at which the two edges meet: how much nearer lines along them are than points on them.
    pub fn opening(&self) -> f64 {
        let [first, second] = self.edges();
        first.perp(&second).abs()
    }

    /// Whether the sector from ray `k` to the next is dark.
    pub fn is_dark(&self, k: usize) -> bool {
        self.first_is_dark == k.is_multiple_of(2)
    }
}

/// Saddles kept at most, the strongest.
const MAX_SADDLES: usize = 2500;
/// `Ixy² − Ixx Iyy` of a corner between sectors that differ by about 10 of 255.
const MIN_STRENGTH: f32 = 6.0;
/// Radius of the circle on which the four sectors are looked for, pixels.
const RING_PX: f64 = 3.0;
const RING: usize = 24;
/// Least difference of the sectors, of 255.
const MIN_CONTRAST: f32 = 8.0;

impl Blurred {
    /// `None` where the image is too small to hold a corner, or its pixels are not as many as it says.
    pub fn new(image: &Image) -> Option<Self> {
        let (width, height) = (image.width as usize, image.height as usize);
        if width < 16 || height < 16 || image.pixels.len() != width.checked_mul(height)? {
            return None;
        }
        let mut rows = vec![0.0f32; width * height];
        for (out, row) in rows
            .chunks_exact_mut(width)
            .zip(image.pixels.chunks_exact(width))
        {
            for (out, w) in out[2..].iter_mut().zip(row.windows(5)) {
                let [a, b, c, d, e] = [w[0], w[1], w[2], w[3], w[4]].map(u32::from);
                *out = (a + 4 * (b + d) + 6 * c + e) as f32;
            }
            let (first, last) = (out[2], out[width - 3]);
            out[..2].fill(first);
            out[width - 2..].fill(last);
        }
        let mut values = vec![0.0f32; width * height];
        for y in 0..height {
            let row = |k: usize| {
                let at = (y + k).saturating_sub(2).min(height - 1);
                &rows[at * width..(at + 1) * width]
            };
            let (r0, r1, r2, r3, r4) = (row(0), row(1), row(2), row(3), row(4));
            let out = &mut values[y * width..(y + 1) * width];
            for (x, out) in out.iter_mut().enumerate() {
                *out = (r0[x] + 4.0 * (r1[x] + r3[x]) + 6.0 * r2[x] + r4[x]) / 256.0;
            }
        }
        Some(Self {
            width,
            height,
            values,
        })
    }

    /// Brightness between pixels.
    pub fn at(&self, p: &Vector2<f64>) -> Option<f32> {
        sample(self.width, &self.values, p.x, p.y)
    }
}

/// The saddles of an image, the strongest first.
pub(super) fn find(gray: &Blurred) -> Vec<Saddle> {
    let strength = strengths(gray);
    let (width, height) = (gray.width, gray.height);
    let mut saddles = Vec::new();
    for y in 4..height - 4 {
        for x in 4..width - 4 {
            let s = strength[y * width + x];
            if s < MIN_STRENGTH || !is_peak(&strength, width, x, y) {
                continue;
            }
            saddles.extend(Saddle::measure(gray, x, y, s));
        }
    }
    // Order of strength, then of place: the same on every machine.
    saddles.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    saddles.truncate(MAX_SADDLES);
    saddles
}

/// A saddle this many times weaker than a board's corners is none of them.
const WEAKER: f32 = 25.0;

/// Leaves out what is far weaker than the board's `corners`, which are among the strongest saddles: noise on the many edges of
/// markers, where it would stand between corners.
pub(super) fn leave_out_weak(saddles: &mut Vec<Saddle>, corners: usize) {
    // In order of strength; half of the board may be out of sight.
    if let Some(typical) = saddles.get(corners / 2).map(|s| s.strength) {
        saddles.retain(|s| WEAKER * s.strength >= typical);
    }
}

/// `Ixy² − Ixx Iyy`, positive on saddles.
fn strengths(gray: &Blurred) -> Vec<f32> {
    let width = gray.width;
    let mut out = vec![0.0f32; gray.values.len()];
    for y in 1..gray.height - 1 {
        let above = &gray.values[(y - 1) * width..y * width];
        let here = &gray.values[y * width..(y + 1) * width];
        let below = &gray.values[(y + 1) * width..(y + 2) * width];
        let out = &mut out[y * width + 1..(y + 1) * width - 1];
        let rows = above.windows(3).zip(here.windows(3)).zip(below.windows(3));
        for (out, ((a, h), b)) in out.iter_mut().zip(rows) {
            let xx = h[0] - 2.0 * h[1] + h[2];
            let yy = a[1] - 2.0 * h[1] + b[1];
            let xy = 0.25 * (a[0] - a[2] - b[0] + b[2]);
            *out = xy * xy - xx * yy;
        }
    }
    out
}

fn is_peak(strength: &[f32], width: usize, x: usize, y: usize) -> bool {
    let s = strength[y * width + x];
    (y - 2..=y + 2).all(|j| {
        (x - 2..=x + 2).all(|i| {
            let other = strength[j * width + i];
            // Of two equal peaks the first in reading order counts.
            other < s || (other == s && (j, i) >= (y, x))
        })
    })
}

impl Saddle {
    fn measure(gray: &Blurred, x: usize, y: usize, strength: f32) -> Option<Self> {
        let at = |dx: isize, dy: isize| {
            gray.values[(y as isize + dy) as usize * gray.width + (x as isize + dx) as usize]
        };
        let (gx, gy) = (0.5 * (at(1, 0) - at(-1, 0)), 0.5 * (at(0, 1) - at(0, -1)));
        let xx = at(1, 0) - 2.0 * at(0, 0) + at(-1, 0);
        let yy = at(0, 1) - 2.0 * at(0, 0) + at(0, -1);
        let xy = 0.25 * (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1));
        let determinant = xx * yy - xy * xy;
        let dx = (xy * gy - yy * gx) / determinant;
        let dy = (xy * gx - xx * gy) / determinant;
        if !(dx.abs() < 1.5 && dy.abs() < 1.5) {
            return None;
        }
        let position = Vector2::new(x as f64 + f64::from(dx), y as f64 + f64::from(dy));
        let mut ring = [0.0f32; RING];
        for (k, value) in ring.iter_mut().enumerate() {
            let (sin, cos) = (TAU * k as f64 / RING as f64).sin_cos();
            *value = gray.at(&(position + Vector2::new(cos, sin) * RING_PX))?;
        }
        Self::from_ring(&ring, position, strength)
    }

    /// Four crossings of the mean, two and two opposite.
    fn from_ring(ring: &[f32; RING], position: Vector2<f64>, strength: f32) -> Option<Self> {
        let high = ring.iter().fold(f32::MIN, |a, b| a.max(*b));
        let low = ring.iter().fold(f32::MAX, |a, b| a.min(*b));
        if high - low < MIN_CONTRAST {
            return None;
        }
        let middle = 0.5 * (high + low);
        let mut rays = [0.0; 4];
        let mut count = 0;
        let mut first_is_dark = false;
        for (k, value) in ring.iter().enumerate() {
            let (a, b) = (value - middle, ring[(k + 1) % RING] - middle);
            if (a < 0.0) != (b < 0.0) {
                if count == 4 {
                    return None;
                }
                if count == 0 {
                    first_is_dark = b < 0.0;
                }
                let share = f64::from(a / (a - b));
                rays[count] = (k as f64 + share) * TAU / RING as f64;
                count += 1;
            }
        }
        let opposite = |a: f64, b: f64| (b - a - PI).abs() < 0.6;
        if count != 4 || !opposite(rays[0], rays[2]) || !opposite(rays[1], rays[3]) {
            return None;
        }
        Some(Self {
            position,
            directions: rays.map(|a| Vector2::new(a.cos(), a.sin())),
            first_is_dark,
            contrast: high - low,
            strength,
        })
    }
}
