//! How far a pose may be off, by what its matches say about it.

use std::collections::BTreeMap;

use lsfb_geometry::Matrix6;

use super::matches::{MountedCamera, PointMatch};
use super::refinement::{RefinedPose, fit};

/// Cells of an image, in each direction, within which points share their errors: neighbours come from the same keyframes of the map
/// and look through the same part of the lens.
const CELLS: f64 = 4.0;

/// Covariance of a pose, tangent `[rotation, translation]` on the right: `σ² H⁻¹` of errors that are independent, and
/// `H⁻¹ (Σ gᵢ gᵢᵀ) H⁻¹` of those that the matches of a cell share, by the gradient that each cell leaves (the sandwich estimator
/// over clusters: Liang and Zeger, Biometrika 1986). `None` where the matches do not determine the pose.
pub(super) fn pose_covariance(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    refined: &RefinedPose,
    huber_px: f64,
) -> Option<Matrix6<f64>> {
    let inverse = refined.information.cholesky()?.inverse();
    let freedom = (2 * matches.len()).saturating_sub(6).max(1) as f64;
    let independent = inverse * (refined.cost_px2 / freedom);
    let mut cells: BTreeMap<(usize, u8, u8), Vec<PointMatch>> = BTreeMap::new();
    for m in matches {
        let Some(mounted) = cameras.get(m.camera) else {
            continue;
        };
        let cell = |v: f64, side: u32| ((v + 0.5) / f64::from(side) * CELLS) as u8;
        let column = cell(m.pixel.x, mounted.camera.width);
        let row = cell(m.pixel.y, mounted.camera.height);
        cells.entry((m.camera, column, row)).or_default().push(*m);
    }
    let mut scatter = Matrix6::zeros();
    for cell in cells.values() {
        let gradient = fit(cameras, cell, &refined.world_from_rig, huber_px)?
            .equations
            .gradient;
        scatter += gradient * gradient.transpose();
    }
    let count = cells.len() as f64;
    let shared = inverse * scatter * inverse * (count / (count - 1.0).max(1.0));
    let covariance = independent + shared;
    covariance
        .iter()
        .all(|v| v.is_finite())
        .then_some(covariance)
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, Se3, Vector2, Vector6};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::super::refinement::{RefinementConfig, refine_pose};
    use super::*;

    /// Sum of the squared errors of many poses in units of their covariances, per degree of freedom: pixels off by `noise_px` each
    /// alone and by `shared_px` each cell as a whole.
    fn consistency(noise_px: f64, shared_px: f64) -> f64 {
        let cameras = [MountedCamera {
            camera: Camera::pinhole(640, 480, [500.0; 2], [319.5, 239.5]),
            rig_from_camera: Se3::identity(),
        }];
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let config = RefinementConfig {
            huber_px: 10.0,
            ..RefinementConfig::default()
        };
        let mut sum = 0.0;
        for _ in 0..200 {
            // Of the variance of an even distribution: a twelfth of the squared width.
            let mut even = |width: f64| (rng.random_range(0.0..1.0) - 0.5) * width * 12f64.sqrt();
            let cells: Vec<Vector2<f64>> = (0..16)
                .map(|_| Vector2::new(even(shared_px), even(shared_px)))
                .collect();
            let matches: Vec<PointMatch> = (0..160)
                .map(|i| {
                    let (column, row) = (i % 4, i / 4 % 4);
                    let seen = Vector2::new(
                        80.0 + 160.0 * column as f64 + even(40.0),
                        60.0 + 120.0 * row as f64 + even(30.0),
                    );
                    let ray = cameras[0].camera.unproject(&seen).unwrap_or_default();
                    let depth_m = 3.0 + even(0.5);
                    let noise = Vector2::new(even(noise_px), even(noise_px));
                    PointMatch {
                        camera: 0,
                        pixel: seen + noise + cells[row * 4 + column],
                        point_in_world: ray * depth_m,
                    }
                })
                .collect();
            let refined = refine_pose(&cameras, &matches, &Se3::identity(), &config);
            let refined = refined.expect("a pose");
            let covariance = pose_covariance(&cameras, &matches, &refined, config.huber_px);
            let information = covariance
                .and_then(|c| c.try_inverse())
                .expect("determined");
            let error: Vector6<f64> = refined.world_from_rig.inverse().log();
            sum += error.dot(&(information * error)) / 6.0;
        }
        sum / 200.0
    }

    #[test]
    fn stated_deviations_hold_for_errors_that_neighbours_share() {
        for (noise_px, shared_px) in [(0.5, 0.0), (0.5, 0.5), (0.1, 1.0)] {
            let found = consistency(noise_px, shared_px).sqrt();
            assert!(
                (0.5..=1.5).contains(&found),
                "{noise_px} {shared_px}: {found}"
            );
        }
    }
}
