//! The corner to a few hundredths of a pixel: the point to which all gradients around it are perpendicular (Förstner 1987).

use lsfb_geometry::{Matrix2, Vector2};
use lsfb_types::Image;

use super::RoughCorner;

/// Windows, half their edge, pixels.
const SMALLEST_PX: f64 = 2.0;
const LARGEST_PX: f64 = 8.0;
const MAX_STEPS: usize = 12;

/// Moves the corner; `false` where there is none: the window leaves the image or the steps run away.
pub(super) fn refine(image: &Image, seen: &mut RoughCorner) -> bool {
    // A square window turned against the edges reaches √2 farther.
    let half_px = (seen.clear_px / std::f64::consts::SQRT_2 * 1.2).clamp(SMALLEST_PX, LARGEST_PX);
    let start = seen.pixel;
    let mut at = start;
    for _ in 0..MAX_STEPS {
        let Some(next) = step(image, &at, half_px) else {
            return false;
        };
        let moved = (next - at).norm();
        at = next;
        if (at - start).norm() > half_px.max(2.0) {
            return false;
        }
        if moved < 2e-3 {
            break;
        }
    }
    seen.pixel = at;
    true
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
