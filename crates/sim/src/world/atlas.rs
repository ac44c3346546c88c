//! Textures with mip levels: what a ray sees is averaged over the width of its cone, so that nothing aliases.
//!
//! Between texels brightness is linear, by which an edge comes to lie up to 0.09 of a pixel from where it is, the same edge on the same side
//! in all images. What is measured (`Canvas::is_measured`) is read by cubic splines.

use super::canvas::Canvas;

/// Texels of what is read by cubic splines, in those of what is read linearly: both blur alike, by half a texel of the latter, as a
/// pixel and a lens do. At 0.5 the corners of a board are found with errors of 0.09 px that its pixels' pattern makes.
const FINER: f32 = 0.8;

/// All textures of a world in one block.
#[derive(Clone, Debug, Default)]
pub(crate) struct Atlas {
    texels: Vec<u8>,
    /// Of all textures, one after the other; of each the finest first.
    levels: Vec<Level>,
    textures: Vec<Texture>,
}

/// One texture: which its levels are, and how large the first is.
#[derive(Clone, Debug)]
struct Texture {
    size: [f32; 2],
    /// One over the edge of a texel, 1/m.
    texels_per_m: f32,
    /// Mean brightness, 0–255.
    mean: f32,
    is_measured: bool,
    first_level: u32,
    /// Number of the coarsest, from 0.
    last: u32,
}

#[derive(Clone, Copy, Debug)]
struct Level {
    first: u32,
    width: u32,
    height: u32,
}

impl Atlas {
    /// Appends a picture of brightnesses in 0–1; its index is the number of pictures before it.
    pub(crate) fn push(&mut self, canvas: &Canvas) {
        let (mut width, mut height) = (canvas.width, canvas.height);
        let mut values: Vec<f32> = canvas.values.clone();
        let mean = 255.0 * values.iter().sum::<f32>() / values.len() as f32;
        let first_level = self.levels.len();
        loop {
            self.levels.push(Level {
                first: self.texels.len() as u32,
                width: width as u32,
                height: height as u32,
            });
            self.texels
                .extend(values.iter().map(|v| (v * 255.0 + 0.5) as u8));
            if width.max(height) <= 2 {
                break;
            }
            // Never thinner than two texels: bilinear interpolation always has its neighbours.
            let (w, h) = (width.div_ceil(2).max(2), height.div_ceil(2).max(2));
            let at = |x: usize, y: usize| values[y.min(height - 1) * width + x.min(width - 1)];
            let mut halved = Vec::with_capacity(w * h);
            for y in 0..h {
                for x in 0..w {
                    let (x, y) = (2 * x, 2 * y);
                    let sum = at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1);
                    halved.push(0.25 * sum);
                }
            }
            (width, height, values) = (w, h, halved);
        }
        self.textures.push(Texture {
            size: [canvas.width as f32, canvas.height as f32],
            texels_per_m: 1.0 / canvas.texel_m[0].max(canvas.texel_m[1]),
            mean,
            is_measured: canvas.is_measured,
            first_level: first_level as u32,
            last: (self.levels.len() - 1 - first_level) as u32,
        });
    }

    /// Brightness 0–255 at `(a, b)`, averaged over about `footprint_m`.
    #[inline]
    pub(crate) fn sample(&self, texture: usize, a: f32, b: f32, footprint_m: f32) -> f32 {
        let texture = &self.textures[texture];
        let finer = if texture.is_measured { FINER } else { 1.0 };
        let ratio = (finer * footprint_m * texture.texels_per_m).max(1.0);
        // log2 from the bits of the float: exact at powers of two and linear between, which is all a blend needs.
        let bits = ratio.to_bits();
        let level = (bits >> 23) - 127;
        let blend = (bits & 0x7f_ffff) as f32 * (1.0 / 8_388_608.0);
        let (x, y) = (a * texture.size[0], b * texture.size[1]);
        let level = level.min(texture.last);
        let read = |number: u32| {
            let level = &self.levels[(texture.first_level + number) as usize];
            match texture.is_measured {
                true => self.by_splines(level, x, y, number),
                false => self.bilinear(level, x, y, number),
            }
        };
        let fine = read(level);
        if level == texture.last {
            return fine;
        }
        fine + blend * (read(level + 1) - fine)
    }

    /// Mean brightness of a picture, 0–255.
    #[inline]
    pub(crate) fn mean(&self, texture: usize) -> f32 {
        self.textures[texture].mean
    }

    /// Number of pictures.
    pub(crate) fn count(&self) -> usize {
        self.textures.len()
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.texels.len()
    }

    #[inline(always)]
    fn bilinear(&self, level: &Level, x: f32, y: f32, number: u32) -> f32 {
        // Scaled by the power of two, not by the rounded size: odd sizes must not shift the picture.
        let shrink = f32::from_bits((127 - number) << 23);
        let (w, h) = (level.width as usize, level.height as usize);
        let x = (x * shrink - 0.5).clamp(0.0, (w - 1) as f32);
        let y = (y * shrink - 0.5).clamp(0.0, (h - 1) as f32);
        // By way of i32, whose conversion is a single instruction on common machines.
        let (i, j) = (
            (x as i32 as usize).min(w - 2),
            (y as i32 as usize).min(h - 2),
        );
        let (u, v) = (x - i as f32, y - j as f32);
        let k = level.first as usize + j * w + i;
        // From the first of the four texels to the last.
        let window = &self.texels[k..k + w + 2];
        let row = |left: u8, right: u8| {
            let left = f32::from(left);
            left + u * (f32::from(right) - left)
        };
        let (top, low) = (row(window[0], window[1]), row(window[w], window[w + 1]));
        top + v * (low - top)
    }

    /// By cubic B-splines over the texels.
    fn by_splines(&self, level: &Level, x: f32, y: f32, number: u32) -> f32 {
        let shrink = f32::from_bits((127 - number) << 23);
        let (w, h) = (level.width as usize, level.height as usize);
        let place = |at: f32, count: usize| {
            let at = (at * shrink - 0.5).clamp(0.0, (count - 1) as f32);
            (at as usize, at - at.floor())
        };
        let ((i, u), (j, v)) = (place(x, w), place(y, h));
        let texel = |i: usize, j: usize| {
            let inside = |at: usize, count: usize| at.saturating_sub(1).min(count - 1);
            let k = level.first as usize + inside(j, h) * w + inside(i, w);
            f32::from(self.texels[k])
        };
        let (across, down) = (spline_weights(u), spline_weights(v));
        let rows = down.iter().enumerate().map(|(n, weight)| {
            let row = across.iter().enumerate();
            weight * row.map(|(m, a)| a * texel(i + m, j + n)).sum::<f32>()
        });
        rows.sum()
    }
}

