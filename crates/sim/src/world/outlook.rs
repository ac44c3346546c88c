//! What is outside the windows, all around and so far away that it looks the same from everywhere: sky, houses, trees.

use std::f32::consts::{FRAC_PI_2, TAU};

use super::canvas::Canvas;
use crate::noise::{below, hash, stream, uniform};

/// Texels around the horizon.
const AROUND: usize = 2048;
/// Reflectance that stands for the mean of what is seen.
const MEAN: f32 = 0.6;
/// Where the horizon is in the picture, from its lower edge, radians; the picture ends a quarter of a circle above the lower edge.
const HORIZON: f32 = 0.5 * FRAC_PI_2;

/// Paints it; across is the direction, up the elevation, radians.
pub(super) fn paint(seed: u64) -> Canvas {
    let rng = stream(hash(seed), "outlook", 0);
    let mut canvas = Canvas::new([TAU, FRAC_PI_2], TAU / AROUND as f32, 0.9);
    canvas.add_noise(0.02, 0.6, [3.0, 1.0], rng.bits());
    canvas.vary(|_, y, value| match y > HORIZON {
        true => value - 0.25 * (y - HORIZON),
        false => 0.22 + 0.12 * y / HORIZON,
    });
    // Far ones first, and paler.
    for k in 0..110 {
        let near = k as f32 / 110.0;
        let (left, wide) = (
            uniform(&rng, 0.0, TAU),
            uniform(&rng, 0.04, 0.1 + 0.22 * near),
        );
        let tall = uniform(&rng, 0.02, 0.06 + 0.24 * near * near);
        let haze = 0.45 * (1.0 - near);
        let wall = haze + (1.0 - haze) * uniform(&rng, 0.12, 0.55);
        let foot = HORIZON - 0.02 - 0.1 * near * near;
        let high = [(left + wide).min(TAU), HORIZON + tall];
        canvas.rectangle([left, foot], high, wall);
        let (pitch, storey) = (uniform(&rng, 0.008, 0.02), uniform(&rng, 0.012, 0.026));
        let glass = wall * uniform(&rng, 0.3, 0.7);
        let mut y = foot + 0.6 * storey;
        while y + storey < high[1] {
            let mut x = left + 0.4 * pitch;
            while x + pitch < high[0] {
                canvas.rectangle([x, y], [x + 0.55 * pitch, y + 0.55 * storey], glass);
                x += pitch;
            }
            y += storey;
        }
    }
    for _ in 0..70 {
        let (x, tall) = (uniform(&rng, 0.0, TAU), uniform(&rng, 0.03, 0.16));
        let foot = HORIZON - uniform(&rng, 0.02, 0.14);
        let leaf = uniform(&rng, 0.06, 0.2);
        canvas.stroke([x, foot], [x, foot + 0.6 * tall], 0.08 * tall, 0.7 * leaf);
        for _ in 0..14 + below(&rng, 10) {
            let centre = [
                x + uniform(&rng, -0.3, 0.3) * tall,
                foot + uniform(&rng, 0.45, 1.0) * tall,
            ];
            let r = tall * uniform(&rng, 0.06, 0.16);
            canvas.ellipse(centre, [r, r], 0.0, leaf * uniform(&rng, 0.6, 1.5));
        }
    }
    let mean = canvas.values.iter().sum::<f32>() / canvas.values.len() as f32;
    for value in &mut canvas.values {
        *value = (*value * MEAN / mean).clamp(0.02, 0.98);
    }
    canvas
}

/// Where in the picture one looks along a direction of unit length, in widths and heights.
#[inline]
pub(super) fn place([x, y, z]: [f32; 3]) -> [f32; 2] {
    let around = y.atan2(x) / TAU;
    let up = z.clamp(-1.0, 1.0).asin();
    [
        around - around.floor(),
        ((up + HORIZON) / FRAC_PI_2).clamp(0.0, 1.0),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sky_is_above_and_directions_follow_one_another() {
        let up = place([0.1, 0.0, 0.99]);
        let level = place([1.0, 0.0, 0.0]);
        assert!(up[1] > 0.9 && (level[1] - 0.5).abs() < 1e-6);
        let [north, west] = [place([0.0, 1.0, 0.0]), place([-1.0, 0.0, 0.0])];
        assert!((north[0] - 0.25).abs() < 1e-6 && (west[0] - 0.5).abs() < 1e-6);
        let canvas = paint(4);
        let mean = |rows: std::ops::Range<usize>| {
            let part = &canvas.values[rows.start * canvas.width..rows.end * canvas.width];
            part.iter().sum::<f32>() / part.len() as f32
        };
        let height = canvas.height;
        assert!(mean(height * 4 / 5..height) > 2.0 * mean(0..height / 4));
    }
}
