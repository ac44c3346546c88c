//! The corner to a few hundredths of a pixel: the point to which all gradients around it are perpendicular (Förstner 1987), and from there
//! the middle of the four sectors around it (`super::saddle_fit`).

use lsfb_geometry::{Matrix2, Vector2};
use lsfb_types::Image;

use super::{RoughCorner, saddle_fit};

/// Windows, half their edge, pixels.
const SMALLEST_PX: f64 = 2.0;
const LARGEST_PX: f64 = 8.0;
/// Radius in which sectors are fitted, pixels.
const LEAST_FIT_PX: f64 = 2.2;
const LARGEST_FIT_PX: f64 = 6.0;
const MAX_STEPS: usize = 12;

/// Moves the corner; `false` where there is none: the window leaves the image or the steps run away.
pub(super) fn refine(image: &Image, seen: &mut RoughCorner) -> bool {
    let Some(at) = by_gradients(image, &seen.pixel, seen.clear_px) else {
        return false;
    };
    // What fits no sectors keeps the place that gradients give it.
    let radius_px = seen.alone_px.clamp(LEAST_FIT_PX, LARGEST_FIT_PX);
    seen.pixel = saddle_fit::fit(image, &at, radius_px).unwrap_or(at);
    true
}

/// The point to which gradients are perpendicular.
pub(super) fn by_gradients(
    image: &Image,
    start: &Vector2<f64>,
    clear_px: f64,
) -> Option<Vector2<f64>> {
    // A square window turned against the edges reaches √2 farther.
    let half_px = (clear_px / std::f64::consts::SQRT_2 * 1.2).clamp(SMALLEST_PX, LARGEST_PX);
    let mut at = *start;
    for _ in 0..MAX_STEPS {
        let next = step(image, &at, half_px)?;
        let moved = (next - at).norm();
        at = next;
        if (at - start).norm() > half_px.max(2.0) {
            return None;
        }
        if moved < 2e-3 {
            break;
        }
    }
    Some(at)
}

fn step(image: &Image, at: &Vector2<f64>, half_px: f64) -> Option<Vector2<f64>> {
    let (width, height) = (image.width as i64, image.height as i64);
    let reach = half_px.ceil() as i64;
    let (cx, cy) = (at.x.round() as i64, at.y.round() as i64);
    if cx - reach < 1 || cy - reach < 1 || cx + reach > width - 2 || cy + reach > height - 2 {
        return None;
    }
    let pixels = &image.pixels;
    let value = |x: i64, y: i64| f64::from(pixels[(y * width + x) as usize]);
    let mut normal = Matrix2::zeros();
    let mut right = Vector2::zeros();
    let falloff = 1.0 / (half_px * half_px);
    for y in cy - reach..=cy + reach {
        for x in cx - reach..=cx + reach {
            let p = Vector2::new(x as f64, y as f64);
            // Smooth at its border: a window that jumps with the pixels would pull the corner to them.
            let rest = 1.0 - (p - at).norm_squared() * falloff;
            if rest <= 0.0 {
                continue;
            }
            let weight = rest * rest;
            let gx = value(x + 1, y) - value(x - 1, y);
            let gy = value(x, y + 1) - value(x, y - 1);
            let g = Matrix2::new(gx * gx, gx * gy, gx * gy, gy * gy) * weight;
            normal += g;
            right += g * (p - at);
        }
    }
    Some(at + normal.try_inverse()? * right)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: usize = 40;

    /// A tag's corner beside the dark square in the gap, `gap_px` wide, turned and sheared as boards are seen aslant; pixels are means of
    /// what is in them, and blurred by as much again where asked for.
    fn tag_corner(corner: Vector2<f64>, turn_rad: f64, gap_px: f64, blur_px: f64) -> Image {
        let across = |angle: f64| Vector2::new(angle.cos(), angle.sin());
        let (u, v) = (across(turn_rad), across(turn_rad + 1.25));
        let is_dark = |p: Vector2<f64>| {
            let (s, t) = (u.dot(&(p - corner)), v.dot(&(p - corner)));
            let tag = 0.0..gap_px / 0.3;
            let gap = -gap_px..0.0;
            (tag.contains(&s) && tag.contains(&t)) || (gap.contains(&s) && gap.contains(&t))
        };
        const STEPS: usize = 12;
        let edge_px = 1.0 + blur_px;
        let offset = |k: usize| ((k as f64 + 0.5) / STEPS as f64 - 0.5) * edge_px;
        let pixels = (0..SIZE * SIZE).map(|n| {
            let pixel = Vector2::new((n % SIZE) as f64, (n / SIZE) as f64);
            let dark = (0..STEPS * STEPS)
                .filter(|k| is_dark(pixel + Vector2::new(offset(k % STEPS), offset(k / STEPS))))
                .count();
            (220.0 - 190.0 * dark as f64 / (STEPS * STEPS) as f64).round() as u8
        });
        Image {
            width: SIZE as u32,
            height: SIZE as u32,
            pixels: pixels.collect(),
            exposure_ns: 0,
            frame_id: 0,
        }
    }

    /// Root mean square of the error over turns and places between pixels, by sectors and by gradients; how often sectors fit.
    fn rms_px(gap_px: f64, blur_px: f64) -> ([f64; 2], usize) {
        let (mut squares, mut counts) = ([0.0; 2], [0_usize; 2]);
        for k in 0..60 {
            let part = |n: usize| (k * n % 60) as f64 / 60.0;
            let corner = Vector2::new(19.5 + part(7), 19.5 + part(13));
            let image = tag_corner(corner, 1.5 * part(1), gap_px, blur_px);
            let start = corner + Vector2::new(part(17) - 0.5, part(23) - 0.5) * 0.6;
            let by_sectors = saddle_fit::fit(&image, &start, 0.8 * gap_px);
            let by_gradients = by_gradients(&image, &start, 0.45 * gap_px);
            for (way, found) in [by_sectors, by_gradients].into_iter().enumerate() {
                if let Some(found) = found {
                    squares[way] += (found - corner).norm_squared();
                    counts[way] += 1;
                }
            }
        }
        let rms_px = [0, 1].map(|way| (squares[way] / counts[way].max(1) as f64).sqrt());
        (rms_px, counts[0])
    }

    /// Gradients alone, which pixels pull, are several times as far off.
    #[test]
    fn corners_beside_narrow_gaps_are_found_to_a_few_hundredths_of_a_pixel() {
        for (gap_px, blur_px, most_px) in [
            (3.6, 0.0, 0.05),
            (5.0, 0.0, 0.03),
            (5.0, 1.5, 0.03),
            (7.0, 0.0, 0.03),
        ] {
            let ([sectors_px, gradients_px], count) = rms_px(gap_px, blur_px);
            let found = format!(
                "gap {gap_px}, blur {blur_px}: {sectors_px:.3} px, {count} of 60; by gradients {gradients_px:.3} px"
            );
            assert!(sectors_px < most_px && count > 55, "{found}");
            assert!(gradients_px > 2.0 * sectors_px, "{found}");
        }
    }

    #[test]
    fn what_is_no_corner_is_not_fitted() {
        let flat = Image {
            width: 20,
            height: 20,
            pixels: vec![90; 400],
            exposure_ns: 0,
            frame_id: 0,
        };
        assert_eq!(saddle_fit::fit(&flat, &Vector2::new(10.0, 10.0), 4.0), None);
        let image = tag_corner(Vector2::new(19.7, 20.2), 0.3, 5.0, 0.0);
        assert_eq!(
            saddle_fit::fit(&image, &Vector2::new(1.0, 20.0), 4.0),
            None,
            "off the image"
        );
    }
}
