//! A grey picture being painted: fractal noise, shapes at all scales, strokes.

use crate::noise::{Dice, below, hash, uniform};

/// A picture of reflectances, row by row; shapes are placed in metres from its corner.
#[derive(Clone, Debug)]
pub(crate) struct Canvas {
    pub width: usize,
    pub height: usize,
    /// Edge of a texel, metres, across and down.
    pub texel_m: [f32; 2],
    pub values: Vec<f32>,
    /// Whether it is measured where its edges are.
    pub is_measured: bool,
}

/// Shapes scattered at random: sizes fall by halves from `largest_m` to `smallest_m`. Where each size covers the same
/// share, the power spectrum is ∝ 1/f² as in natural scenes (dead leaves model, Lee, Mumford and Huang 2001); the small
/// ones cover a little less here, so that they do not hide the large ones under them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leaves {
    /// Share of the area covered by the largest size.
    pub coverage: f32,
    pub largest_m: f32,
    pub smallest_m: f32,
    /// Tones are drawn from this range.
    pub tones: [f32; 2],
}

impl Canvas {
    /// A picture of one tone.
    pub(crate) fn new(size_m: [f32; 2], texel_m: f32, tone: f32) -> Self {
        let count = |m: f32| ((m / texel_m).ceil() as usize).clamp(2, 8192);
        let (width, height) = (count(size_m[0]), count(size_m[1]));
        Self {
            width,
            height,
            texel_m: [size_m[0] / width as f32, size_m[1] / height as f32],
            values: vec![tone; width * height],
            is_measured: false,
        }
    }

    pub(crate) fn size_m(&self) -> [f32; 2] {
        [
            self.width as f32 * self.texel_m[0],
            self.height as f32 * self.texel_m[1],
        ]
    }

    /// Adds noise of equal amplitude in every octave up to `longest_m`, drawn out by `stretch` along the two axes.
    pub(crate) fn add_noise(
        &mut self,
        amplitude: f32,
        longest_m: f32,
        stretch: [f32; 2],
        seed: u64,
    ) {
        if amplitude <= 0.0 {
            return;
        }
        let texel = self.texel_m[0].min(self.texel_m[1]);
        let octaves = (longest_m / texel).log2().clamp(1.0, 10.0) as u32;
        let cells = |n: usize, s: f32| ((n as f32 / s) as usize >> octaves) + 3;
        let mut grid = Grid::random(
            cells(self.width, stretch[0]),
            cells(self.height, stretch[1]),
            hash(seed),
        );
        for octave in 1..octaves {
            grid = grid.refined(hash(seed ^ u64::from(octave)));
        }
        // The finest octave is interpolated straight into the picture, where the stretch is applied too.
        for y in 0..self.height {
            let v = y as f32 / stretch[1] * 0.5 + 1.0;
            for x in 0..self.width {
                let u = x as f32 / stretch[0] * 0.5 + 1.0;
                self.values[y * self.width + x] += amplitude * grid.at(u, v);
            }
        }
    }

    /// Scatters shapes: triangles to hexagons, and ellipses.
    pub(crate) fn scatter(&mut self, leaves: &Leaves, rng: &Dice) {
        let [w, h] = self.size_m();
        let mut radius = leaves.largest_m.min(0.35 * w.max(h));
        let smallest = leaves
            .smallest_m
            .max(1.2 * self.texel_m[0].max(self.texel_m[1]));
        while radius >= smallest {
            let coverage = leaves.coverage * (radius / leaves.largest_m).powf(0.3);
            let expected = coverage * w * h / (2.2 * radius * radius);
            let count = (expected + uniform(rng, 0.0, 1.0)) as usize;
            for _ in 0..count {
                let centre = [uniform(rng, 0.0, w), uniform(rng, 0.0, h)];
                let r = radius * uniform(rng, 0.7, 1.3);
                let tone = uniform(rng, leaves.tones[0], leaves.tones[1]);
                if below(rng, 4) == 0 {
                    let axes = [r, r * uniform(rng, 0.4, 1.0)];
                    self.ellipse(centre, axes, uniform(rng, 0.0, 3.2), tone);
                } else {
                    let corners = 3 + below(rng, 4);
                    let turn = uniform(rng, 0.0, 6.3);
                    let polygon: Vec<[f32; 2]> = (0..corners)
                        .map(|k| {
                            let jitter = uniform(rng, -0.3, 0.3);
                            let angle =
                                turn + (k as f32 + jitter) * std::f32::consts::TAU / corners as f32;
                            [centre[0] + r * angle.cos(), centre[1] + r * angle.sin()]
                        })
                        .collect();
                    self.polygon(&polygon, tone);
                }
            }
            radius *= 0.5;
        }
    }

