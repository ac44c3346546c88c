//! Projection by a camera whose rows are exposed one after the other.
//!
//! The image's stamp is the middle row's. Row `v` is exposed `(v − (height − 1)/2) · readout / height` later, so that the
//! pixel depends on a time that depends on the pixel: solved by Newton's method with the motion's analytic derivative.

use nalgebra::{Matrix2x3, Matrix2x6, Matrix3x6, Vector2, Vector3, Vector6};

use crate::{Camera, Se3, so3};

/// Motion of a camera around the time of an image: constant twist in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraMotion {
    /// Pose at the image's stamp.
    pub world_from_camera: Se3,
    /// `[angular, linear]` velocity in the camera frame, rad/s and m/s: `world_from_camera(t) = … * exp(t · twist)`.
    pub twist_in_camera: Vector6<f64>,
}

/// Where and when a rolling-shutter camera sees a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RollingProjection {
    /// Pixel.
    pub pixel: Vector2<f64>,
    /// When its row is exposed, after the image's stamp, seconds.
    pub row_time_s: f64,
    /// Derivative of the pixel by the point in the world, pixels per metre.
    pub pixel_by_point: Matrix2x3<f64>,
    /// Derivative of the pixel by a right perturbation of `world_from_camera` at the stamp.
    pub pixel_by_pose: Matrix2x6<f64>,
    /// Derivative of the pixel by the readout time, pixels per second.
    pub pixel_by_readout: Vector2<f64>,
}

/// When row `row_px` is exposed, after the image's stamp, seconds.
pub fn row_time_s(camera: &Camera, readout_s: f64, row_px: f64) -> f64 {
    readout_s * row_share(camera, row_px)
}

fn row_share(camera: &Camera, row_px: f64) -> f64 {
    let height = f64::from(camera.height);
    (row_px - 0.5 * (height - 1.0)) / height
}

/// Newton's steps at most; each squares the error.
const MAX_STEPS: usize = 20;

/// Sees a point with a camera in motion. `None` where the camera does not see it, and where the motion is so fast that the
/// row does not settle (the image of the point overtakes the shutter).
///
/// `readout_s` is the time from the first row to one row below the last; negative where rows are read upwards, zero for a
/// global shutter.
pub fn project(
    camera: &Camera,
    readout_s: f64,
    motion: &CameraMotion,
    point_in_world: &Vector3<f64>,
) -> Option<RollingProjection> {
    let angular: Vector3<f64> = motion.twist_in_camera.fixed_rows::<3>(0).into();
    let linear: Vector3<f64> = motion.twist_in_camera.fixed_rows::<3>(3).into();
    let at_stamp = motion.world_from_camera.inverse() * *point_in_world;
    let mut time_s = 0.0;
    for _ in 0..MAX_STEPS {
        let motion_so_far = Se3::exp(&(motion.twist_in_camera * time_s));
        let p = motion_so_far.inverse() * at_stamp;
        let projection = camera.project_with_jacobian(&p)?;
        // The world moves past the camera with the opposite twist.
        let pixel_by_time = projection.pixel_by_point * -(linear + angular.cross(&p));
        let per_row = readout_s / f64::from(camera.height);
        let slope = 1.0 - per_row * pixel_by_time.y;
        if !(slope > 0.05) {
            return None;
        }
        let step = (row_time_s(camera, readout_s, projection.pixel.y) - time_s) / slope;
        if step.abs() <= 1e-13 {
            let rotation = motion_so_far.rotation_matrix().transpose();
            let by_stamp_point = projection.pixel_by_point * rotation;
            let by_world_point =
                by_stamp_point * motion.world_from_camera.rotation_matrix().transpose();
            // A right perturbation of the pose moves the point at the stamp by −[ρ + φ × p].
            let mut point_by_pose = Matrix3x6::zeros();
            point_by_pose
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&so3::hat(&at_stamp));
            point_by_pose
                .fixed_view_mut::<3, 3>(0, 3)
                .fill_diagonal(-1.0);
            let share = row_share(camera, projection.pixel.y);
            return Some(RollingProjection {
                pixel: projection.pixel,
                row_time_s: time_s,
                pixel_by_point: through_time(by_world_point, &pixel_by_time, per_row, slope),
                pixel_by_pose: through_time(
                    by_stamp_point * point_by_pose,
                    &pixel_by_time,
                    per_row,
                    slope,
                ),
                pixel_by_readout: pixel_by_time * (share / slope),
            });
        }
        time_s += step;
    }
    None
}

