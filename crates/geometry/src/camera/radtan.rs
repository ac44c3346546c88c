//! Pinhole with radial-tangential distortion: Brown 1971 as OpenCV's `calib3d` writes it.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

use super::{ByDistortion, Distorted};

/// Points nearer to the plane of the lens than this are not seen, metres.
const NEAREST_M: f64 = 1e-6;

#[inline]
pub(super) fn distort(p: &Vector3<f64>, distortion: &[f64; 5]) -> Option<Distorted> {
    if p.z < NEAREST_M {
        return None;
    }
    let inverse_z = 1.0 / p.z;
    let n = Vector2::new(p.x * inverse_z, p.y * inverse_z);
    let (value, by_n) = on_plane(&n, distortion)?;
    let third = -(by_n * n) * inverse_z;
    Some(Distorted {
        value,
        by_point: Matrix2x3::new(
            by_n.m11 * inverse_z,
            by_n.m12 * inverse_z,
            third.x,
            by_n.m21 * inverse_z,
            by_n.m22 * inverse_z,
            third.y,
        ),
    })
}

pub(super) fn by_distortion(p: &Vector3<f64>) -> ByDistortion {
    let (x, y) = (p.x / p.z, p.y / p.z);
    let r2 = x * x + y * y;
    let mut by = ByDistortion::zeros();
    for (row, n) in [x, y].into_iter().enumerate() {
        by[(row, 0)] = n * r2;
        by[(row, 1)] = n * r2 * r2;
        by[(row, 4)] = n * r2 * r2 * r2;
    }
    by[(0, 2)] = 2.0 * x * y;
    by[(0, 3)] = r2 + 2.0 * x * x;
    by[(1, 2)] = r2 + 2.0 * y * y;
    by[(1, 3)] = 2.0 * x * y;
    by
}

pub(super) fn undistort(d: &Vector2<f64>, distortion: &[f64; 5]) -> Option<Vector3<f64>> {
    // From the centre outwards: the start of strongly curved lenses must lie inside the validity region.
    let mut n = *d;
    for _ in 0..60 {
        if on_plane(&n, distortion).is_some() {
            break;
        }
        n *= 0.9;
    }
    for _ in 0..30 {
        let (value, jacobian) = on_plane(&n, distortion)?;
        let step = jacobian.try_inverse()? * (d - value);
        // A step out of the region is shortened until it ends inside.
        let mut share = 1.0;
        while on_plane(&(n + step * share), distortion).is_none() {
            share *= 0.5;
            if share < 1e-6 {
                return None;
            }
        }
        n += step * share;
        if step.norm() < 1e-14 {
            break;
        }
    }
    let (value, _) = on_plane(&n, distortion)?;
    ((value - d).norm() < 1e-9).then(|| Vector3::new(n.x, n.y, 1.0).normalize())
}

/// Distorted normalised coordinates and their derivative; `None` where the radial polynomial has folded over.
#[inline]
fn on_plane(
    n: &Vector2<f64>,
    [k1, k2, p1, p2, k3]: &[f64; 5],
) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let (x, y) = (n.x, n.y);
    let r2 = n.norm_squared();
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let radial_by_r2 = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
    if folded(r2, *k1, *k2, *k3) {
        return None;
    }
    let d = Vector2::new(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    );
    let cross = 2.0 * x * y * radial_by_r2 + 2.0 * p1 * x + 2.0 * p2 * y;
    let jacobian = Matrix2::new(
        radial + 2.0 * x * x * radial_by_r2 + 2.0 * p1 * y + 6.0 * p2 * x,
        cross,
        cross,
        radial + 2.0 * y * y * radial_by_r2 + 6.0 * p1 * y + 2.0 * p2 * x,
    );
    Some((d, jacobian))
}

/// Whether the slope of `r (1 + k1 r² + k2 r⁴ + k3 r⁶)`, a cubic in `s = r²`, reaches zero at or before `s`. A point
/// beyond a fold is not seen even where the polynomial rises again.
#[inline]
fn folded(s: f64, k1: f64, k2: f64, k3: f64) -> bool {
    // It only rises, as of images without distortion.
    if k1 >= 0.0 && k2 >= 0.0 && k3 >= 0.0 {
        return false;
    }
    let slope = |s: f64| 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3));
    if slope(s) <= 0.0 {
        return true;
    }
    // The slope starts at 1; between it can only touch zero at its minimum, a root of 3k1 + 10k2 s + 21k3 s².
    let discriminant = 25.0 * k2 * k2 - 63.0 * k1 * k3;
    if discriminant < 0.0 {
        return false;
    }
    // The root at which the derivative rises, in the form without cancellation.
    let root = discriminant.sqrt();
    let minimum = if k2 >= 0.0 {
        -3.0 * k1 / (5.0 * k2 + root)
    } else {
        (-5.0 * k2 + root) / (21.0 * k3)
    };
    minimum > 0.0 && minimum < s && slope(minimum) <= 0.0
}
