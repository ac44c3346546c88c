//! Robust motion between two images: five-point hypotheses with local optimisation (Chum, Matas, Kittler, "Locally optimized RANSAC",
//! DAGM 2003), scored by truncated squares (Torr and Zisserman, "MLESAC", CVIU 2000).

use lsfb_geometry::{Matrix3, Se3, UnitQuaternion, Vector3};
use lsfb_solver::gauss_newton::{NormalEquations, minimise_damped};
use lsfb_types::Bounds;
use nalgebra::{Rotation3, UnitVector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::epipolar_error::{Linearised, Motion, RayPair, essential_of};
use super::five_point::essential_matrices;
use crate::sampling::samples_needed;

/// Configuration of [`estimate_relative_pose`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RelativePoseConfig {
    /// Largest error of an inlier, pixels.
    pub max_error_px: f64,
    /// Most samples drawn.
    pub max_samples: usize,
    /// Fewest samples drawn, however good the best one looks.
    pub min_samples: usize,
    /// Probability with which a sample of inliers only must have been drawn before stopping.
    pub confidence: f64,
    /// Seed of the samples.
    pub seed: u64,
}

impl Default for RelativePoseConfig {
    fn default() -> Self {
        Self {
            max_error_px: 1.5,
            max_samples: 5000,
            min_samples: 100,
            confidence: 0.9999,
            seed: 1,
        }
    }
}

lsfb_types::bounds! {
    RelativePoseConfig {
        max_error_px: number(Bounds::POSITIVE),
        max_samples: any,
        min_samples: any,
        confidence: number(Bounds::Within(0.0, 1.0)),
        seed: any,
    }
}

/// A motion with the matches that support it.
#[derive(Clone, Debug, PartialEq)]
pub struct RelativePoseEstimate {
    /// Pose of the first camera in the frame of the second; its translation is of unit length, as images say no scale.
    pub second_from_first: Se3,
    /// Indices of the inliers that lie in front of both cameras, ascending.
    pub inliers: Vec<usize>,
    /// Samples drawn.
    pub samples: usize,
}

/// The motion most pairs agree with; `None` where no sample of five gives one that a sixth supports. Same pairs and seed give the same
/// motion.
pub fn estimate_relative_pose(
    pairs: &[RayPair],
    config: &RelativePoseConfig,
) -> Option<RelativePoseEstimate> {
    if pairs.len() < 6 {
        return None;
    }
    let scorer = Scorer {
        pairs,
        limit_px2: config.max_error_px.powi(2),
    };
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let mut best: Option<(Motion, f64)> = None;
    let (mut samples, mut needed) = (0, config.max_samples);
    while samples < needed.max(config.min_samples).min(config.max_samples) {
        samples += 1;
        let sample = five_of(pairs.len(), &mut rng).map(|i| &pairs[i]);
        let rays = |side: usize| sample.map(|pair| *pair.rays()[side]);
        for essential in essential_matrices(&rays(0), &rays(1)) {
            let bound = best.as_ref().map_or(f64::INFINITY, |(_, cost)| *cost);
            if scorer.bounded(&essential, bound).is_none() {
                continue;
            }
            let Some((motion, cost)) = scorer.most_in_front(&essential) else {
                continue;
            };
            if cost < bound {
                let found = scorer.optimised(motion, cost);
                let share = scorer.inliers(&found.0).count() as f64 / pairs.len() as f64;
                needed = samples_needed(share, 5, config.confidence);
                best = Some(found);
            }
        }
    }
    let (motion, _) = best?;
    let inliers: Vec<usize> = scorer.inliers(&motion).collect();
    (inliers.len() >= 6).then(|| RelativePoseEstimate {
        second_from_first: Se3::new(motion.0, motion.1.into_inner()),
        inliers,
        samples,
    })
}

/// Five different numbers below `count`, which is at least as much.
fn five_of(count: usize, rng: &mut ChaCha8Rng) -> [usize; 5] {
    let mut chosen = [usize::MAX; 5];
    for k in 0..5 {
        chosen[k] = loop {
            let one = rng.random_range(0..count);
            if !chosen[..k].contains(&one) {
                break one;
            }
        };
    }
    chosen
}

/// All pairs, and what an inlier is.
struct Scorer<'a> {
    pairs: &'a [RayPair],
    limit_px2: f64,
}

