//! How well a pose explains matches, eight at a time: what most of the search for a pose does.
//!
//! Compiled for the vector units of the processor it runs on. None of it fuses a product with a sum, and sums are taken in the order of
//! the matches, so that every processor finds the same numbers as a match by itself.

use lsfb_geometry::{Se3, Vector3};
use pulp::{Arch, Simd, WithSimd};

use super::upright::SeenPoint;

const LANES: usize = 8;

/// Matches, coordinate by coordinate; what fills up the last block is never summed.
#[derive(Clone, Debug)]
struct Block {
    rays_in_rig: [[f64; LANES]; 3],
    origins_in_rig: [[f64; LANES]; 3],
    points_in_world: [[f64; LANES]; 3],
    limits: [f64; LANES],
    count: usize,
}

/// Matches to be scored again and again.
#[derive(Clone, Debug)]
pub(super) struct Scoring {
    blocks: Vec<Block>,
    count: usize,
}

impl Scoring {
    /// Of matches, each with the squared sine of the largest angle of an inlier.
    pub fn new<'a>(matches: impl Iterator<Item = (&'a SeenPoint, f64)>) -> Self {
        let mut blocks: Vec<Block> = Vec::new();
        let mut count = 0;
        for (seen, limit) in matches {
            if count % LANES == 0 {
                blocks.push(Block {
                    rays_in_rig: [[0.0; LANES]; 3],
                    origins_in_rig: [[0.0; LANES]; 3],
                    points_in_world: [[0.0; LANES]; 3],
                    limits: [1.0; LANES],
                    count: 0,
                });
            }
            if let Some(block) = blocks.last_mut() {
                let lane = block.count;
                for axis in 0..3 {
                    block.rays_in_rig[axis][lane] = seen.ray_in_rig[axis];
                    block.origins_in_rig[axis][lane] = seen.origin_in_rig[axis];
                    block.points_in_world[axis][lane] = seen.point_in_world[axis];
                }
                block.limits[lane] = limit;
                block.count += 1;
            }
            count += 1;
        }
        Self { blocks, count }
    }

    /// Sum of squared errors in units of the limit, each at most 1; `None` as soon as it reaches `bound`, and where no match has less.
    pub fn score(&self, rig_from_world: &Se3, bound: f64) -> Option<f64> {
        let rotation = rig_from_world.rotation_matrix();
        let sum = Arch::new().dispatch(Sum {
            blocks: &self.blocks,
            rows: [0, 1, 2].map(|row| [0, 1, 2].map(|column| rotation[(row, column)])),
            translation: rig_from_world.translation,
            bound,
        });
        (sum < bound && sum < self.count as f64).then_some(sum)
    }
}

/// The sum up to the block in which it reaches `bound`.
struct Sum<'a> {
    blocks: &'a [Block],
    rows: [[f64; 3]; 3],
    translation: Vector3<f64>,
    bound: f64,
}

impl WithSimd for Sum<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let mut sum = 0.0;
        for block in self.blocks {
            let errors = self.errors(block);
            for error in &errors[..block.count] {
                sum += error;
            }
            if sum >= self.bound {
                break;
            }
        }
        sum
    }
}

impl Sum<'_> {
    /// Of each match what it adds: the squared sine of the angle between its ray and where the pose expects its point.
    #[inline(always)]
    fn errors(&self, block: &Block) -> [f64; LANES] {
        let ([rx, ry, rz], [ox, oy, oz]) = (&block.rays_in_rig, &block.origins_in_rig);
        let [px, py, pz] = &block.points_in_world;
        let mut errors = [0.0; LANES];
        for k in 0..LANES {
            let along = |row: usize, origin: f64| {
                let [a, b, c] = self.rows[row];
                a * px[k] + b * py[k] + c * pz[k] + self.translation[row] - origin
            };
            let (x, y, z) = (along(0, ox[k]), along(1, oy[k]), along(2, oz[k]));
            let ahead = x * rx[k] + y * ry[k] + z * rz[k];
            let across = [
                y * rz[k] - z * ry[k],
                z * rx[k] - x * rz[k],
                x * ry[k] - y * rx[k],
            ];
            let across = across[0] * across[0] + across[1] * across[1] + across[2] * across[2];
            let error = across / (x * x + y * y + z * z) / block.limits[k];
            // What is behind, or no number, is no inlier.
            errors[k] = if ahead > 0.0 && error < 1.0 {
                error
            } else {
                1.0
            };
        }
        errors
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;

    use super::*;

    /// Each by itself, as geometry has it.
    fn alone(seen: &SeenPoint, limit: f64, rig_from_world: &Se3) -> f64 {
        let direction = *rig_from_world * seen.point_in_world - seen.origin_in_rig;
        if direction.dot(&seen.ray_in_rig) <= 0.0 {
            return 1.0;
        }
        (direction.angle(&seen.ray_in_rig).sin().powi(2) / limit).min(1.0)
    }

    #[test]
    fn blocks_have_the_sum_of_their_matches() {
        let pose = Se3::exp(&Vector6::new(0.2, -0.3, 0.9, 0.5, -0.2, 0.1));
        let seen: Vec<SeenPoint> = (0..29)
            .map(|k| {
                let t = f64::from(k);
                let ray = Vector3::new(0.3 * (1.3 * t).sin(), 0.3 * (2.1 * t).cos(), 1.0);
                let origin = Vector3::new(0.0, 0.06 * (t % 2.0), 0.0);
                // A few within their limit, some beyond, each seventh behind.
                let depth = if k % 7 == 6 { -2.0 } else { 2.0 + t };
                let off = Vector3::new(1e-3 * t * t, 0.0, 0.0);
                SeenPoint {
                    origin_in_rig: origin,
                    ray_in_rig: ray.normalize(),
                    point_in_world: pose.inverse() * (origin + ray * depth + off),
                }
            })
            .collect();
        let limit = 1e-4;
        for count in [1, 7, 8, 9, 29] {
            let scoring = Scoring::new(seen[..count].iter().map(|seen| (seen, limit)));
            let expected: f64 = seen[..count].iter().map(|s| alone(s, limit, &pose)).sum();
            let sum = scoring.score(&pose, f64::INFINITY).expect("inliers");
            assert!((sum - expected).abs() < 1e-9, "{count}: {sum} {expected}");
            assert_eq!(scoring.score(&pose, sum), None);
            assert_eq!(scoring.score(&pose, 1.01 * sum + 1e-12), Some(sum));
        }
        let turned = Se3::exp(&Vector6::new(0.0, 3.0, 0.0, 0.0, 0.0, 0.0)) * pose;
        let scoring = Scoring::new(seen.iter().map(|seen| (seen, limit)));
        assert_eq!(scoring.score(&turned, f64::INFINITY), None);
        let nowhere = Se3::new(pose.rotation, Vector3::repeat(f64::NAN));
        assert_eq!(scoring.score(&nowhere, f64::INFINITY), None);
        assert_eq!(Scoring::new([].into_iter()).score(&pose, 1.0), None);
    }
}