    /// Fills a convex polygon, its edges one texel soft.
    pub(crate) fn polygon(&mut self, vertices: &[[f32; 2]], tone: f32) {
        let n = vertices.len();
        let area: f32 = (0..n)
            .map(|i| {
                let (p, q) = (vertices[i], vertices[(i + 1) % n]);
                p[0] * q[1] - p[1] * q[0]
            })
            .sum();
        let sign = if area < 0.0 { -1.0 } else { 1.0 };
        let edges: Vec<[f32; 3]> = (0..n)
            .map(|i| {
                let (p, q) = (vertices[i], vertices[(i + 1) % n]);
                let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
                let s = sign / (dx * dx + dy * dy).sqrt().max(1e-9);
                let normal = [dy * s, -dx * s];
                [normal[0], normal[1], normal[0] * p[0] + normal[1] * p[1]]
            })
            .collect();
        let mut low = [f32::INFINITY; 2];
        let mut high = [f32::NEG_INFINITY; 2];
        for v in vertices {
            for i in 0..2 {
                low[i] = low[i].min(v[i]);
                high[i] = high[i].max(v[i]);
            }
        }
        self.fill(low, high, tone, |x, y| {
            edges
                .iter()
                .map(|e| e[0] * x + e[1] * y - e[2])
                .fold(f32::NEG_INFINITY, f32::max)
        });
    }

    /// Fills an axis-aligned rectangle.
    pub(crate) fn rectangle(&mut self, low: [f32; 2], high: [f32; 2], tone: f32) {
        self.fill(low, high, tone, |x, y| {
            (low[0] - x)
                .max(x - high[0])
                .max(low[1] - y)
                .max(y - high[1])
        });
    }

    /// Draws a straight stroke with round ends.
    pub(crate) fn stroke(&mut self, from: [f32; 2], to: [f32; 2], width_m: f32, tone: f32) {
        let r = 0.5 * width_m;
        let low = [from[0].min(to[0]) - r, from[1].min(to[1]) - r];
        let high = [from[0].max(to[0]) + r, from[1].max(to[1]) + r];
        let d = [to[0] - from[0], to[1] - from[1]];
        let squared = (d[0] * d[0] + d[1] * d[1]).max(1e-12);
        self.fill(low, high, tone, |x, y| {
            let p = [x - from[0], y - from[1]];
            let s = ((p[0] * d[0] + p[1] * d[1]) / squared).clamp(0.0, 1.0);
            let (ex, ey) = (p[0] - s * d[0], p[1] - s * d[1]);
            (ex * ex + ey * ey).sqrt() - r
        });
    }

    /// Fills an ellipse, its first axis turned by `turn`, radians.
    pub(crate) fn ellipse(&mut self, centre: [f32; 2], axes: [f32; 2], turn: f32, tone: f32) {
        let (sin, cos) = turn.sin_cos();
        let r = axes[0].max(axes[1]);
        self.fill(
            [centre[0] - r, centre[1] - r],
            [centre[0] + r, centre[1] + r],
            tone,
            |x, y| {
                let (dx, dy) = (x - centre[0], y - centre[1]);
                let (p, q) = (
                    (cos * dx + sin * dy) / axes[0],
                    (cos * dy - sin * dx) / axes[1],
                );
                ((p * p + q * q).sqrt() - 1.0) * axes[0].min(axes[1])
            },
        );
    }

    /// Replaces every tone by that of a place, metres from the corner.
    pub(crate) fn shade(&mut self, tone: impl Fn(f32, f32) -> f32) {
        self.vary(|x, y, _| tone(x, y));
    }

