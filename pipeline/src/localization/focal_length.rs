//! Whether the cameras' focal lengths fit the map.
//!
//! An image that was resized, or taken by another lens, agrees with a pose that is too near or too far, as flat scenes let it: the pose
//! gathers inliers, and is wrong by as much as the focal length. Points at different depths tell the two apart. So the focal lengths
//! are freed, all by one factor, and the matches say which factor fits best and how well they know it.

use lsfb_geometry::{Matrix6, Se3, Vector2, Vector6};
use lsfb_solver::gauss_newton::{NormalEquations, minimise_damped};
use nalgebra::{SMatrix, SVector};

use super::covariance::{Clustered, cells};
use super::matches::{MountedCamera, PointMatch, PosedMatches};
use super::ransac::{RansacConfig, estimate_pose};
use super::refinement::{Huber, WeightedMatches, reproject};

/// Pose of the rig and natural logarithm of the factor of the focal lengths.
type Unknowns = (Se3, SVector<f64, 1>);

/// The focal lengths with which the matches agree best.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FocalFit {
    /// Natural logarithm of their factor.
    pub log_scale: f64,
    /// Standard deviation of the logarithm.
    pub log_sigma: f64,
    /// Pose of the rig with these.
    pub world_from_rig: Se3,
}

impl FocalFit {
    /// The cameras with these focal lengths.
    pub fn cameras(&self, cameras: &[MountedCamera]) -> Vec<MountedCamera> {
        scaled_cameras(cameras, self.log_scale.exp())
    }
}

/// Times that the matches are chosen anew by what agrees.
const ROUNDS: usize = 4;
/// Trials of the search in each.
const MAX_TRIALS: u32 = 30;
/// Fewer matches do not say.
const FEWEST: usize = 8;

/// The fit that begins at a pose and a factor; `None` where the matches do not determine one.
pub(super) fn fit_focal_length(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    start: (&Se3, f64),
    config: &RansacConfig,
) -> Option<FocalFit> {
    let huber_px = config.refinement.huber_px;
    let mut value: Unknowns = (*start.0, SVector::from([start.1.ln()]));
    let mut agreeing: Vec<PointMatch> = Vec::new();
    for _ in 0..ROUNDS {
        let near = matches
            .iter()
            .filter(|m| error_px(cameras, m, &value) <= config.max_error_px);
        agreeing = near.copied().collect();
        if agreeing.len() < FEWEST {
            return None;
        }
        let weighted = WeightedMatches::at(cameras, &agreeing, &value.0)?;
        let at = |v: &Unknowns| terms(&weighted, v, huber_px);
        let equations = |v: &Unknowns| at(v).map_or_else(Default::default, |t| t.equations);
        let cost = |v: &Unknowns| at(v).map_or(f64::INFINITY, |t| t.cost_px2);
        (value, _) = minimise_damped(value, MAX_TRIALS, equations, cost);
    }
    let gradients: Option<Vec<SVector<f64, 7>>> = cells(cameras, &agreeing)
        .iter()
        .map(|cell| {
            let weighted = WeightedMatches::at(cameras, cell, &value.0)?;
            Some(terms(&weighted, &value, huber_px)?.equations.gradient)
        })
        .collect();
    let weighted = WeightedMatches::at(cameras, &agreeing, &value.0)?;
    let found = terms(&weighted, &value, huber_px)?;
    let covariance = Clustered {
        curvature: found.curvature,
        information: found.equations.information,
        cost_px2: found.cost_px2,
        matches: agreeing.len(),
        gradients: gradients?,
    }
    .covariance()?;
    Some(FocalFit {
        log_scale: value.1[0],
        log_sigma: covariance[(6, 6)].sqrt(),
        world_from_rig: value.0,
    })
}

/// Factors with which poses are looked for anew: from near 1 the fit would not arrive at them.
const FACTORS: [f64; 4] = [0.5, 0.75, 1.33, 2.0];

/// Fits that begin at poses of `matches` with other focal lengths.
pub(super) fn other_focal_lengths(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    config: &RansacConfig,
) -> Vec<FocalFit> {
    FACTORS
        .iter()
        .filter_map(|factor| {
            let others = scaled_cameras(cameras, *factor);
            let pose = estimate_pose(&others, matches, config)?.world_from_rig;
            fit_focal_length(cameras, matches, (&pose, *factor), config)
        })
        .collect()
}

/// How a pose moves with the natural logarithm of the focal lengths, tangent `[rotation, translation]` on the right: as far as the
/// matches let it.
pub(super) fn pose_by_log_focal(posed: &PosedMatches) -> Option<Vector6<f64>> {
    let pose = posed.world_from_rig;
    let weighted = WeightedMatches::at(posed.cameras, posed.matches, pose)?;
    let at = (*pose, SVector::zeros());
    let information = terms(&weighted, &at, posed.huber_px)?.equations.information;
    let of_pose: Matrix6<f64> = information.fixed_view::<6, 6>(0, 0).into();
    let shared: Vector6<f64> = information.fixed_view::<6, 1>(0, 6).into();
    Some(-of_pose.cholesky()?.solve(&shared))
}

