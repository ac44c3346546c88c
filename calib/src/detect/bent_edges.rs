//! How the lens bends edges: where corners of one straight line of the board are seen.
//!
//! Straight edges fitted to what a lens bends lie on the inner side of the bow: corners come out too near to the middle of the image, in all
//! images alike, by 0.003 px in the outer half of those of a camera with 85° across, by 0.008 px with 140°.

use lsfb_geometry::{Vector2, Vector3};
use nalgebra::Matrix3;

use super::RoughCorner;
use crate::board::Target;

/// Corners of a line on either side from which its curve is taken.
const ON_EITHER_SIDE: usize = 3;
/// Corners without which there is none: three lie on some parabola always.
const FEWEST: usize = 4;
/// Edges that seem to be bent more than this have a corner on them that is none, 1/px.
const MOST_BENT_PER_PX: f64 = 0.01;

/// Two edges that are not bent.
pub(super) const STRAIGHT: [Vector2<f64>; 2] = [Vector2::new(0.0, 0.0); 2];

/// A line of the board where it goes through a corner.
struct Curve {
    /// Its direction.
    along: Vector2<f64>,
    /// Vector to the middle of the circle that touches it, as long as this one's radius is short, 1/px.
    bend: Vector2<f64>,
}

/// For each corner how its two edges are bent, 1/px, as [`Curve::bend`]; zero where nothing tells.
pub(super) fn bends(target: &Target, corners: &[RoughCorner]) -> Vec<[Vector2<f64>; 2]> {
    let places: Vec<Vector3<f64>> = corners.iter().map(|c| target.corner(c.index)).collect();
    let pixels: Vec<Vector2<f64>> = corners.iter().map(|c| c.pixel).collect();
    let lines = [0, 1].map(|axis| curves(&places, &pixels, axis));
    let of_corner = |(k, seen): (usize, &RoughCorner)| {
        let curves = [lines[0][k].as_ref(), lines[1][k].as_ref()];
        let Some(edges) = &seen.edges else {
            return STRAIGHT;
        };
        let bend = |curve: Option<&Curve>| curve.map_or_else(Vector2::zeros, |curve| curve.bend);
        let alike = |edge: usize, line: usize| {
            curves[line].map_or(0.5, |curve| curve.along.dot(&edges[edge]).abs())
        };
        let [first, second] = match alike(0, 0) + alike(1, 1) >= alike(0, 1) + alike(1, 0) {
            true => [0, 1],
            false => [1, 0],
        };
        [bend(curves[first]), bend(curves[second])]
    };
    corners.iter().enumerate().map(of_corner).collect()
}

/// The lines along an axis of the board through each of some corners.
fn curves(places: &[Vector3<f64>], pixels: &[Vector2<f64>], axis: usize) -> Vec<Option<Curve>> {
    let across = 1 - axis;
    let nanometres = |k: usize| (places[k][across] * 1e9).round() as i64;
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by(|a, b| {
        let by_line = nanometres(*a).cmp(&nanometres(*b));
        by_line.then(places[*a][axis].total_cmp(&places[*b][axis]))
    });
    let mut curves: Vec<Option<Curve>> = places.iter().map(|_| None).collect();
    for line in order.chunk_by(|a, b| nanometres(*a) == nanometres(*b)) {
        for (at, corner) in line.iter().enumerate() {
            let first = at.saturating_sub(ON_EITHER_SIDE);
            let end = (at + ON_EITHER_SIDE + 1).min(line.len());
            let seen = line[first..end].iter().map(|k| {
                let along_m = places[*k][axis] - places[*corner][axis];
                (along_m, pixels[*k] - pixels[*corner])
            });
            curves[*corner] = curve(seen);
        }
    }
    curves
}

