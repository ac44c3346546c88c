//! How many corners a corner is worth.
//!
//! Errors of neighbouring corners are not independent: a board that is not quite what its file says, a lens that is not quite its
//! model and motion blur move them together. The errors of a part of the board in one view are a cluster; where they are
//! independent, the square of their sum is the sum of their squares. The ratio is the design effect (Kish 1965): variances
//! that count corners as independent are too small by it.

use std::collections::BTreeMap;

use lsfb_geometry::{Vector2, Vector3};

use crate::board::Target;

/// Parts along each edge of the board.
const PARTS: f64 = 3.0;

/// Standard deviations by which a ratio must exceed 1 to count.
const SIGNIFICANT: f64 = 3.0;

/// Errors by view (or stretch of time) and part of the board.
#[derive(Default)]
pub(crate) struct Clusters(BTreeMap<(i64, [u8; 2]), Cluster>);

#[derive(Default)]
struct Cluster {
    sum: Vector2<f64>,
    squares: f64,
    count: usize,
}

impl Clusters {
    /// Adds the error of a corner at `share` of the board.
    pub fn add(&mut self, time: i64, share: [f64; 2], error_px: &Vector2<f64>) {
        let part = share.map(|s| (s * PARTS).clamp(0.0, PARTS - 1.0) as u8);
        let cluster = self.0.entry((time, part)).or_default();
        cluster.sum += error_px;
        cluster.squares += error_px.norm_squared();
        cluster.count += 1;
    }

    /// The design effect; 1 where it could be so by accident.
    pub fn design_effect(&self) -> f64 {
        // Single corners say nothing.
        let several = || self.0.values().filter(|c| c.count > 1);
        let together: f64 = several().map(|c| c.sum.norm_squared()).sum();
        let alone: f64 = several().map(|c| c.squares).sum();
        // Of independent errors the ratio is the mean of as many χ² as there are components of sums.
        let spread = (1.0 / several().count().max(1) as f64).sqrt();
        let ratio = together / alone;
        if ratio > 1.0 + SIGNIFICANT * spread {
            ratio
        } else {
            1.0
        }
    }
}

/// Where on the board a point lies, as shares of its edges.
pub(crate) fn share_of_board(target: &Target, point: &Vector3<f64>) -> [f64; 2] {
    let last = target.corner(target.corner_count().saturating_sub(1));
    let far = match *target {
        // The last corner of a grid is the upper left one of the last tag.
        Target::AprilGrid { tag_size_m, .. } => Vector3::new(last.x + tag_size_m, last.y, 0.0),
        Target::Checkerboard { .. } | Target::Charuco { .. } => last,
    };
    [point.x / far.x.max(1e-9), point.y / far.y.max(1e-9)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn independent_errors_count_each_and_common_ones_once() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut apart, mut together) = (Clusters::default(), Clusters::default());
        for view in 0..200 {
            let common = Vector2::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
            for _ in 0..16 {
                let own = Vector2::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
                apart.add(view, [0.1, 0.1], &own);
                together.add(view, [0.1, 0.1], &common);
            }
        }
        assert_eq!(apart.design_effect(), 1.0);
        assert!((together.design_effect() - 16.0).abs() < 1e-9);
    }
}