fn scaled_cameras(cameras: &[MountedCamera], factor: f64) -> Vec<MountedCamera> {
    let mut scaled = cameras.to_vec();
    for mounted in &mut scaled {
        let lens = &mounted.camera.lens;
        // The first two are the focal lengths.
        let mut parameters = lens.parameters().values;
        parameters[..2]
            .iter_mut()
            .for_each(|focal_px| *focal_px *= factor);
        mounted.camera.lens = lens.model().lens(&parameters);
    }
    scaled
}

/// A pixel as a focal length of another size shows it.
fn scaled(mounted: &MountedCamera, pixel: &Vector2<f64>, log_scale: f64) -> Vector2<f64> {
    let principal = Vector2::from(mounted.camera.principal_px());
    principal + (pixel - principal) * log_scale.exp()
}

fn error_px(cameras: &[MountedCamera], m: &PointMatch, (pose, log_scale): &Unknowns) -> f64 {
    let mut error_px = f64::INFINITY;
    let shown = reproject(
        cameras,
        std::slice::from_ref(m),
        pose,
        |m, mounted, seen| {
            error_px = (scaled(mounted, &seen.pixel, log_scale[0]) - m.pixel).norm();
        },
    );
    shown.map_or(f64::INFINITY, |()| error_px)
}

/// What the matches say about a pose and a factor.
struct Terms {
    cost_px2: f64,
    equations: NormalEquations<7>,
    curvature: SMatrix<f64, 7, 7>,
}

fn terms(matches: &WeightedMatches, (pose, log_scale): &Unknowns, huber_px: f64) -> Option<Terms> {
    let mut sum = Terms {
        cost_px2: 0.0,
        equations: NormalEquations::default(),
        curvature: SMatrix::zeros(),
    };
    matches.reproject(pose, |m, mounted, seen, whitening| {
        let pixel = scaled(mounted, &seen.pixel, log_scale[0]);
        let residual = whitening * (pixel - m.pixel);
        let mut jacobian = SMatrix::<f64, 2, 7>::zeros();
        let by_pose = whitening * seen.by_pose * log_scale[0].exp();
        jacobian.fixed_columns_mut::<6>(0).copy_from(&by_pose);
        let from_centre = pixel - Vector2::from(mounted.camera.principal_px());
        jacobian.set_column(6, &(whitening * from_centre));
        let robust = Huber::of(&residual, huber_px);
        sum.cost_px2 += robust.cost_px2;
        sum.curvature += jacobian.tr_mul(&(robust.curvature * jacobian));
        sum.equations.add_block(&residual, &jacobian, robust.weight);
    })?;
    Some(sum)
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, Matrix3, Vector3};

    use super::*;

    const FOCAL_PX: f64 = 500.0;

    fn cameras() -> [MountedCamera; 1] {
        [MountedCamera {
            camera: Camera::pinhole(640, 480, [FOCAL_PX; 2], [319.5, 239.5]),
            rig_from_camera: Se3::identity(),
            readout_s: 0.0,
        }]
    }

    /// A hundred points before the camera at the origin, each as deep as `depth_m` says, as a camera of another focal length sees them.
    fn seen(scale: f64, depth_m: fn(i32) -> f64) -> Vec<PointMatch> {
        let [mounted] = cameras();
        (0..100)
            .map(|i| {
                let shift = 0.4 * f64::from(i * 7 % 11 - 5) / 5.0;
                let at = Vector2::new(
                    160.0 + 32.0 * f64::from(i % 10) + shift,
                    120.0 + 24.0 * f64::from(i / 10) - shift,
                );
                let ray = mounted.camera.unproject(&at).unwrap_or_default();
                // Off by half of a pixel, in no direction in particular.
                let noise = Vector2::new(f64::from(i % 3 - 1), f64::from(i % 7 % 3 - 1)) * 0.5;
                PointMatch {
                    camera: 0,
                    pixel: scaled(&mounted, &at, f64::ln(scale)) + noise,
                    point_in_world: ray / ray.z * depth_m(i),
                    point_covariance_m2: Matrix3::zeros(),
                }
            })
            .collect()
    }

    #[test]
    fn a_resized_image_says_by_how_much() {
        let config = RansacConfig::default();
        for scale in [0.5, 0.8, 0.9, 1.0, 1.1, 1.25, 2.0] {
            let matches = seen(scale, |i| 2.0 + f64::from(i % 4));
            let fits = other_focal_lengths(&cameras(), &matches, &config);
            let near = estimate_pose(&cameras(), &matches, &config);
            let near = near.map_or_else(Se3::identity, |pose| pose.world_from_rig);
            let near = fit_focal_length(&cameras(), &matches, (&near, 1.0), &config);
            let found = fits.iter().chain(&near).any(|fit| {
                (fit.log_scale - scale.ln()).abs() < 0.01
                    && fit.log_sigma < 0.01
                    && fit.world_from_rig.translation.norm() < 0.05
            });
            assert!(found, "{scale}: {near:?} {fits:?}");
        }
    }

    #[test]
    fn a_wall_seen_at_right_angles_says_nothing() {
        let matches = seen(1.0, |_| 3.0);
        let start = (&Se3::new(Default::default(), Vector3::z() * 0.01), 1.0);
        let fit = fit_focal_length(&cameras(), &matches, start, &RansacConfig::default());
        assert!(fit.is_none_or(|f| f.log_sigma > 0.1), "{fit:?}");
    }
}
