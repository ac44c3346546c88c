use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

/// A camera and what it sees, without noise.
struct Problem {
    truth: Se3,
    rays: [Vector3<f64>; 3],
    points: [Vector3<f64>; 3],
    /// Along the rays.
    distances: Vector3<f64>,
}

impl Problem {
    fn new(truth: Se3, rays: [Vector3<f64>; 3], distances: Vector3<f64>) -> Self {
        let in_camera = [0, 1, 2].map(|i| rays[i] * distances[i]);
        Self {
            truth,
            rays,
            points: in_camera.map(|point| truth.inverse() * point),
            distances,
        }
    }

    /// Of points in the camera's frame.
    fn of_points(truth: Se3, points: [Vector3<f64>; 3]) -> Self {
        let distances = Vector3::from(points.map(|p| p.norm()));
        Self::new(truth, points.map(|p| p.normalize()), distances)
    }

    /// The smallest by the largest singular value of the Jacobian of the three distance equations at the true pose.
    fn condition(&self) -> f64 {
        let [y1, y2, y3] = &self.rays;
        let [l1, l2, l3] = self.distances.into();
        let (b12, b13, b23) = (y1.dot(y2), y1.dot(y3), y2.dot(y3));
        let jacobian = Matrix3::new(
            l1 - b12 * l2,
            l2 - b12 * l1,
            0.0,
            l1 - b13 * l3,
            0.0,
            l3 - b13 * l1,
            0.0,
            l2 - b23 * l3,
            l3 - b23 * l2,
        );
        let values = jacobian.singular_values();
        values.min() / values.max()
    }

    /// Height of the triangle of the points by its longest side.
    fn height(&self) -> f64 {
        let [a, b, c] = &self.points;
        let longest = (a - b).norm().max((a - c).norm()).max((b - c).norm());
        (b - a).cross(&(c - a)).norm() / longest.powi(2)
    }

    /// How far the solution next to the truth is from it: radians, or share of the largest distance, whichever is larger.
    fn error(&self, poses: &[Se3]) -> f64 {
        let size = self.distances.max().max(self.truth.translation.norm());
        let error = |pose: &Se3| {
            let off = pose.inverse() * self.truth;
            // Twice the sine of half the angle: an arc cosine would lose the digits that count.
            let angle = 2.0 * off.rotation.imag().norm();
            angle.max(off.translation.norm() / size)
        };
        poses.iter().map(error).fold(f64::INFINITY, f64::min)
    }
}

fn random_pose(rng: &mut ChaCha8Rng) -> Se3 {
    let delta: [f64; 6] = std::array::from_fn(|i| {
        let limit = if i < 3 { 1.8 } else { 5.0 };
        rng.random_range(-limit..limit)
    });
    Se3::exp(&delta.into())
}

/// Rays over more than a hemisphere: fisheye lenses see that much.
fn random_problem(rng: &mut ChaCha8Rng, depth: f64) -> Problem {
    let truth = random_pose(rng);
    let mut number = |low: f64, high: f64| rng.random_range(low..high);
    let rays: [Vector3<f64>; 3] = std::array::from_fn(|_| {
        Vector3::new(number(-1.0, 1.0), number(-1.0, 1.0), number(-0.2, 1.0)).normalize()
    });
    let distances = Vector3::from_fn(|_, _| number(0.1 * depth, depth));
    Problem::new(truth, rays, distances)
}

/// Rays of a pinhole camera that sees `half_width` to each side of a distance of one.
fn pinhole_problem(rng: &mut ChaCha8Rng, half_width: f64) -> Problem {
    let truth = random_pose(rng);
    let points = std::array::from_fn(|_| {
        let mut across = || rng.random_range(-half_width..half_width);
        let ray = Vector3::new(across(), across(), 1.0);
        ray * rng.random_range(3.0..15.0)
    });
    Problem::of_points(truth, points)
}

