//! Pose of a rig from three points and their viewing rays, whichever of its cameras these belong to.
//!
//! The places of the points on their rays, $o_i + \lambda_i r_i$, are as far from each other as the points are:
//! $$|o_i + \lambda_i r_i - o_j - \lambda_j r_j|^2 = |x_i - x_j|^2.$$
//! For a given $\lambda_1$ two of these equations are quadratic in $\lambda_2$ and in $\lambda_3$ alone; the third, from which those two
//! take the squares, is linear in either. What is left once $\lambda_3$ and $\lambda_2$ are eliminated is the polynomial of degree eight in
//! $\lambda_1$ of Nistér and Stewénius ("A minimal solution to the generalised 3-point pose problem", JMIV 2007).

use std::ops::{Add, Mul, Sub};

use lsfb_geometry::{Matrix3, Se3, Vector3};
use nalgebra::{SMatrix, Schur};

use super::p3p::pose_of_triangle;
use super::upright::SeenPoint;

/// Poses `rig_from_world` that see the points along their rays: at most eight. None for points on one line, and for rays all parallel. Made for
/// rays from different places; of rays from one place [`solve_p3p`](super::solve_p3p) is faster and more exact.
pub(super) fn solve_generalized_p3p(seen: [&SeenPoint; 3]) -> Vec<Se3> {
    let points = seen.map(|s| s.point_in_world);
    let scale = PAIRS
        .map(|[i, j]| (points[i] - points[j]).norm())
        .into_iter()
        .fold(0.0, f64::max);
    if !(scale > 0.0) {
        return Vec::new();
    }
    // In units of the triangle's size, so that thresholds mean the same for every problem.
    let pairs = PAIRS.map(|[i, j]| Pair {
        cosine: seen[i].ray_in_rig.dot(&seen[j].ray_in_rig),
        offset_on_rays: {
            let offset = (seen[i].origin_in_rig - seen[j].origin_in_rig) / scale;
            [i, j].map(|k| offset.dot(&seen[k].ray_in_rig))
        },
        rest: {
            let offset = (seen[i].origin_in_rig - seen[j].origin_in_rig) / scale;
            let side = (points[i] - points[j]) / scale;
            offset.norm_squared() - side.norm_squared()
        },
    });
    let mut found: Vec<Vector3<f64>> = Vec::with_capacity(8);
    for first in real_roots(&first_distance(&pairs)) {
        for start in starts(&pairs, first) {
            let Some(lambda) = polish(&pairs, start) else {
                continue;
            };
            let is_known = |l: &Vector3<f64>| (l - lambda).norm() < 1e-7 * lambda.norm();
            if lambda.min() > 0.0 && !found.iter().any(is_known) {
                found.push(lambda);
            }
        }
    }
    let pose = |lambda: Vector3<f64>| {
        let on_rays =
            [0, 1, 2].map(|i| seen[i].origin_in_rig + seen[i].ray_in_rig * (lambda[i] * scale));
        pose_of_triangle(&on_rays, &points, scale * lambda.norm())
    };
    found.into_iter().filter_map(pose).collect()
}

/// Which points the equations are of.
const PAIRS: [[usize; 2]; 3] = [[0, 1], [0, 2], [1, 2]];

/// The equation of a pair of rays,
/// $\lambda_i^2 + \lambda_j^2 - 2 c \lambda_i \lambda_j + 2 a_i \lambda_i - 2 a_j \lambda_j + e = 0$.
struct Pair {
    cosine: f64,
    /// What lies between the rays' origins, along either ray.
    offset_on_rays: [f64; 2],
    rest: f64,
}

impl Pair {
    fn residual(&self, [x, y]: [f64; 2]) -> f64 {
        let [a, b] = self.offset_on_rays;
        x * x + y * y - 2.0 * self.cosine * x * y + 2.0 * (a * x - b * y) + self.rest
    }

    /// Derivatives of the residual by both distances.
    fn derivatives(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [a, b] = self.offset_on_rays;
        [
            2.0 * (x - self.cosine * y + a),
            2.0 * (y - self.cosine * x - b),
        ]
    }

    /// As $\lambda_j^2 + 2 p \lambda_j + q$, polynomials in $\lambda_i$.
    fn in_second(&self) -> [Polynomial; 2] {
        let [a, b] = self.offset_on_rays;
        [
            Polynomial::new([-b, -self.cosine, 0.0]),
            Polynomial::new([self.rest, 2.0 * a, 1.0]),
        ]
    }
}