/// Weights of the texel before the one before a place, of that, and of the two behind it; `t` of the way between them.
fn spline_weights(t: f32) -> [f32; 4] {
    let (s, sixth) = (1.0 - t, 1.0 / 6.0);
    [
        sixth * s * s * s,
        sixth * (4.0 - 6.0 * t * t + 3.0 * t * t * t),
        sixth * (4.0 - 6.0 * s * s + 3.0 * s * s * s),
        sixth * t * t * t,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::april_grid;

    /// How far from an edge brightness crosses half of its step, root mean square in parts of a footprint, over places of the edge.
    fn edge_off(is_measured: bool, footprint_m: f32) -> f32 {
        let texel_m = 0.001;
        let off = (0..40).map(|k| {
            let edge = 0.06 + 0.0037 * k as f32 / 40.0;
            let mut canvas = Canvas::new([0.128, 0.016], texel_m, 0.1);
            canvas.is_measured = is_measured;
            canvas.rectangle([edge, 0.0], [0.128, 0.016], 0.9);
            let mut atlas = Atlas::default();
            atlas.push(&canvas);
            let at = |x: f32| atlas.sample(0, x / 0.128, 0.5, footprint_m);
            let (mut low, mut high) = (edge - 0.01, edge + 0.01);
            for _ in 0..30 {
                let middle = 0.5 * (low + high);
                match at(middle) < 127.5 {
                    true => low = middle,
                    false => high = middle,
                }
            }
            (low - edge) / footprint_m
        });
        let squares: f32 = off.map(|off| off * off).sum();
        (squares / 40.0).sqrt()
    }

    #[test]
    fn edges_of_what_is_measured_are_where_they_were_printed() {
        for footprint_m in [0.002, 0.0027, 0.004] {
            let [splines, linear] = [true, false].map(|is| edge_off(is, footprint_m));
            assert!(splines < 0.03, "{footprint_m}: {splines}");
            assert!(linear > 1.5 * splines, "{footprint_m}: {linear} {splines}");
        }
    }

    /// The board is a measure: what is off in its print by a ten-thousandth is off in every calibrated rig.
    #[test]
    fn the_board_is_printed_where_it_is_said() {
        let tag_m = 0.088;
        let (edge_m, margin_m) = (april_grid::edge_m(tag_m), april_grid::margin_m(tag_m));
        let size_m = edge_m + 2.0 * margin_m;
        let mut canvas = Canvas::new([size_m; 2], april_grid::texel_m(tag_m), 0.1);
        april_grid::paint(&mut canvas, tag_m);
        let mut atlas = Atlas::default();
        atlas.push(&canvas);
        for footprint_m in [0.002, 0.0055, 0.009] {
            for id in 0..36 {
                let [low, _, high, _] = april_grid::corners_m(id, tag_m);
                // Along the middle of the black border's lower edge, out of the tag on either side.
                let y = margin_m + low[1] + 0.1 * tag_m;
                let at = |x: f32| atlas.sample(0, x / size_m, y / size_m, footprint_m);
                for (edge, outwards) in [(margin_m + low[0], -1.0), (margin_m + high[0], 1.0)] {
                    let half = 0.5 * (at(edge - 0.012) + at(edge + 0.012));
                    let (mut black, mut white) = (edge - 0.012 * outwards, edge + 0.012 * outwards);
                    for _ in 0..30 {
                        let middle = 0.5 * (black + white);
                        match at(middle) < half {
                            true => black = middle,
                            false => white = middle,
                        }
                    }
                    let off = (black - edge).abs() / footprint_m;
                    assert!(off < 1.2e-3, "{footprint_m}, tag {id}: {off}");
                }
            }
        }
    }

    #[test]
    fn weights_of_splines_add_up_and_keep_slopes() {
        for t in [0.0, 0.3, 0.5, 0.99] {
            let weights = spline_weights(t);
            assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
            let places = [-1.0, 0.0, 1.0, 2.0];
            let mean: f32 = weights.iter().zip(places).map(|(w, x)| w * x).sum();
            assert!((mean - t).abs() < 1e-6, "{t}: {mean}");
        }
    }
}