    /// Replaces every tone by one that depends on a place, metres from the corner, and what was there.
    pub(crate) fn vary(&mut self, tone: impl Fn(f32, f32, f32) -> f32) {
        let [tx, ty] = self.texel_m;
        for (y, row) in self.values.chunks_mut(self.width).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                *value = tone((x as f32 + 0.5) * tx, (y as f32 + 0.5) * ty, *value);
            }
        }
    }

    /// Paints whatever lies where something holds.
    pub(crate) fn paint_where(&mut self, tone: f32, holds: impl Fn(f32, f32) -> bool) {
        self.vary(|x, y, value| if holds(x, y) { tone } else { value });
    }

    /// An empty picture of the size of a part of it.
    pub(crate) fn cut(&self, low: [f32; 2], high: [f32; 2]) -> Self {
        let count = |i: usize| ((high[i] - low[i]) / self.texel_m[i]).round().max(2.0) as usize;
        let (width, height) = (count(0), count(1));
        Self {
            width,
            height,
            texel_m: self.texel_m,
            values: vec![0.0; width * height],
            is_measured: false,
        }
    }

    /// Puts a picture with texels of the same size over it, as far as it has room.
    pub(crate) fn paste(&mut self, part: &Self, low: [f32; 2]) {
        let first = [0, 1].map(|i| (low[i] / self.texel_m[i]).round().max(0.0) as usize);
        let columns = part.width.min(self.width.saturating_sub(first[0]));
        for (k, row) in part.values.chunks(part.width).enumerate() {
            let y = first[1] + k;
            if y < self.height && columns > 0 {
                let begin = y * self.width + first[0];
                self.values[begin..begin + columns].copy_from_slice(&row[..columns]);
            }
        }
    }

    /// Paints where the signed distance to the outline, metres, is negative; half a texel of transition either way.
    fn fill(
        &mut self,
        low: [f32; 2],
        high: [f32; 2],
        tone: f32,
        distance: impl Fn(f32, f32) -> f32,
    ) {
        let [tx, ty] = self.texel_m;
        let x0 = ((low[0] / tx).floor() - 1.0).max(0.0) as usize;
        let y0 = ((low[1] / ty).floor() - 1.0).max(0.0) as usize;
        let x1 = (((high[0] / tx).ceil() + 1.0).max(0.0) as usize).min(self.width);
        let y1 = (((high[1] / ty).ceil() + 1.0).max(0.0) as usize).min(self.height);
        let softness = 1.0 / tx.max(ty);
        for y in y0..y1 {
            for x in x0..x1 {
                let d = distance((x as f32 + 0.5) * tx, (y as f32 + 0.5) * ty);
                let cover = (0.5 - d * softness).clamp(0.0, 1.0);
                if cover > 0.0 {
                    let value = &mut self.values[y * self.width + x];
                    *value += cover * (tone - *value);
                }
            }
        }
    }
}

/// Random values on a lattice.
struct Grid {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Grid {
    fn random(width: usize, height: usize, seed: u64) -> Self {
        let mut values = vec![0.0; width * height];
        add_random(&mut values, seed);
        Self {
            width,
            height,
            values,
        }
    }

    /// Twice as fine (quadratic B-spline subdivision), with one more octave added.
    fn refined(&self, seed: u64) -> Self {
        let (width, height) = (2 * (self.width - 1), 2 * (self.height - 1));
        let mut values = vec![0.0; width * height];
        for y in 0..height {
            // New sample 2i+1 lies a quarter of the way from i to i+1, sample 2i+2 three quarters.
            let (j, v) = (y / 2, if y % 2 == 0 { 0.25 } else { 0.75 });
            let (row, next) = (j * self.width, (j + 1).min(self.height - 1) * self.width);
            for x in 0..width {
                let (i, u) = (x / 2, if x % 2 == 0 { 0.25 } else { 0.75 });
                let top = self.values[row + i] * (1.0 - u) + self.values[row + i + 1] * u;
                let low = self.values[next + i] * (1.0 - u) + self.values[next + i + 1] * u;
                values[y * width + x] = top * (1.0 - v) + low * v;
            }
        }
        add_random(&mut values, seed);
        Self {
            width,
            height,
            values,
        }
    }

    /// Bilinear; clamped at the border.
    fn at(&self, x: f32, y: f32) -> f32 {
        let (i, j) = (
            (x as usize).min(self.width - 2),
            (y as usize).min(self.height - 2),
        );
        let (u, v) = ((x - i as f32).min(1.0), (y - j as f32).min(1.0));
        let k = j * self.width + i;
        let top = self.values[k] * (1.0 - u) + self.values[k + 1] * u;
        let low = self.values[k + self.width] * (1.0 - u) + self.values[k + self.width + 1] * u;
        top * (1.0 - v) + low * v
    }
}

/// Adds values in ±1, eight from each hash.
fn add_random(values: &mut [f32], seed: u64) {
    for (k, chunk) in values.chunks_mut(8).enumerate() {
        let bytes = hash(seed.wrapping_add(k as u64)).to_le_bytes();
        for (value, byte) in chunk.iter_mut().zip(bytes) {
            *value += (f32::from(byte) - 127.5) / 127.5;
        }
    }
}