/// Adds to a derivative at fixed time what the row's own time contributes.
fn through_time<const N: usize>(
    direct: nalgebra::SMatrix<f64, 2, N>,
    pixel_by_time: &Vector2<f64>,
    per_row: f64,
    slope: f64,
) -> nalgebra::SMatrix<f64, 2, N> {
    let row = direct.row(1) * (per_row / slope);
    direct + pixel_by_time * row
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Lens;
    use proptest::prelude::*;

    fn phone() -> Camera {
        Camera {
            width: 640,
            height: 480,
            lens: Lens::PinholeRadtan {
                focal_px: [520.0, 521.0],
                principal_px: [322.0, 241.0],
                distortion: [0.08, -0.12, 1e-3, -5e-4, 0.0],
            },
        }
    }

    proptest! {
        #[test]
        fn the_row_is_seen_at_its_own_time(
            twist in prop::array::uniform6(-1.0..1.0f64), pose in prop::array::uniform6(-1.5..1.5f64),
            point in prop::array::uniform3(-0.4..0.4f64), depth in 1.0..8.0f64,
        ) {
            let camera = phone();
            let readout_s = 0.03;
            let motion = CameraMotion {
                world_from_camera: Se3::exp(&Vector6::from(pose)),
                twist_in_camera: Vector6::from(twist),
            };
            let in_camera = Vector3::new(point[0], point[1], 1.0) * depth;
            let world = motion.world_from_camera * in_camera;
            let Some(seen) = project(&camera, readout_s, &motion, &world) else { return Ok(()) };
            prop_assert!((seen.row_time_s - row_time_s(&camera, readout_s, seen.pixel.y)).abs() < 1e-12);
            let then = motion.world_from_camera * Se3::exp(&(motion.twist_in_camera * seen.row_time_s));
            let pixel = camera.project(&(then.inverse() * world)).expect("seen");
            prop_assert!((pixel - seen.pixel).norm() < 1e-9);

            let again = |motion: &CameraMotion, readout_s, world: &Vector3<f64>| {
                project(&camera, readout_s, motion, world).map(|s| s.pixel)
            };
            let h = 1e-6;
            for axis in 0..6 {
                let moved = |step: f64| {
                    let mut delta = Vector6::zeros();
                    delta[axis] = step;
                    let pose = motion.world_from_camera * Se3::exp(&delta);
                    again(&CameraMotion { world_from_camera: pose, ..motion }, readout_s, &world)
                };
                let (Some(a), Some(b)) = (moved(h), moved(-h)) else { return Ok(()) };
                prop_assert!(((a - b) / (2.0 * h) - seen.pixel_by_pose.column(axis)).norm() < 2e-3);
            }
            for axis in 0..3 {
                let moved = |step: f64| {
                    let mut world = world;
                    world[axis] += step;
                    again(&motion, readout_s, &world)
                };
                let (Some(a), Some(b)) = (moved(h), moved(-h)) else { return Ok(()) };
                prop_assert!(((a - b) / (2.0 * h) - seen.pixel_by_point.column(axis)).norm() < 2e-3);
            }
            let (Some(a), Some(b)) = (again(&motion, readout_s + h, &world), again(&motion, readout_s - h, &world)) else { return Ok(()) };
            prop_assert!(((a - b) / (2.0 * h) - seen.pixel_by_readout).norm() < 2e-3);
        }

        #[test]
        fn without_readout_it_is_the_plain_projection(x in -0.4..0.4f64, y in -0.4..0.4f64) {
            let p = Vector3::new(x, y, 1.0);
            let motion = CameraMotion {
                world_from_camera: Se3::identity(),
                twist_in_camera: Vector6::repeat(0.7),
            };
            let seen = project(&phone(), 0.0, &motion, &p).expect("seen");
            prop_assert!((seen.pixel - phone().project(&p).expect("seen")).norm() < 1e-12);
            prop_assert_eq!(seen.row_time_s, 0.0);
        }
    }

    #[test]
    fn what_overtakes_the_shutter_is_refused() {
        let motion = CameraMotion {
            world_from_camera: Se3::identity(),
            // Pitching so that the image of a far point runs down faster than the rows.
            twist_in_camera: Vector6::new(60.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        };
        let point = Vector3::new(0.0, 0.1, 5.0);
        assert!(project(&phone(), 0.03, &motion, &point).is_none());
    }
}