impl Scorer<'_> {
    /// Sum of squared errors in units of the limit, each at most 1, whatever lies behind; `None` as soon as it reaches `bound`.
    fn bounded(&self, essential: &Matrix3<f64>, bound: f64) -> Option<f64> {
        let mut sum = 0.0;
        for pair in self.pairs {
            sum += (pair.squared_px2(essential) / self.limit_px2).min(1.0);
            if sum >= bound {
                return None;
            }
        }
        Some(sum)
    }

    /// The same of a motion: a pair that meets behind a camera is no inlier.
    fn cost(&self, motion: &Motion) -> f64 {
        let essential = essential_of(motion);
        let costs = self.pairs.iter().map(|pair| {
            let squared = pair.squared_px2(&essential) / self.limit_px2;
            match squared < 1.0 && pair.in_front(motion) {
                true => squared,
                false => 1.0,
            }
        });
        costs.sum()
    }

    fn inliers(&self, motion: &Motion) -> impl Iterator<Item = usize> {
        let (essential, motion) = (essential_of(motion), *motion);
        let pairs = self.pairs.iter().enumerate();
        let inliers = pairs.filter(move |(_, pair)| {
            pair.squared_px2(&essential) < self.limit_px2 && pair.in_front(&motion)
        });
        inliers.map(|(index, _)| index)
    }

    /// Of the four motions of an essential matrix the one that has most in front of both cameras.
    fn most_in_front(&self, essential: &Matrix3<f64>) -> Option<(Motion, f64)> {
        let motions = motions_of(essential)?;
        let costs = motions.map(|motion| (motion, self.cost(&motion)));
        costs.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Least squares over the inliers, as long as that lowers the cost.
    fn optimised(&self, start: Motion, start_cost: f64) -> (Motion, f64) {
        const TRIALS: u32 = 20;
        let terms = |motion: &Motion| {
            let mut sum = NormalEquations::<5>::default();
            let model = Linearised::at(motion);
            for index in self.inliers(motion) {
                let (error, derivative) = self.pairs[index].error_px(&model);
                sum.add(error, &derivative, 1.0 / self.limit_px2);
            }
            sum
        };
        let (motion, cost) = minimise_damped(start, TRIALS, terms, |motion| self.cost(motion));
        match cost < start_cost {
            true => (motion, cost),
            false => (start, start_cost),
        }
    }
}