/// The polynomial whose roots are the distances along the first ray.
fn first_distance(pairs: &[Pair; 3]) -> Polynomial {
    let [p2, q2] = pairs[0].in_second();
    let [p3, q3] = pairs[1].in_second();
    let constant = |value: f64| Polynomial::new([value, 0.0, 0.0]);
    let two = constant(2.0);
    // The third equation: a λ2 λ3 + b λ2 + c λ3 + e = 0.
    let [along_second, along_third] = pairs[2].offset_on_rays;
    let a = constant(-2.0 * pairs[2].cosine);
    let b = constant(2.0 * along_second) - two * p2;
    let c = constant(-2.0 * along_third) - two * p3;
    let e = constant(pairs[2].rest) - q2 - q3;
    // With λ3 = -(b λ2 + e) / (a λ2 + c) its own equation is quadratic in λ2, …
    let square = b * b - two * p3 * a * b + q3 * a * a;
    let linear = two * b * e - two * p3 * (b * c + a * e) + two * q3 * a * c;
    let rest = e * e - two * p3 * e * c + q3 * c * c;
    // … and linear once the square is taken from that of λ2: t λ2 + s = 0.
    let t = linear - two * p2 * square;
    let s = rest - q2 * square;
    s * s - two * p2 * s * t + q2 * t * t
}

/// What the distances along the other two rays may be where that along the first is known.
fn starts(pairs: &[Pair; 3], first: f64) -> impl Iterator<Item = Vector3<f64>> {
    let of_pair = |pair: &Pair| {
        let [p, q] = pair.in_second().map(|polynomial| polynomial.at(first));
        let root = (p * p - q).max(0.0).sqrt();
        [root - p, -root - p]
    };
    let [second, third] = [of_pair(&pairs[0]), of_pair(&pairs[1])];
    let both = second
        .into_iter()
        .flat_map(move |second| third.map(|third| [second, third]));
    both.map(move |[second, third]| Vector3::new(first, second, third))
}

/// Newton's steps, so many at most.
const STEPS: usize = 20;
/// Solutions leave no more than this of their equations, whose terms are about one and more.
const SOLVED: f64 = 1e-11;

/// The solution of the equations near `start`; `None` where there is none.
fn polish(pairs: &[Pair; 3], start: Vector3<f64>) -> Option<Vector3<f64>> {
    let residual = |l: &Vector3<f64>| {
        let of = |k: usize| pairs[k].residual(PAIRS[k].map(|i| l[i]));
        Vector3::new(of(0), of(1), of(2))
    };
    let (mut lambda, mut error) = (start, residual(&start));
    for _ in 0..STEPS {
        let mut derivatives = Matrix3::zeros();
        for (row, (pair, of)) in pairs.iter().zip(PAIRS).enumerate() {
            let slopes = pair.derivatives(of.map(|i| lambda[i]));
            for (column, slope) in of.into_iter().zip(slopes) {
                derivatives[(row, column)] = slope;
            }
        }
        let next = lambda - derivatives.try_inverse()? * error;
        let next_error = residual(&next);
        if !(next_error.norm() < error.norm()) {
            break;
        }
        (lambda, error) = (next, next_error);
    }
    (error.norm() < SOLVED * lambda.norm_squared().max(1.0)).then_some(lambda)
}

const DEGREE: usize = 8;

/// Coefficients, that of the lowest power first. Products of a higher degree are never made.
#[derive(Clone, Copy)]
struct Polynomial([f64; DEGREE + 1]);

impl Polynomial {
    fn new(coefficients: [f64; 3]) -> Self {
        let mut all = [0.0; DEGREE + 1];
        all[..3].copy_from_slice(&coefficients);
        Self(all)
    }

    fn at(&self, x: f64) -> f64 {
        self.0.iter().rev().fold(0.0, |sum, c| sum * x + c)
    }
}

impl Add for Polynomial {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] + other.0[k]))
    }
}

impl Sub for Polynomial {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] - other.0[k]))
    }
}

impl Mul for Polynomial {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let product = |k: usize| (0..=k).map(|i| self.0[i] * other.0[k - i]).sum();
        Self(std::array::from_fn(product))
    }
}

/// Roots with imaginary parts up to this share of their size may be double ones that rounding has moved off the axis.
const REAL: f64 = 1e-3;

