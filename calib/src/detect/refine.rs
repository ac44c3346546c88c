//! The corner to a few hundredths of a pixel: the point to which all gradients around it are perpendicular (Förstner 1987), and from there
//! the middle of the four sectors around it (`super::saddle_fit`).

use lsfb_geometry::{Matrix2, Vector2};
use lsfb_types::Image;

use super::bent_edges::STRAIGHT;
use super::{RoughCorner, saddle_fit};

/// Windows, half their edge, pixels.
const SMALLEST_PX: f64 = 2.0;
const LARGEST_PX: f64 = 8.0;
/// Radius in which sectors are fitted, pixels.
const LEAST_FIT_PX: f64 = 2.2;
const LARGEST_FIT_PX: f64 = 5.0;
const MAX_STEPS: usize = 12;

/// Moves the corner; `false` where there is none: the window leaves the image or the steps run away.
pub(super) fn refine(image: &Image, seen: &mut RoughCorner) -> bool {
    let Some(at) = by_gradients(image, &seen.pixel, seen.clear_px) else {
        return false;
    };
    seen.pixel = at;
    // Where no sectors are seen the corner keeps the place that gradients give it.
    fit_sectors(image, seen, &STRAIGHT);
    true
}

/// Moves the corner to the middle of the four sectors around it, between edges that are bent by so much, 1/px; leaves it where there are none.
pub(super) fn fit_sectors(image: &Image, seen: &mut RoughCorner, bends: &[Vector2<f64>; 2]) {
    let radius_px = seen.alone_px.clamp(LEAST_FIT_PX, LARGEST_FIT_PX);
    let fitted = seen
        .edges
        .and_then(|edges| saddle_fit::fit(image, &seen.pixel, &edges, bends, radius_px));
    seen.pixel = fitted.unwrap_or(seen.pixel);
}

/// The point to which gradients are perpendicular.
fn by_gradients(image: &Image, start: &Vector2<f64>, clear_px: f64) -> Option<Vector2<f64>> {
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

    /// A tag's corner beside the dark square in the gap, `gap_px` wide across, turned and sheared as boards are seen aslant: its edges meet
    /// at `opening_rad`. Pixels are means of what is in them, and blurred by as much again where asked for.
    struct TagCorner {
        turn_rad: f64,
        opening_rad: f64,
        gap_px: f64,
        blur_px: f64,
    }

    impl TagCorner {
        /// Directions across both edges.
        fn across(&self) -> [Vector2<f64>; 2] {
            let unit = |angle: f64| Vector2::new(angle.cos(), angle.sin());
            [unit(self.turn_rad), unit(self.turn_rad + self.opening_rad)]
        }

        /// Directions along both, off by as much to either side.
        fn edges(&self, off_rad: f64) -> [Vector2<f64>; 2] {
            let along = |across: Vector2<f64>| Vector2::new(across.y, -across.x);
            let [u, v] = self.across().map(along);
            [u + v * off_rad, v - u * off_rad].map(|edge| edge.normalize())
        }
    }

    fn tag_corner(corner: Vector2<f64>, tag: &TagCorner) -> Image {
        let &TagCorner {
            gap_px, blur_px, ..
        } = tag;
        let [u, v] = tag.across();
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
    fn rms_px(tag: &TagCorner, turns_rad: f64) -> ([f64; 2], usize) {
        let (mut squares, mut counts) = ([0.0; 2], [0_usize; 2]);
        for k in 0..60 {
            let part = |n: usize| (k * n % 60) as f64 / 60.0;
            let corner = Vector2::new(19.5 + part(7), 19.5 + part(13));
            let turned = TagCorner {
                turn_rad: tag.turn_rad + turns_rad * part(1),
                ..*tag
            };
            let image = tag_corner(corner, &turned);
            let start = corner + Vector2::new(part(17) - 0.5, part(23) - 0.5) * 0.6;
            // As rays of a saddle are found: a few degrees off.
            let edges = turned.edges(0.2 * (part(29) - 0.5));
            let radius_px = (0.8 * tag.gap_px).min(LARGEST_FIT_PX);
            let by_sectors = saddle_fit::fit(&image, &start, &edges, &STRAIGHT, radius_px);
            let by_gradients = by_gradients(&image, &start, 0.45 * tag.gap_px);
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
            let tag = TagCorner {
                turn_rad: 0.0,
                opening_rad: 1.25,
                gap_px,
                blur_px,
            };
            let ([sectors_px, gradients_px], count) = rms_px(&tag, 1.5);
            let found = format!(
                "gap {gap_px}, blur {blur_px}: {sectors_px:.3} px, {count} of 60; by gradients {gradients_px:.3} px"
            );
            assert!(sectors_px < most_px && count == 60, "{found}");
            assert!(gradients_px > 2.0 * sectors_px, "{found}");
        }
    }

    /// One in eight was not found once: edges that are sharper than pixels and run along their rows fit any steepness.
    #[test]
    fn sharp_edges_along_rows_of_pixels_are_fitted() {
        for opening_rad in [std::f64::consts::FRAC_PI_2, 1.5, 0.7] {
            let tag = TagCorner {
                turn_rad: -0.02,
                opening_rad,
                gap_px: 9.0,
                blur_px: 0.0,
            };
            let ([sectors_px, _], count) = rms_px(&tag, 0.04);
            let found = format!("{opening_rad}: {sectors_px:.3} px, {count} of 60");
            assert!(sectors_px < 0.03 && count == 60, "{found}");
        }
    }

    #[test]
    fn corners_beside_the_border_of_the_image_are_fitted() {
        let corner = Vector2::new(20.3, 19.6);
        let tag = TagCorner {
            turn_rad: 0.4,
            opening_rad: 1.4,
            gap_px: 9.0,
            blur_px: 0.0,
        };
        let whole = tag_corner(corner, &tag);
        let first = 17;
        let cut = Image {
            width: (SIZE - first) as u32,
            pixels: whole
                .pixels
                .chunks(SIZE)
                .flat_map(|row| row[first..].to_vec())
                .collect(),
            ..whole
        };
        let start = Vector2::new(3.1, 19.8);
        let found =
            saddle_fit::fit(&cut, &start, &tag.edges(0.05), &STRAIGHT, 5.0).expect("a corner");
        let off_px = (found + Vector2::x() * first as f64 - corner).norm();
        assert!(off_px < 0.03, "{off_px}");
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
        let edges = [Vector2::x(), Vector2::y()];
        let fitted = |image: &Image| {
            saddle_fit::fit(image, &Vector2::new(9.6, 10.0), &edges, &STRAIGHT, 4.0)
        };
        assert_eq!(fitted(&flat), None);
        let steps = Image {
            pixels: (0..400)
                .map(|k| if k % 20 < 10 { 30 } else { 200 })
                .collect(),
            ..flat
        };
        assert_eq!(fitted(&steps), None);
    }
}
