//! What JPEG does to a grey image: blocks of 8 × 8 pixels, their cosine transform in coarse steps (ITU-T T.81).

use std::f32::consts::PI;

use rayon::prelude::*;

const BLOCK: usize = 8;

/// Steps of the luminance coefficients at quality 50 (T.81, table K.1).
const STEPS: [[f32; BLOCK]; BLOCK] = [
    [16.0, 11.0, 10.0, 16.0, 24.0, 40.0, 51.0, 61.0],
    [12.0, 12.0, 14.0, 19.0, 26.0, 58.0, 60.0, 55.0],
    [14.0, 13.0, 16.0, 24.0, 40.0, 57.0, 69.0, 56.0],
    [14.0, 17.0, 22.0, 29.0, 51.0, 87.0, 80.0, 62.0],
    [18.0, 22.0, 37.0, 56.0, 68.0, 109.0, 103.0, 77.0],
    [24.0, 35.0, 55.0, 64.0, 81.0, 104.0, 113.0, 92.0],
    [49.0, 64.0, 78.0, 87.0, 103.0, 121.0, 120.0, 101.0],
    [72.0, 92.0, 95.0, 98.0, 112.0, 100.0, 103.0, 99.0],
];

/// Leaves the image as a decoder would show it after compression at a quality from 1 to 100, scaled as libjpeg does.
/// Rows and columns beyond the last whole block stay as they are.
pub(super) fn compress(pixels: &mut [u8], width: usize, quality: u8) {
    let quality = f32::from(quality.clamp(1, 100));
    let scale = if quality < 50.0 {
        50.0 / quality
    } else {
        2.0 - quality / 50.0
    };
    let steps = STEPS.map(|row| row.map(|s| (s * scale + 0.5).floor().clamp(1.0, 255.0)));
    let basis: [[f32; BLOCK]; BLOCK] = std::array::from_fn(|k| {
        let norm = if k == 0 { (1.0_f32 / 8.0).sqrt() } else { 0.5 };
        std::array::from_fn(|x| norm * ((x as f32 + 0.5) * k as f32 * PI / 8.0).cos())
    });
    pixels.par_chunks_exact_mut(width * BLOCK).for_each(|band| {
        for left in (0..width / BLOCK * BLOCK).step_by(BLOCK) {
            let block: Block = std::array::from_fn(|y| {
                std::array::from_fn(|x| f32::from(band[y * width + left + x]) - 128.0)
            });
            let mut waves = both_ways(&block, |k, x| basis[k][x]);
            for (row, steps) in waves.iter_mut().zip(&steps) {
                for (value, step) in row.iter_mut().zip(steps) {
                    *value = (*value / step).round() * step;
                }
            }
            let shown = both_ways(&waves, |x, k| basis[k][x]);
            for (y, row) in shown.iter().enumerate() {
                for (x, value) in row.iter().enumerate() {
                    band[y * width + left + x] = (value + 128.5).clamp(0.0, 255.0) as u8;
                }
            }
        }
    });
}

type Block = [[f32; BLOCK]; BLOCK];

/// `M block Mᵀ`.
fn both_ways(block: &Block, m: impl Fn(usize, usize) -> f32) -> Block {
    let half: Block = std::array::from_fn(|i| {
        std::array::from_fn(|x| (0..BLOCK).map(|y| m(i, y) * block[y][x]).sum())
    });
    std::array::from_fn(|i| std::array::from_fn(|j| (0..BLOCK).map(|x| half[i][x] * m(j, x)).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn best_quality_keeps_the_image_and_low_quality_keeps_the_means() {
        let width = 32;
        let image: Vec<u8> = (0..width * 16)
            .map(|k| (40 + (k * 37) % 160) as u8)
            .collect();
        let mut fine = image.clone();
        compress(&mut fine, width, 100);
        assert!(image.iter().zip(&fine).all(|(a, b)| a.abs_diff(*b) <= 2));
        let mut rough = image.clone();
        compress(&mut rough, width, 5);
        assert!(image.iter().zip(&rough).any(|(a, b)| a.abs_diff(*b) > 20));
        let mean = |pixels: &[u8]| {
            let sum: f32 = pixels.iter().map(|p| f32::from(*p)).sum();
            sum / pixels.len() as f32
        };
        assert!((mean(&image) - mean(&rough)).abs() < 12.0);
    }
}