/// Real parts of the roots that are real or nearly so; none of a polynomial of a lower degree.
fn real_roots(polynomial: &Polynomial) -> Vec<f64> {
    let c = &polynomial.0;
    // In units of the roots' geometric mean, so that the matrix below is balanced.
    let unit = (c[0] / c[DEGREE]).abs().powf(1.0 / DEGREE as f64);
    let unit = if unit > 0.0 { unit } else { 1.0 };
    let scaled: [f64; DEGREE] =
        std::array::from_fn(|k| c[k] / c[DEGREE] * unit.powi(k as i32 - DEGREE as i32));
    if !scaled.iter().all(|value| value.is_finite()) {
        return Vec::new();
    }
    let mut companion = SMatrix::<f64, DEGREE, DEGREE>::zeros();
    for (k, value) in scaled.iter().enumerate() {
        companion[(k, DEGREE - 1)] = -value;
        if k > 0 {
            companion[(k, k - 1)] = 1.0;
        }
    }
    let Some(schur) = Schur::try_new(companion, f64::EPSILON, MAX_ITERATIONS) else {
        return Vec::new();
    };
    let roots = schur.complex_eigenvalues();
    let real = roots
        .iter()
        .filter(|root| root.im.abs() <= REAL * root.norm());
    real.map(|root| root.re * unit).collect()
}

/// The decomposition takes some dozens.
const MAX_ITERATIONS: usize = 1000;

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Three points seen by cameras at these places, and the pose.
    fn problem(origins_in_rig: [Vector3<f64>; 3], rng: &mut ChaCha8Rng) -> ([SeenPoint; 3], Se3) {
        let mut vector = |size: f64| Vector3::from_fn(|_, _| rng.random_range(-size..size));
        let (rotation, translation) = (vector(3.0), vector(20.0));
        let world_from_rig = Se3::exp(&Vector6::from_iterator(
            rotation.iter().chain(translation.iter()).copied(),
        ));
        let seen = origins_in_rig.map(|origin_in_rig| {
            let point_in_rig = vector(6.0);
            SeenPoint {
                origin_in_rig,
                ray_in_rig: (point_in_rig - origin_in_rig).normalize(),
                point_in_world: world_from_rig * point_in_rig,
            }
        });
        (seen, world_from_rig.inverse())
    }

    #[test]
    fn the_true_pose_is_among_those_found_and_all_see_the_points() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let far = [
            Vector3::new(0.3, 0.1, 0.0),
            Vector3::new(-0.3, 0.0, 0.2),
            Vector3::new(0.0, -0.4, 0.1),
        ];
        // Two points of one camera and one of another; and cameras a centimetre apart.
        let two = [far[0], far[0], far[1]];
        let near = far.map(|origin| origin * 0.03);
        for origins in [far, two, near] {
            let (mut lost, mut worst) = (0, 0.0f64);
            for _ in 0..200 {
                let (seen, truth) = problem(origins, &mut rng);
                let found = solve_generalized_p3p([&seen[0], &seen[1], &seen[2]]);
                assert!(found.len() <= 8);
                for pose in &found {
                    for s in &seen {
                        let sight = *pose * s.point_in_world - s.origin_in_rig;
                        let off = sight.cross(&s.ray_in_rig).norm() / sight.norm();
                        assert!(off < 1e-7 && sight.dot(&s.ray_in_rig) > 0.0, "{off}");
                    }
                }
                let off = |pose: &Se3| {
                    let off = *pose * truth.inverse();
                    off.translation.norm().max(off.rotation.angle())
                };
                let best = found.iter().map(off).fold(f64::INFINITY, f64::min);
                match best < 1e-6 {
                    true => worst = worst.max(best),
                    false => lost += 1,
                }
            }
            // Where two solutions meet half of the digits are lost.
            assert!(lost <= 2, "{lost} of 200 lost; {worst}");
        }
    }

    #[test]
    fn points_on_one_line_and_parallel_rays_give_nothing() {
        let seen = |k: f64, ray: Vector3<f64>| SeenPoint {
            origin_in_rig: Vector3::new(k, 0.0, 0.0),
            ray_in_rig: ray.normalize(),
            point_in_world: Vector3::new(k, 2.0 * k, 1.0),
        };
        let rays = [0.0, 0.1, -0.2].map(|x| Vector3::new(x, x * x, 1.0));
        let line = [seen(0.0, rays[0]), seen(1.0, rays[1]), seen(2.0, rays[2])];
        let found = solve_generalized_p3p([&line[0], &line[1], &line[2]]);
        assert!(found.iter().all(|pose| pose.translation.norm().is_finite()));
        let parallel = [0.0, 1.0, 3.0].map(|k| SeenPoint {
            point_in_world: Vector3::new(k, k * k, 1.0),
            ..seen(k, Vector3::z())
        });
        let [a, b, c] = &parallel;
        assert!(solve_generalized_p3p([a, b, c]).is_empty());
        assert!(solve_generalized_p3p([a, a, a]).is_empty());
    }
}
