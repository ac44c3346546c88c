//! Errors that all matches of an image share: a pose takes them up, and no residual shows them.

use lsfb_geometry::rolling_shutter::row_time_s;
use lsfb_geometry::{Matrix6, Vector6};

use super::focal_length::pose_by_log_focal;
use super::map_error::MapError;
use super::matches::PosedMatches;
use super::refinement::{Huber, WeightedMatches};

/// Standard deviation of the logarithm of focal lengths that are calibrated.
const LOG_FOCAL_SIGMA: f64 = 0.001;
/// How fast whoever carries a camera turns and walks: standard deviations along each axis, rad/s and m/s.
const TURNING_SIGMA_RAD_S: f64 = 0.4;
const WALKING_SIGMA_M_S: f64 = 1.0;

/// Covariance of a pose by these errors, tangent `[rotation, translation]` on the right. `log_focal` is by how much the matches say
/// that the focal lengths are off, logarithm and its standard deviation. `None` where the matches do not determine the pose.
pub(super) fn shared_covariance(
    posed: &PosedMatches,
    (log_focal, log_focal_sigma): (f64, f64),
    map_error: &MapError,
) -> Option<Matrix6<f64>> {
    let seen = (log_focal.powi(2) - log_focal_sigma.powi(2)).max(0.0);
    let by_focal = pose_by_log_focal(posed)?;
    let of_focal = by_focal * by_focal.transpose() * (LOG_FOCAL_SIGMA.powi(2) + seen);
    Some(of_focal + of_rolling_shutter(posed)? + map_error.covariance())
}

/// Rows are exposed one after the other, while the camera moves in a way that one image does not tell.
fn of_rolling_shutter(posed: &PosedMatches) -> Option<Matrix6<f64>> {
    if posed.cameras.iter().all(|c| c.readout_s == 0.0) {
        return Some(Matrix6::zeros());
    }
    let pose = posed.world_from_rig;
    let weighted = WeightedMatches::at(posed.cameras, posed.matches, pose)?;
    let (mut information, mut by_motion) = (Matrix6::zeros(), Matrix6::zeros());
    weighted.reproject(pose, |m, mounted, seen, whitening| {
        let error_px = whitening * (seen.pixel - m.pixel);
        let by_pose = whitening * seen.by_pose;
        let term = by_pose.tr_mul(&by_pose) * Huber::of(&error_px, posed.huber_px).weight;
        information += term;
        by_motion += term * row_time_s(&mounted.camera, mounted.readout_s, m.pixel.y);
    })?;
    let pose_by_motion = information.cholesky()?.solve(&by_motion);
    let (turning, walking) = (TURNING_SIGMA_RAD_S.powi(2), WALKING_SIGMA_M_S.powi(2));
    let motion = Vector6::new(turning, turning, turning, walking, walking, walking);
    Some(pose_by_motion * Matrix6::from_diagonal(&motion) * pose_by_motion.transpose())
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, Matrix3, Se3, Vector2};

    use super::super::matches::{MountedCamera, PointMatch};
    use super::super::refinement::{RefinementConfig, refine_pose};
    use super::*;

    /// The error of a pose in units of what is stated, of matches that a lens and a motion have moved from where they should be.
    fn stated_share(readout_s: f64, log_focal: f64, moved: impl Fn(Vector2<f64>) -> Se3) -> f64 {
        let cameras = [MountedCamera {
            camera: Camera::pinhole(640, 480, [500.0; 2], [319.5, 239.5]),
            rig_from_camera: Se3::identity(),
            readout_s,
        }];
        let principal = Vector2::new(319.5, 239.5);
        let matches: Vec<PointMatch> = (0..100)
            .map(|i| {
                let at = Vector2::new(
                    30.0 + 64.0 * f64::from(i % 10),
                    24.0 + 48.0 * f64::from(i / 10),
                );
                let ray = cameras[0].camera.unproject(&at).unwrap_or_default();
                let depth_m = 3.0 + f64::from(i % 3);
                PointMatch {
                    camera: 0,
                    pixel: principal + (at - principal) * log_focal.exp(),
                    point_in_world: moved(at) * (ray / ray.z * depth_m),
                    point_covariance_m2: Matrix3::zeros(),
                }
            })
            .collect();
        let config = RefinementConfig::default();
        let refined = refine_pose(&cameras, &matches, &Se3::identity(), &config).expect("a pose");
        let posed = PosedMatches {
            cameras: &cameras,
            matches: &matches,
            world_from_rig: &refined.world_from_rig,
            huber_px: config.huber_px,
        };
        let stated = shared_covariance(&posed, (log_focal, 0.0), &MapError::default());
        let stated = stated.expect("determined");
        let off = refined.world_from_rig.translation.norm();
        off / stated.fixed_view::<3, 3>(3, 3).trace().sqrt()
    }

    #[test]
    fn a_focal_length_off_by_two_per_cent_is_covered() {
        let share = stated_share(0.0, 0.02, |_| Se3::identity());
        assert!((0.3..=1.5).contains(&share), "{share}");
    }

    #[test]
    fn rows_exposed_while_walking_are_covered() {
        // 1 m/s forwards, turning by 0.4 rad/s, over 30 ms.
        let motion = Vector6::new(0.0, 0.4, 0.1, 0.3, 0.1, 1.0);
        let readout_s = 0.03;
        let camera = Camera::pinhole(640, 480, [500.0; 2], [319.5, 239.5]);
        let share = stated_share(readout_s, 0.0, |at| {
            Se3::exp(&(motion * row_time_s(&camera, readout_s, at.y)))
        });
        assert!(share < 1.5, "{share}");
    }
}
