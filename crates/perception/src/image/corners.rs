//! Corners of an image that can be found again in another.

use lsfb_geometry::Vector2;

use super::gray::Gray;

/// Corners looked for at most, one per cell.
const CELLS: [usize; 2] = [20, 14];
/// Pixels at the border in which none are looked for.
const MARGIN: usize = 7;
/// Share of the larger eigenvalue that the smaller one has.
const ROUND: f64 = 0.1;

/// The strongest corner of each cell: the larger the smaller eigenvalue of its gradients over 5 × 5 pixels, and that above
/// `least` (grey levels squared).
pub fn corners(image: &Gray, least: f64) -> Vec<Vector2<f64>> {
    let (width, height) = (image.width(), image.height());
    let value = |x: usize, y: usize| image.at(x, y);
    let mut out = Vec::new();
    if width < 4 * MARGIN || height < 4 * MARGIN {
        return out;
    }
    let cell = [width / CELLS[0], height / CELLS[1]].map(|c| c.max(1));
    for cy in 0..height / cell[1] {
        for cx in 0..width / cell[0] {
            let mut best: Option<(f64, [usize; 2])> = None;
            for y in (cy * cell[1]..(cy + 1) * cell[1]).step_by(2) {
                for x in (cx * cell[0]..(cx + 1) * cell[0]).step_by(2) {
                    let inside =
                        x >= MARGIN && y >= MARGIN && x + MARGIN < width && y + MARGIN < height;
                    if !inside {
                        continue;
                    }
                    let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
                    for v in y - 2..=y + 2 {
                        for u in x - 2..=x + 2 {
                            let dx = value(u + 1, v) - value(u - 1, v);
                            let dy = value(u, v + 1) - value(u, v - 1);
                            a += dx * dx;
                            b += dx * dy;
                            c += dy * dy;
                        }
                    }
                    let smaller = 0.5 * (a + c - ((a - c).powi(2) + 4.0 * b * b).sqrt());
                    if smaller > ROUND * (a + c - smaller) && smaller > best.map_or(least, |b| b.0)
                    {
                        best = Some((smaller, [x, y]));
                    }
                }
            }
            out.extend(best.map(|(_, [x, y])| Vector2::new(x as f64, y as f64)));
        }
    }
    out
}
