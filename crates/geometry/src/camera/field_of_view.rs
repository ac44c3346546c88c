//! Field-of-view model: Devernay and Faugeras, "Straight lines have to be straight", 2001.

use nalgebra::{Matrix2x3, Vector2, Vector3};

use super::{ByDistortion, Distorted};

/// Below this the closed derivative by `omega` cancels, and its series is exact enough.
const SMALL_OMEGA: f64 = 1e-3;

#[inline]
pub(super) fn distort(p: &Vector3<f64>, &[omega]: &[f64; 1]) -> Option<Distorted> {
    let radius = (p.x * p.x + p.y * p.y).sqrt();
    if !(p.z > 0.0 || radius > 1e-9 * p.z.abs()) || radius + p.z.abs() < 1e-9 {
        return None;
    }
    let slope = steepness(omega);
    if radius <= 1e-9 * p.z {
        let s = slope / p.z;
        return Some(Distorted {
            value: Vector2::new(p.x * s, p.y * s),
            by_point: Matrix2x3::new(s, 0.0, 0.0, 0.0, s, 0.0),
        });
    }
    // atan(t ω)/ω with t = slope · radius / z, over the whole circle
    let a = slope * omega;
    let (r, by_radius, by_z) = if omega.abs() < 1e-8 {
        if p.z <= 0.0 {
            return None;
        }
        (radius / p.z, 1.0 / p.z, -radius / (p.z * p.z))
    } else {
        let norm_squared = a * a * radius * radius + p.z * p.z;
        (
            (a * radius).atan2(p.z) / omega,
            slope * p.z / norm_squared,
            -slope * radius / norm_squared,
        )
    };
    if !r.is_finite() {
        return None;
    }
    let (ux, uy) = (p.x / radius, p.y / radius);
    let s = r / radius;
    let cross = (by_radius - s) * ux * uy;
    Some(Distorted {
        value: Vector2::new(r * ux, r * uy),
        by_point: Matrix2x3::new(
            by_radius * ux * ux + s * uy * uy,
            cross,
            by_z * ux,
            cross,
            by_radius * uy * uy + s * ux * ux,
            by_z * uy,
        ),
    })
}

pub(super) fn by_distortion(p: &Vector3<f64>, &[omega]: &[f64; 1]) -> ByDistortion {
    let radius = (p.x * p.x + p.y * p.y).sqrt();
    let mut by = ByDistortion::zeros();
    if radius == 0.0 {
        return by;
    }
    let by_omega = if omega.abs() < SMALL_OMEGA {
        let u = radius / p.z;
        omega * u * (1.0 / 6.0 - u * u * 2.0 / 3.0)
    } else {
        let half_tan = (0.5 * omega).tan();
        let a = 2.0 * half_tan;
        let a_by_omega = 1.0 + half_tan * half_tan;
        let angle = (a * radius).atan2(p.z);
        let angle_by_a = radius * p.z / (a * a * radius * radius + p.z * p.z);
        (angle_by_a * a_by_omega - angle / omega) / omega
    };
    by[(0, 0)] = by_omega * p.x / radius;
    by[(1, 0)] = by_omega * p.y / radius;
    by
}

pub(super) fn undistort(d: &Vector2<f64>, &[omega]: &[f64; 1]) -> Option<Vector3<f64>> {
    let r = d.norm();
    let angle = r * omega.abs();
    if !(angle < std::f64::consts::PI) {
        return None;
    }
    if angle < 1e-9 {
        let s = 1.0 / steepness(omega);
        return Vector3::new(d.x * s, d.y * s, 1.0).try_normalize(1e-12);
    }
    let s = angle.sin() / (r * omega.abs() * steepness(omega));
    Vector3::new(d.x * s, d.y * s, angle.cos()).try_normalize(1e-12)
}

/// `2 tan(ω/2) / ω`: the slope of the radius at the axis.
#[inline]
fn steepness(omega: f64) -> f64 {
    if omega.abs() < 1e-8 {
        1.0
    } else {
        2.0 * (0.5 * omega).tan() / omega
    }
}
