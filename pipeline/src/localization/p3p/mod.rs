//! Pose of a camera from three points and their viewing rays.
//!
//! The method is Persson and Nordberg's "Lambda Twist" (ECCV 2018): the three distances $\lambda$ along the unit rays
//! $y_i$ satisfy, with $b_{ij} = y_i \cdot y_j$ and $a_{ij} = |x_i - x_j|^2$,
//! $$\lambda_i^2 + \lambda_j^2 - 2 b_{ij} \lambda_i \lambda_j = a_{ij}.$$
//! Two combinations of them are homogeneous; a root of a cubic makes a combination of these two a pair of planes, in
//! each of which a quadratic remains.
//!
//! How exact a pose is depends on the condition of those equations there: its error is that of rounding divided by the ratio of the smallest
//! to the largest singular value of their Jacobian. Without noise, and with a triangle at least a tenth as high as long, poses whose ratio is
//! 10⁻³ or more are all found to 10⁻¹⁰ of the distance and in radians. The ratio falls to zero where the camera is on the danger cylinder, that
//! through the three points and at right angles to their plane: there two solutions meet, half of the digits are lost, and rarely the pose is
//! not found. Points nearly on one line, or seen in nearly one direction, lose digits as well: with a height of 10⁻³ of the length 10⁻⁸
//! remain, and from 10⁻⁵ on the pose may not be found.

use lsfb_geometry::{Matrix3, Se3, UnitQuaternion, Vector3};
use nalgebra::{Rotation3, SymmetricEigen};

#[cfg(test)]
mod tests;

/// Poses `camera_from_world` that see the points along the rays: at most four, best-conditioned plane first. None for
/// points on one line, coinciding rays, or rays no triangle fits.
pub fn solve_p3p(rays: &[Vector3<f64>; 3], points_in_world: &[Vector3<f64>; 3]) -> Vec<Se3> {
    let [x1, x2, x3] = points_in_world;
    let squared = [x1 - x2, x1 - x3, x2 - x3].map(|d| d.norm_squared());
    let scale = squared[0].max(squared[1]).max(squared[2]);
    let area = (x2 - x1).cross(&(x3 - x1)).norm_squared();
    if !(scale > 0.0) || !(area > 1e-14 * scale * scale) {
        return Vec::new();
    }
    // Distances in units of the triangle's size, so that thresholds mean the same for every problem.
    let a = squared.map(|s| s / scale);
    let b = [
        rays[0].dot(&rays[1]),
        rays[0].dot(&rays[2]),
        rays[1].dot(&rays[2]),
    ];
    if b.iter().any(|cosine| !cosine.is_finite()) {
        return Vec::new();
    }
    let chords = [rays[0] - rays[1], rays[0] - rays[2], rays[1] - rays[2]];
    let chords = chords.map(|chord| chord.norm_squared());
    let mut poses = Vec::with_capacity(4);
    for lambda in distances(&a, &b, &chords) {
        if let Some(pose) = pose_from_distances(rays, points_in_world, &(lambda * scale.sqrt())) {
            poses.push(pose);
        }
    }
    poses
}

/// The quadratic form of one distance equation: `λᵀ M λ = a`. Order of pairs: 12, 13, 23.
fn form(pair: usize, b: f64) -> Matrix3<f64> {
    match pair {
        0 => Matrix3::new(1.0, -b, 0.0, -b, 1.0, 0.0, 0.0, 0.0, 0.0),
        1 => Matrix3::new(1.0, 0.0, -b, 0.0, 0.0, 0.0, -b, 0.0, 1.0),
        _ => Matrix3::new(0.0, 0.0, 0.0, 0.0, 1.0, -b, 0.0, -b, 1.0),
    }
}

/// All positive solutions of the three distance equations; of the rays the cosines and the squared distances from each other.
fn distances(a: &[f64; 3], b: &[f64; 3], chords: &[f64; 3]) -> Vec<Vector3<f64>> {
    let forms = [form(0, b[0]), form(1, b[1]), form(2, b[2])];
    // Eliminate the largest side: the smallest could cancel.
    let pivot = (0..3).max_by(|&i, &j| a[i].total_cmp(&a[j])).unwrap_or(0);
    let [p, q] = match pivot {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    };
    let d1 = forms[p] * a[pivot] - forms[pivot] * a[p];
    let d2 = forms[q] * a[pivot] - forms[pivot] * a[q];
    let mut found: Vec<Vector3<f64>> = Vec::with_capacity(4);
    for pencil in degenerate_members(&d1, &d2) {
        let Some(planes) = split_into_planes(&pencil.member) else {
            continue;
        };
        for normal in planes {
            for lambda in on_plane(&normal, &pencil.other, &forms[pivot], a[pivot]) {
                let lambda = polish(lambda, chords, a);
                let known = |l: &Vector3<f64>| (l - lambda).norm() < 1e-9 * lambda.norm();
                if lambda.min() > 0.0 && !found.iter().any(known) {
                    found.push(lambda);
                }
            }
        }
        // All common solutions lie in the planes of one real pair.
        break;
    }
    found
}

