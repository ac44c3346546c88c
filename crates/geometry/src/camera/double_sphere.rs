//! Double sphere: Usenko, Demmel, Cremers, "The double sphere camera model", 3DV 2018.

use nalgebra::{Vector2, Vector3};

use super::{ByDistortion, Distorted, divide};

#[inline]
pub(super) fn distort(p: &Vector3<f64>, &[xi, alpha]: &[f64; 2]) -> Option<Distorted> {
    let d1 = p.norm();
    let w1 = if alpha <= 0.5 {
        alpha / (1.0 - alpha)
    } else {
        (1.0 - alpha) / alpha
    };
    let w2 = (w1 + xi) / (2.0 * w1 * xi + xi * xi + 1.0).sqrt();
    // Outside this cone two points share a pixel, eq. (43)–(45). NaN parameters fail here too.
    if !(p.z > -w2 * d1 && d1 > 1e-9) {
        return None;
    }
    let unit = p / d1;
    let gamma = xi * d1 + p.z;
    let gamma_by_point = Vector3::new(xi * unit.x, xi * unit.y, xi * unit.z + 1.0);
    let d2 = (p.x * p.x + p.y * p.y + gamma * gamma).sqrt();
    let depth = alpha * d2 + (1.0 - alpha) * gamma;
    if !(depth > 1e-12) {
        return None;
    }
    let d2_by_point = (Vector3::new(p.x, p.y, 0.0) + gamma_by_point * gamma) / d2;
    let depth_by_point = d2_by_point * alpha + gamma_by_point * (1.0 - alpha);
    Some(divide(p, depth, &depth_by_point))
}

pub(super) fn by_distortion(p: &Vector3<f64>, &[xi, alpha]: &[f64; 2]) -> ByDistortion {
    let d1 = p.norm();
    let gamma = xi * d1 + p.z;
    let d2 = (p.x * p.x + p.y * p.y + gamma * gamma).sqrt();
    let depth = alpha * d2 + (1.0 - alpha) * gamma;
    let by_xi = alpha * gamma * d1 / d2 + (1.0 - alpha) * d1;
    let by_alpha = d2 - gamma;
    let mut by = ByDistortion::zeros();
    for row in 0..2 {
        let factor = -p[row] / (depth * depth);
        by[(row, 0)] = factor * by_xi;
        by[(row, 1)] = factor * by_alpha;
    }
    by
}

pub(super) fn undistort(m: &Vector2<f64>, &[xi, alpha]: &[f64; 2]) -> Option<Vector3<f64>> {
    let r2 = m.norm_squared();
    let inside = 1.0 - (2.0 * alpha - 1.0) * r2;
    if !(inside >= 0.0) {
        return None;
    }
    let mz = (1.0 - alpha * alpha * r2) / (alpha * inside.sqrt() + 1.0 - alpha);
    let discriminant = mz * mz + (1.0 - xi * xi) * r2;
    if !(discriminant >= 0.0) {
        return None;
    }
    let factor = (mz * xi + discriminant.sqrt()) / (mz * mz + r2);
    let ray = Vector3::new(m.x * factor, m.y * factor, mz * factor - xi);
    ray.try_normalize(1e-12)
}