/// The parabola through what is seen of a line, by its distance along the board.
fn curve(seen: impl ExactSizeIterator<Item = (f64, Vector2<f64>)>) -> Option<Curve> {
    if seen.len() < FEWEST {
        return None;
    }
    let mut normal = Matrix3::zeros();
    let mut right = [Vector3::zeros(); 2];
    for (along_m, pixel) in seen {
        let powers = Vector3::new(1.0, along_m, 0.5 * along_m * along_m);
        normal += powers * powers.transpose();
        right[0] += powers * pixel.x;
        right[1] += powers * pixel.y;
    }
    let inverse = normal.try_inverse()?;
    let [x, y] = right.map(|right| inverse * right);
    let (speed, turn) = (Vector2::new(x[1], y[1]), Vector2::new(x[2], y[2]));
    let along = speed.try_normalize(f64::MIN_POSITIVE)?;
    let bend = (turn - along * along.dot(&turn)) / speed.norm_squared();
    (bend.norm() <= MOST_BENT_PER_PX).then_some(Curve { along, bend })
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Camera;
    use lsfb_geometry::camera::Lens;
    use lsfb_types::Image;

    use super::super::detect;
    use super::*;

    const SQUARE_M: f64 = 0.02;
    const COLUMNS: u32 = 9;
    const ROWS: u32 = 6;

    /// A lens that sees 140° across.
    fn camera() -> Camera {
        Camera {
            width: 320,
            height: 240,
            lens: Lens::KannalaBrandt {
                focal_px: [130.0; 2],
                principal_px: [159.5, 119.5],
                distortion: [0.0; 4],
            },
        }
    }

    /// A checkerboard that faces the camera, its first inner corner here, metres; pixels are means of what is in them.
    fn seen(camera: &Camera, first: &Vector3<f64>) -> Image {
        const STEPS: usize = 5;
        let is_white = |ray: Vector3<f64>| {
            let on_board = (ray * (first.z / ray.z) - first) / SQUARE_M;
            let (x, y) = (on_board.x.floor() as i64, on_board.y.floor() as i64);
            let is_board =
                (-1..i64::from(COLUMNS)).contains(&x) && (-1..i64::from(ROWS)).contains(&y);
            !is_board || (x + y) % 2 == 0
        };
        let offset = |k: usize| (k as f64 + 0.5) / STEPS as f64 - 0.5;
        let width = camera.width as usize;
        let pixels = (0..width * camera.height as usize).map(|n| {
            let pixel = Vector2::new((n % width) as f64, (n / width) as f64);
            let parts =
                (0..STEPS * STEPS).map(|k| Vector2::new(offset(k % STEPS), offset(k / STEPS)));
            let rays = parts.filter_map(|part| camera.unproject(&(pixel + part)));
            let white = rays.filter(|ray| is_white(*ray)).count();
            (30.0 + 190.0 * white as f64 / (STEPS * STEPS) as f64).round() as u8
        });
        Image {
            width: camera.width,
            height: camera.height,
            pixels: pixels.collect(),
            exposure_ns: 0,
            frame_id: 0,
        }
    }

    /// By straight edges corners are 0.008 px too near to the middle in the mean.
    #[test]
    fn corners_are_not_pulled_to_where_the_lens_bends_edges() {
        let target = Target::Checkerboard {
            columns: COLUMNS,
            rows: ROWS,
            square_m: SQUARE_M,
        };
        let (camera, mut sum_px, mut count) = (camera(), 0.0, 0);
        for first in [
            [0.02, -0.05, 0.15],
            [0.03, -0.08, 0.17],
            [-0.2, -0.05, 0.16],
            [-0.21, -0.03, 0.18],
        ] {
            let first = Vector3::from(first);
            let truths: Vec<Vector2<f64>> = (0..target.corner_count())
                .filter_map(|k| camera.project(&(first + target.corner(k))))
                .collect();
            for corner in detect(&seen(&camera, &first), &target) {
                let off_px = |truth: &&Vector2<f64>| (corner.pixel - **truth).norm();
                let nearest = truths.iter().min_by(|a, b| off_px(a).total_cmp(&off_px(b)));
                let truth = nearest.expect("corners before the camera");
                let outwards = (truth - Vector2::new(159.5, 119.5)).normalize();
                let off = corner.pixel - truth;
                assert!(off.norm() < 0.2, "{off}");
                sum_px += outwards.dot(&off);
                count += 1;
            }
        }
        let mean_px = sum_px / f64::from(count);
        assert!(count > 100 && mean_px.abs() < 0.002, "{count}: {mean_px}");
    }
}
