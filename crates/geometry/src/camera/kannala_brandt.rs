//! Kannala and Brandt 2006, eq. 6: the radius is an odd polynomial of the angle from the axis.

use nalgebra::{Matrix2x3, Vector2, Vector3};

use super::{ByDistortion, Distorted};

/// Angles from the axis beyond this are behind the lens (200° field of view).
const MAX_THETA: f64 = 100.0 * std::f64::consts::PI / 180.0;

/// What value and derivatives share: the angle from the axis and the direction around it.
struct Polar {
    radius: f64,
    norm_squared: f64,
    theta: f64,
}

#[inline]
fn polar(p: &Vector3<f64>, k: &[f64; 4]) -> Option<Polar> {
    let radius_squared = p.x * p.x + p.y * p.y;
    let radius = radius_squared.sqrt();
    let norm_squared = radius_squared + p.z * p.z;
    if norm_squared < 1e-18 {
        return None;
    }
    let theta = radius.atan2(p.z);
    if theta > MAX_THETA || folded(theta, k) {
        return None;
    }
    Some(Polar {
        radius,
        norm_squared,
        theta,
    })
}

#[inline]
pub(super) fn distort(p: &Vector3<f64>, k: &[f64; 4]) -> Option<Distorted> {
    Some(value(p, &polar(p, k)?, k))
}

#[inline]
pub(super) fn distort_full(p: &Vector3<f64>, k: &[f64; 4]) -> Option<(Distorted, ByDistortion)> {
    let polar = polar(p, k)?;
    let mut by = ByDistortion::zeros();
    if polar.radius > 0.0 {
        let t2 = polar.theta * polar.theta;
        let cubed = polar.theta * t2 / polar.radius;
        let (mut x, mut y) = (cubed * p.x, cubed * p.y);
        for k in 0..4 {
            by[(0, k)] = x;
            by[(1, k)] = y;
            x *= t2;
            y *= t2;
        }
    }
    Some((value(p, &polar, k), by))
}

#[inline]
fn value(p: &Vector3<f64>, polar: &Polar, k: &[f64; 4]) -> Distorted {
    let Polar {
        radius,
        norm_squared,
        theta,
    } = *polar;
    if radius < 1e-9 * p.z.abs() {
        let s = 1.0 / p.z;
        return Distorted {
            value: Vector2::new(p.x * s, p.y * s),
            by_point: Matrix2x3::new(s, 0.0, 0.0, 0.0, s, 0.0),
        };
    }
    let r = theta * polynomial(theta * theta, k);
    let r_by_theta = slope(theta * theta, k);
    let inverse_radius = 1.0 / radius;
    let (ux, uy) = (p.x * inverse_radius, p.y * inverse_radius);
    // dθ/dp = (z u, −ρ)/|p|², du/dp = (I − u uᵀ)/ρ
    let by_theta = r_by_theta / norm_squared;
    let (t, tz) = (by_theta * p.z, -by_theta * radius);
    let s = r * inverse_radius;
    let cross = (t - s) * ux * uy;
    Distorted {
        value: Vector2::new(r * ux, r * uy),
        by_point: Matrix2x3::new(
            t * ux * ux + s * uy * uy,
            cross,
            tz * ux,
            cross,
            t * uy * uy + s * ux * ux,
            tz * uy,
        ),
    }
}

pub(super) fn undistort(d: &Vector2<f64>, k: &[f64; 4]) -> Option<Vector3<f64>> {
    let r = d.norm();
    if r < 1e-12 {
        return Some(Vector3::new(d.x, d.y, 1.0).normalize());
    }
    // r(θ) rises over the valid angles: Newton's steps, kept inside a bracket of the root.
    let (mut low, mut high) = (0.0, MAX_THETA);
    let mut theta = r.min(MAX_THETA);
    for _ in 0..60 {
        let rest = theta * polynomial(theta * theta, k) - r;
        if folded(theta, k) || rest > 0.0 {
            high = theta;
        } else {
            low = theta;
        }
        let newton = theta - rest / slope(theta * theta, k);
        let next = if newton > low && newton < high {
            newton
        } else {
            0.5 * (low + high)
        };
        let step = next - theta;
        theta = next;
        if step.abs() < 1e-15 {
            break;
        }
    }
    let value = theta * polynomial(theta * theta, k);
    if (value - r).abs() > 1e-9 || folded(theta, k) {
        return None;
    }
    let s = theta.sin() / r;
    Some(Vector3::new(d.x * s, d.y * s, theta.cos()))
}

/// `r(θ) / θ` at `θ²`.
#[inline]
fn polynomial(t2: f64, k: &[f64; 4]) -> f64 {
    1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))
}

/// `dr/dθ` at `θ²`.
#[inline]
fn slope(t2: f64, k: &[f64; 4]) -> f64 {
    1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])))
}

/// Whether `r(θ)` has stopped rising at or before `theta`. Between, the slope is looked at in three places: a quartic in
/// `θ²` that dips below zero and comes back within a quarter of the way is not a lens.
#[inline]
fn folded(theta: f64, k: &[f64; 4]) -> bool {
    let t2 = theta * theta;
    slope(t2, k)
        .min(slope(0.75 * t2, k))
        .min(slope(0.5 * t2, k))
        .min(slope(0.25 * t2, k))
        <= 0.0
}