/// A degenerate combination of two forms, and the one of the two that it is least like.
struct Pencil {
    member: Matrix3<f64>,
    other: Matrix3<f64>,
}

/// Combinations of `d1` and `d2` whose determinant vanishes, real plane pairs with the best separation first.
fn degenerate_members(d1: &Matrix3<f64>, d2: &Matrix3<f64>) -> Vec<Pencil> {
    // A basis whose second form is as far from degenerate as can be, so that the cubic keeps its degree.
    let (d1, d2) = (d1 / d1.norm(), d2 / d2.norm());
    let turned = |k: usize| {
        let (sin, cos) = (k as f64 * std::f64::consts::FRAC_PI_8).sin_cos();
        (d1 * cos + d2 * sin, d2 * cos - d1 * sin)
    };
    let size = |k: usize| {
        let second = turned(k).1;
        second.determinant().abs() / second.norm().powi(3)
    };
    let best = (0..8)
        .max_by(|&i, &j| size(i).total_cmp(&size(j)))
        .unwrap_or(0);
    let (e1, e2) = turned(best);
    let column = |m: &Matrix3<f64>, i: usize| -> Vector3<f64> { m.column(i).into() };
    let triple = |x: &Matrix3<f64>, y: &Matrix3<f64>, z: &Matrix3<f64>| {
        column(x, 0).dot(&column(y, 1).cross(&column(z, 2)))
    };
    // det(e1 + γ e2)
    let c0 = e1.determinant();
    let c1 = triple(&e2, &e1, &e1) + triple(&e1, &e2, &e1) + triple(&e1, &e1, &e2);
    let c2 = triple(&e1, &e2, &e2) + triple(&e2, &e1, &e2) + triple(&e2, &e2, &e1);
    let c3 = e2.determinant();
    let mut members: Vec<(f64, Pencil)> = cubic_roots(c3, c2, c1, c0)
        .into_iter()
        .filter(|root| root.is_finite())
        .map(|root| {
            let member = e1 + e2 * root;
            // In a plane of the member, all forms vanish together: take the one that has least of the member.
            let other = if root.abs() > 1.0 { e1 } else { e2 };
            let eigenvalues = member.symmetric_eigenvalues();
            let separation = -eigenvalues.max() * eigenvalues.min() / member.norm_squared();
            (separation, Pencil { member, other })
        })
        .collect();
    members.sort_by(|a, b| b.0.total_cmp(&a.0));
    members.into_iter().map(|(_, pencil)| pencil).collect()
}

