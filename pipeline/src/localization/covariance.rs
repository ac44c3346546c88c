//! How far a pose may be off, by what its matches say about it.

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix6, Vector6};
use nalgebra::{Const, DimMin, SMatrix, SVector};

use super::matches::{MountedCamera, PointMatch};
use super::refinement::{RefinedPose, WeightedMatches};

/// Cells of an image, in each direction, within which points share their errors: neighbours come from the same keyframes of the map
/// and look through the same part of the lens.
const CELLS: f64 = 4.0;

/// Covariance of a pose, tangent `[rotation, translation]` on the right. `None` where the matches do not determine the pose.
pub(super) fn pose_covariance(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    refined: &RefinedPose,
    huber_px: f64,
) -> Option<Matrix6<f64>> {
    let gradients: Option<Vec<Vector6<f64>>> = cells(cameras, matches)
        .iter()
        .map(|cell| {
            let pose = &refined.world_from_rig;
            let weighted = WeightedMatches::at(cameras, cell, pose)?;
            Some(weighted.fit(pose, huber_px)?.equations.gradient)
        })
        .collect();
    Clustered {
        curvature: refined.curvature,
        information: refined.information,
        cost_px2: refined.cost_px2,
        matches: matches.len(),
        gradients: gradients?,
    }
    .covariance()
}

/// The matches of each cell of each image.
pub(super) fn cells(cameras: &[MountedCamera], matches: &[PointMatch]) -> Vec<Vec<PointMatch>> {
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
    cells.into_values().collect()
}

/// What matches say about unknowns at the least robust cost.
pub(super) struct Clustered<const N: usize> {
    /// Half of the second derivatives of the cost.
    pub curvature: SMatrix<f64, N, N>,
    /// Information of the matches by their weights.
    pub information: SMatrix<f64, N, N>,
    pub cost_px2: f64,
    pub matches: usize,
    /// The gradient that each cell leaves.
    pub gradients: Vec<SVector<f64, N>>,
}

impl<const N: usize> Clustered<N>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    /// `C⁻¹ (σ² H) C⁻¹` of errors that are independent, and `C⁻¹ (Σ gᵢ gᵢᵀ) C⁻¹` of those that the matches of a cell share, `C` the
    /// curvature, `H` the information and `gᵢ` the gradients (the sandwich estimator of M-estimates, over clusters: Huber 1967; Liang
    /// and Zeger, Biometrika 1986). `None` where the matches do not determine the unknowns.
    pub fn covariance(&self) -> Option<SMatrix<f64, N, N>> {
        let inverse = self.curvature.cholesky()?.inverse();
        let freedom = (2 * self.matches).saturating_sub(N).max(1) as f64;
        let independent = self.information * (self.cost_px2 / freedom);
        let scatter: SMatrix<f64, N, N> = self.gradients.iter().map(|g| g * g.transpose()).sum();
        let cells = self.gradients.len() as f64;
        let shared = scatter * (cells / (cells - 1.0).max(1.0));
        let covariance = inverse * (independent + shared) * inverse;
        covariance
            .iter()
            .all(|v| v.is_finite())
            .then_some(covariance)
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, Se3, Vector2, Vector3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::super::refinement::{RefinementConfig, refine_pose};
    use super::*;

    /// What is wrong with the matches, pixels and metres.
    #[derive(Clone, Copy, Debug, Default)]
    struct Wrong {
        noise_px: f64,
        /// The same for all matches of a cell.
        shared_px: f64,
        /// Of every second point, along the ray from 2 m beside the camera, from where it was mapped; stated.
        depth_m: f64,
        huber_px: f64,
    }

    /// Root of the mean squared error of many poses in units of their covariances, per degree of freedom, and their root mean squared
    /// distance from the truth, metres.
    fn consistency(wrong: Wrong) -> (f64, f64) {
        let cameras = [MountedCamera {
            camera: Camera::pinhole(640, 480, [500.0; 2], [319.5, 239.5]),
            rig_from_camera: Se3::identity(),
            readout_s: 0.0,
        }];
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let config = RefinementConfig {
            huber_px: wrong.huber_px,
            ..RefinementConfig::default()
        };
        let (mut squares, mut squares_m2) = (0.0, 0.0);
        for _ in 0..200 {
            // Of the variance of an even distribution: a twelfth of the squared width.
            let mut even = |width: f64| (rng.random_range(0.0..1.0) - 0.5) * width * 12f64.sqrt();
            let cells: Vec<Vector2<f64>> = (0..16)
                .map(|_| Vector2::new(even(wrong.shared_px), even(wrong.shared_px)))
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
                    let noise = Vector2::new(even(wrong.noise_px), even(wrong.noise_px));
                    let along = (ray * depth_m - Vector3::x() * 2.0).normalize();
                    let off_m = if i % 2 == 0 { 0.0 } else { wrong.depth_m };
                    PointMatch {
                        camera: 0,
                        pixel: seen + noise + cells[row * 4 + column],
                        point_in_world: ray * depth_m + along * even(off_m),
                        point_covariance_m2: along * along.transpose() * off_m.powi(2),
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
            squares += error.dot(&(information * error)) / 6.0;
            squares_m2 += error.fixed_rows::<3>(3).norm_squared();
        }
        ((squares / 200.0).sqrt(), (squares_m2 / 200.0).sqrt())
    }

    #[test]
    fn stated_deviations_hold() {
        let exact = Wrong {
            noise_px: 0.5,
            huber_px: 10.0,
            ..Wrong::default()
        };
        let cases = [
            exact,
            Wrong {
                shared_px: 0.5,
                ..exact
            },
            Wrong {
                noise_px: 0.1,
                shared_px: 1.0,
                ..exact
            },
            // Most errors count linearly: their weights promise more than they hold.
            Wrong {
                noise_px: 4.0,
                huber_px: 1.0,
                ..exact
            },
            Wrong {
                depth_m: 0.4,
                huber_px: 1.0,
                ..exact
            },
        ];
        for wrong in cases {
            let (found, _) = consistency(wrong);
            assert!((0.5..=1.5).contains(&found), "{wrong:?}: {found}");
        }
    }

    #[test]
    fn points_that_are_known_badly_lead_no_pose_astray() {
        let exact = Wrong {
            noise_px: 0.5,
            huber_px: 1.0,
            ..Wrong::default()
        };
        let (_, all_exact_m) = consistency(exact);
        let half_bad = Wrong {
            depth_m: 1.0,
            ..exact
        };
        let (_, off_m) = consistency(half_bad);
        assert!(off_m < 2.0 * all_exact_m, "{off_m} {all_exact_m}");
    }
}