/// The four motions with this essential matrix, up to sign (Hartley and Zisserman, "Multiple view geometry", 9.6.2).
fn motions_of(essential: &Matrix3<f64>) -> Option<[Motion; 4]> {
    let svd = essential.try_svd(true, true, f64::EPSILON, 300)?;
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    let least =
        (0..3).min_by(|a, b| svd.singular_values[*a].total_cmp(&svd.singular_values[*b]))?;
    // The direction that the matrix takes away belongs last.
    u.swap_columns(least, 2);
    v_t.swap_rows(least, 2);
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let quarter = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let direction = UnitVector3::new_normalize(Vector3::from(u.column(2)));
    let rotation = |turn: Matrix3<f64>| {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * turn * v_t))
    };
    let [one, other] = [rotation(quarter), rotation(quarter.transpose())];
    Some([
        (one, direction),
        (one, -direction),
        (other, direction),
        (other, -direction),
    ])
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, Vector2, Vector6};

    use super::*;

    fn camera() -> Camera {
        Camera::pinhole(640, 480, [500.0; 2], [319.5, 239.5])
    }

    /// Pairs of pixels of a known motion: normal noise, and a share of pixels anywhere.
    struct Scene {
        second_from_first: Se3,
        noise_px: f64,
        outliers: f64,
        depth: fn(Vector2<f64>, f64) -> f64,
    }

    impl Scene {
        fn pairs(&self, count: usize, seed: u64) -> Vec<RayPair> {
            let camera = camera();
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut pairs = Vec::new();
            while pairs.len() < count {
                let mut pixel =
                    || Vector2::new(rng.random_range(0.0..639.0), rng.random_range(0.0..479.0));
                let (first, elsewhere) = (pixel(), pixel());
                let ray = camera.unproject(&first).expect("pinhole");
                let normalised = Vector2::new(ray.x / ray.z, ray.y / ray.z);
                let depth = (self.depth)(normalised, rng.random_range(0.0..1.0));
                let point = ray / ray.z * depth;
                let Some(seen) = camera.project(&(self.second_from_first * point)) else {
                    continue;
                };
                if !camera.contains(&seen, 0.0) {
                    continue;
                }
                // The sum of twelve even deviates is nearly a normal one.
                let mut normal =
                    || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>() * self.noise_px;
                let mut noise = || Vector2::new(normal(), normal());
                let (here, there) = (first + noise(), seen + noise());
                let there = match rng.random_bool(self.outliers) {
                    true => elsewhere,
                    false => there,
                };
                pairs.extend(RayPair::new([&camera; 2], [here, there]));
            }
            pairs
        }

        /// Errors of rotation and direction, degrees, and the share of inliers.
        fn errors(&self, seed: u64) -> ([f64; 2], f64) {
            let pairs = self.pairs(300, seed);
            let found =
                estimate_relative_pose(&pairs, &RelativePoseConfig::default()).expect("a motion");
            let again = estimate_relative_pose(&pairs, &RelativePoseConfig::default());
            assert_eq!(again.as_ref(), Some(&found));
            let turn = self
                .second_from_first
                .rotation
                .angle_to(&found.second_from_first.rotation);
            let direction = &self.second_from_first.translation;
            let aside = direction.angle(&found.second_from_first.translation);
            let share = found.inliers.len() as f64 / 300.0;
            ([turn.to_degrees(), aside.to_degrees()], share)
        }
    }

    const ROOM: fn(Vector2<f64>, f64) -> f64 = |_, chance| 2.0 + 5.0 * chance;
    /// Tilted by about 30° against the camera.
    const WALL: fn(Vector2<f64>, f64) -> f64 = |at, _| 4.0 / (1.0 - 0.5 * at.x - 0.2 * at.y);

    fn sideways() -> Se3 {
        Se3::exp(&Vector6::new(0.03, -0.15, 0.1, 0.6, 0.1, 0.15))
    }

    #[test]
    fn exact_pairs_give_the_exact_motion() {
        let ahead = Se3::exp(&Vector6::new(0.01, 0.02, -0.05, 0.02, 0.01, -0.6));
        for (second_from_first, depth) in [(sideways(), ROOM), (sideways(), WALL), (ahead, ROOM)] {
            let scene = Scene {
                second_from_first,
                noise_px: 0.0,
                outliers: 0.0,
                depth,
            };
            let ([turn, aside], share) = scene.errors(1);
            assert!(turn < 1e-6 && aside < 1e-6, "{turn:e} {aside:e}");
            assert_eq!(share, 1.0);
        }
    }

    #[test]
    fn half_of_the_pairs_may_be_wrong() {
        for seed in 0..5 {
            let scene = Scene {
                second_from_first: sideways(),
                noise_px: 0.5,
                outliers: 0.5,
                depth: ROOM,
            };
            let ([turn, aside], share) = scene.errors(seed);
            assert!(turn < 0.3 && aside < 1.5, "{seed}: {turn} {aside}");
            assert!((0.42..0.62).contains(&share), "{seed}: {share}");
        }
    }

    #[test]
    fn a_wall_and_a_walk_straight_ahead_are_no_exception() {
        let ahead = Se3::exp(&Vector6::new(0.01, 0.02, -0.05, 0.02, 0.01, -0.6));
        for (second_from_first, depth) in [(sideways(), WALL), (ahead, ROOM)] {
            for seed in 0..5 {
                let scene = Scene {
                    second_from_first,
                    noise_px: 0.5,
                    outliers: 0.3,
                    depth,
                };
                let ([turn, aside], _) = scene.errors(seed);
                assert!(turn < 0.7 && aside < 3.5, "{seed}: {turn} {aside}");
            }
        }
    }

    #[test]
    fn nothing_comes_of_nothing() {
        let scene = Scene {
            second_from_first: sideways(),
            noise_px: 0.5,
            outliers: 1.0,
            depth: ROOM,
        };
        let config = RelativePoseConfig {
            max_samples: 300,
            ..RelativePoseConfig::default()
        };
        assert!(estimate_relative_pose(&scene.pairs(5, 1), &config).is_none());
        let noise = scene.pairs(100, 2);
        let found = estimate_relative_pose(&noise, &config);
        assert!(found.is_none_or(|found| found.inliers.len() < 30));
        let same = vec![noise[0]; 40];
        assert!(estimate_relative_pose(&same, &config).is_none());
    }
}