/// Real roots of `c3 x³ + c2 x² + c1 x + c0`, polished; three where there are three.
fn cubic_roots(c3: f64, c2: f64, c1: f64, c0: f64) -> Vec<f64> {
    if c3 == 0.0 {
        return Vec::new();
    }
    let (a, b, c) = (c2 / c3, c1 / c3, c0 / c3);
    let (q, r) = (
        (a * a - 3.0 * b) / 9.0,
        (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0,
    );
    let polished = |start: f64| {
        let mut x = start;
        for _ in 0..4 {
            let value = ((x + a) * x + b) * x + c;
            let slope = (3.0 * x + 2.0 * a) * x + b;
            if slope.abs() < 1e-300 {
                break;
            }
            let next = x - value / slope;
            let next_value = ((next + a) * next + b) * next + c;
            if !(next_value.abs() < value.abs()) {
                break;
            }
            x = next;
        }
        x
    };
    if r * r < q * q * q {
        let theta = (r / (q * q * q).sqrt()).clamp(-1.0, 1.0).acos();
        [0.0, 1.0, -1.0]
            .map(|k| {
                let angle = (theta + k * std::f64::consts::TAU) / 3.0;
                polished(-2.0 * q.sqrt() * angle.cos() - a / 3.0)
            })
            .to_vec()
    } else {
        let size = (r.abs() + (r * r - q * q * q).max(0.0).sqrt()).cbrt();
        let s = -r.signum() * size;
        let t = if s == 0.0 { 0.0 } else { q / s };
        let simple = polished(s + t - a / 3.0);
        // A double root touches the axis and may show as none: offer its place as well.
        let double = -0.5 * (s + t) - a / 3.0;
        let imaginary = (s - t).abs();
        if imaginary < 1e-6 * (s.abs() + t.abs()) {
            vec![simple, double]
        } else {
            vec![simple]
        }
    }
}

/// Normals of the two planes of which a degenerate form consists; `None` where they are not real.
fn split_into_planes(member: &Matrix3<f64>) -> Option<[Vector3<f64>; 2]> {
    let eigen = SymmetricEigen::new(*member);
    let values = eigen.eigenvalues;
    let (high, low) = (values.imax(), values.imin());
    if !(values[high] > 0.0 && values[low] < 0.0) {
        return None;
    }
    let e_high = eigen.eigenvectors.column(high) * values[high].sqrt();
    let e_low = eigen.eigenvectors.column(low) * (-values[low]).sqrt();
    Some([e_high - e_low, e_high + e_low])
}

/// Vectors of the plane where `other` vanishes, scaled so that `pivot` takes the value `a`, all components positive.
fn on_plane(
    normal: &Vector3<f64>,
    other: &Matrix3<f64>,
    pivot: &Matrix3<f64>,
    a: f64,
) -> Vec<Vector3<f64>> {
    let axis = normal.iamin();
    let mut unit = Vector3::zeros();
    unit[axis] = 1.0;
    let u = normal.cross(&unit).normalize();
    let v = normal.cross(&u).normalize();
    // (c u + s v)ᵀ other (c u + s v) = 0
    let (uu, uv, vv) = (
        u.dot(&(other * u)),
        u.dot(&(other * v)),
        v.dot(&(other * v)),
    );
    let discriminant = uv * uv - uu * vv;
    let size = uu.abs().max(uv.abs()).max(vv.abs());
    // A tangent is a solution too: rounding must not make it disappear.
    if !(discriminant > -1e-10 * size * size) {
        return Vec::new();
    }
    let root = discriminant.max(0.0).sqrt();
    let k = -(uv + uv.signum() * root);
    let directions = if k == 0.0 {
        [v * uu, u * vv]
    } else {
        // Roots of uu c² + 2 uv c s + vv s², each from the form that does not cancel.
        [u * k + v * uu, u * vv + v * k]
    };
    let mut solutions = Vec::with_capacity(2);
    for direction in directions {
        let sign = if direction.sum() < 0.0 { -1.0 } else { 1.0 };
        let value = direction.dot(&(pivot * direction));
        if value > 0.0 {
            solutions.push(direction * (sign * (a / value).sqrt()));
        }
    }
    solutions
}

/// Newton steps on the three distance equations, written with the rays' distances from each other in place of their cosines,
/// $(\lambda_i - \lambda_j)^2 + |y_i - y_j|^2 \lambda_i \lambda_j = a_{ij}$: of rays close together cosines keep few digits.
fn polish(start: Vector3<f64>, chords: &[f64; 3], a: &[f64; 3]) -> Vector3<f64> {
    let residual = |l: &Vector3<f64>| {
        let of = |i: usize, j: usize, chord: f64| (l[i] - l[j]).powi(2) + chord * l[i] * l[j];
        Vector3::new(
            of(0, 1, chords[0]) - a[0],
            of(0, 2, chords[1]) - a[1],
            of(1, 2, chords[2]) - a[2],
        )
    };
    let mut lambda = start;
    let mut error = residual(&lambda);
    for _ in 0..5 {
        let l = &lambda;
        // Derivatives by the first and the second distance of a pair.
        let of = |i: usize, j: usize, chord: f64| {
            let apart = 2.0 * (l[i] - l[j]);
            [apart + chord * l[j], chord * l[i] - apart]
        };
        let [p, q] = of(0, 1, chords[0]);
        let [r, s] = of(0, 2, chords[1]);
        let [t, u] = of(1, 2, chords[2]);
        let determinant = -(p * s * t + q * r * u);
        if determinant == 0.0 {
            break;
        }
        // Cramer's rule: a third of the entries are zero.
        let [e1, e2, e3] = error.into();
        let step = Vector3::new(
            q * s * e3 - s * t * e1 - q * u * e2,
            p * u * e2 - p * s * e3 - r * u * e1,
            r * t * e1 - p * t * e2 - q * r * e3,
        ) / determinant;
        let next = lambda - step;
        let next_error = residual(&next);
        if !(next_error.norm_squared() < error.norm_squared()) {
            break;
        }
        (lambda, error) = (next, next_error);
    }
    lambda
}

fn pose_from_distances(
    rays: &[Vector3<f64>; 3],
    points: &[Vector3<f64>; 3],
    lambda: &Vector3<f64>,
) -> Option<Se3> {
    let seen = [
        rays[0] * lambda[0],
        rays[1] * lambda[1],
        rays[2] * lambda[2],
    ];
    pose_of_triangle(&seen, points, lambda.norm())
}

/// The pose that moves a triangle onto another of the same shape; `None` where theirs differ, at such distances, or either is none.
pub(super) fn pose_of_triangle(
    seen: &[Vector3<f64>; 3],
    points: &[Vector3<f64>; 3],
    distance: f64,
) -> Option<Se3> {
    let rotation = triangle_frame(seen)? * triangle_frame(points)?.transpose();
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let centre = |p: &[Vector3<f64>; 3]| (p[0] + p[1] + p[2]) / 3.0;
    let translation = centre(seen) - rotation * centre(points);
    let shape_error: f64 = (0..3)
        .map(|i| (rotation * points[i] + translation - seen[i]).norm())
        .sum();
    (shape_error < 1e-4 * distance).then(|| Se3::new(rotation, translation))
}

/// An orthonormal frame fixed to a triangle.
fn triangle_frame(p: &[Vector3<f64>; 3]) -> Option<Matrix3<f64>> {
    let x = (p[1] - p[0]).try_normalize(1e-300)?;
    let z = x.cross(&(p[2] - p[0])).try_normalize(1e-300)?;
    Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
}