/// Over seeds and lenses; the worst counts.
#[test]
fn well_conditioned_poses_are_exact_and_the_others_as_their_condition_says() {
    const TRIALS: usize = 20_000;
    let (mut well, mut worst, mut worst_by_condition, mut worst_ray) =
        (0, 0.0_f64, 0.0_f64, 0.0_f64);
    let mut count = 0;
    for seed in 1..=5 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for trial in 0..TRIALS {
            let problem = match trial % 6 {
                0 => random_problem(&mut rng, 1.0),
                1 => random_problem(&mut rng, 10.0),
                2 => random_problem(&mut rng, 1000.0),
                3 => pinhole_problem(&mut rng, 0.8),
                4 => pinhole_problem(&mut rng, 0.2),
                _ => pinhole_problem(&mut rng, 0.05),
            };
            let poses = solve_p3p(&problem.rays, &problem.points);
            assert!(poses.len() <= 4);
            count += poses.len();
            let (condition, error) = (problem.condition(), problem.error(&poses));
            if problem.height() >= 0.1 {
                worst_by_condition = worst_by_condition.max(error * condition);
                if condition >= 1e-3 {
                    well += 1;
                    worst = worst.max(error);
                }
            }
            for pose in &poses {
                for (ray, point) in problem.rays.iter().zip(&problem.points) {
                    worst_ray = worst_ray.max(((*pose * *point).normalize() - ray).norm());
                }
            }
        }
    }
    assert!(
        well >= 80_000,
        "{well} of {} are well conditioned",
        5 * TRIALS
    );
    assert!(worst < 2e-11, "{worst:e}");
    assert!(worst_by_condition < 2e-13, "{worst_by_condition:e}");
    assert!(worst_ray < 1e-9, "{worst_ray:e}");
    let per_problem = count as f64 / (5 * TRIALS) as f64;
    assert!((1.0..2.5).contains(&per_problem), "{per_problem}");
}

/// On the danger cylinder two solutions are one, and half of the digits are lost.
#[test]
fn on_the_danger_cylinder_half_of_the_digits_remain() {
    const TRIALS: usize = 5_000;
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut errors = Vec::with_capacity(TRIALS);
    while errors.len() < TRIALS {
        let truth = random_pose(&mut rng);
        let angles: [f64; 4] =
            std::array::from_fn(|_| rng.random_range(0.0..std::f64::consts::TAU));
        let on = |angle: f64, z: f64| Vector3::new(angle.cos(), angle.sin(), z);
        let apart = |i: usize, j: usize| (on(angles[i], 0.0) - on(angles[j], 0.0)).norm() > 0.3;
        if !(0..4).all(|i| (0..i).all(|j| apart(i, j))) {
            continue;
        }
        let centre = on(angles[3], rng.random_range(0.5..4.0));
        let turned = random_pose(&mut rng).rotation;
        let seen = [0, 1, 2].map(|i| turned * (on(angles[i], 0.0) - centre));
        let problem = Problem::of_points(truth, seen);
        assert!(problem.condition() < 1e-12);
        errors.push(problem.error(&solve_p3p(&problem.rays, &problem.points)));
    }
    errors.sort_by(f64::total_cmp);
    let missed = errors.iter().filter(|error| !(**error < 1e-4)).count();
    assert!(errors[TRIALS / 2] < 1e-8 && errors[TRIALS * 99 / 100] < 5e-6);
    assert_eq!(missed, 0);
}

/// Three points nearly on one line.
#[test]
fn flat_triangles_lose_digits_in_proportion() {
    const TRIALS: usize = 2_000;
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for (height, remains) in [(1e-1, 1e-12), (1e-2, 1e-10), (1e-3, 1e-8)] {
        let mut errors = Vec::with_capacity(TRIALS);
        for _ in 0..TRIALS {
            let Problem {
                truth,
                rays,
                distances,
                ..
            } = pinhole_problem(&mut rng, 0.8);
            let [a, b, aside] = [0, 1, 2].map(|i| rays[i] * distances[i]);
            let along = b - a;
            let across = (aside - a).cross(&along).cross(&along).normalize();
            let third = (a + b) / 2.0 + across * (height * along.norm());
            let problem = Problem::of_points(truth, [a, b, third]);
            errors.push(problem.error(&solve_p3p(&problem.rays, &problem.points)));
        }
        errors.sort_by(f64::total_cmp);
        assert!(errors[TRIALS * 99 / 100] < remains, "{height}");
    }
}

#[test]
fn degenerate_problems_have_no_solution_or_a_right_one() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let p = random_problem(&mut rng, 5.0);
    let line = [
        p.points[0],
        p.points[1],
        p.points[0] * 0.3 + p.points[1] * 0.7,
    ];
    assert!(solve_p3p(&p.rays, &line).is_empty());
    assert!(solve_p3p(&p.rays, &[p.points[0]; 3]).is_empty());
    for pose in solve_p3p(&[p.rays[0]; 3], &p.points) {
        assert!(pose.translation.iter().all(|v| v.is_finite()));
    }
    // Three points of a cube's corner seen symmetrically: a double root.
    let symmetric = [Vector3::x(), Vector3::y(), Vector3::z()];
    let poses = solve_p3p(&symmetric, &symmetric);
    let identity = |p: &Se3| p.log().norm() < 1e-5;
    assert!(poses.iter().any(identity), "{poses:?}");
    let nan = [Vector3::repeat(f64::NAN); 3];
    assert!(solve_p3p(&nan, &symmetric).is_empty());
    assert!(solve_p3p(&symmetric, &nan).is_empty());
}
