//! Extended unified model: Khomutenko, Garcia, Martinet, "An enhanced unified camera model", RA-L 2016.
//!
//! `beta = 1` is the unified model of Mei with `xi = alpha / (1 − alpha)`.

use nalgebra::{Vector2, Vector3};

use super::{ByDistortion, Distorted, divide};

#[inline]
pub(super) fn distort(p: &Vector3<f64>, &[alpha, beta]: &[f64; 2]) -> Option<Distorted> {
    let rho = (beta * (p.x * p.x + p.y * p.y) + p.z * p.z).sqrt();
    let w = if alpha <= 0.5 {
        alpha / (1.0 - alpha)
    } else {
        (1.0 - alpha) / alpha
    };
    // NaN parameters fail here too.
    if !(p.z > -w * rho && rho > 1e-9) {
        return None;
    }
    let depth = alpha * rho + (1.0 - alpha) * p.z;
    if !(depth > 1e-12) {
        return None;
    }
    let scale = alpha / rho;
    let depth_by_point = Vector3::new(
        scale * beta * p.x,
        scale * beta * p.y,
        scale * p.z + 1.0 - alpha,
    );
    Some(divide(p, depth, &depth_by_point))
}

pub(super) fn by_distortion(p: &Vector3<f64>, &[alpha, beta]: &[f64; 2]) -> ByDistortion {
    let r2 = p.x * p.x + p.y * p.y;
    let rho = (beta * r2 + p.z * p.z).sqrt();
    let depth = alpha * rho + (1.0 - alpha) * p.z;
    let by_alpha = rho - p.z;
    let by_beta = alpha * r2 / (2.0 * rho);
    let mut by = ByDistortion::zeros();
    for row in 0..2 {
        let factor = -p[row] / (depth * depth);
        by[(row, 0)] = factor * by_alpha;
        by[(row, 1)] = factor * by_beta;
    }
    by
}

pub(super) fn undistort(m: &Vector2<f64>, &[alpha, beta]: &[f64; 2]) -> Option<Vector3<f64>> {
    let r2 = m.norm_squared();
    let inside = 1.0 - (2.0 * alpha - 1.0) * beta * r2;
    if !(inside >= 0.0) {
        return None;
    }
    let mz = (1.0 - beta * alpha * alpha * r2) / (alpha * inside.sqrt() + 1.0 - alpha);
    Vector3::new(m.x, m.y, mz).try_normalize(1e-12)
}
