//! Whether scans and images are of one time, from boards that moved.
//!
//! A board with velocity `ξ` (in its own axes) whose scan is stamped `τ` late was measured where it had been `τ` before: its
//! plane misses by `(∂r/∂B) ξ τ`. What an error of the transform explains, which all poses share, is found along with it.

use nalgebra::{SMatrix, SVector};

use super::Scene;
use super::residuals::{PlaneResidual, facing};
use super::solved::Solved;

/// By how much the LiDAR's stamps are late.
#[derive(Clone, Copy, Debug)]
pub(super) struct Late {
    pub seconds: f64,
    pub sigma_s: f64,
}

/// Poses in motion that are needed.
const MIN_MOVING: usize = 6;

/// `None` with few boards in motion.
pub(super) fn lidar_late(scenes: &[Scene], solved: &Solved) -> Option<Late> {
    let mut normal = SMatrix::<f64, 7, 7>::zeros();
    let mut right = SVector::<f64, 7>::zeros();
    let (mut squares, mut rows, mut moving) = (0.0, 0.0, 0);
    for u in &solved.used {
        let scene = &scenes[u.scene];
        let twist = scene.track.twist();
        moving += usize::from(twist.is_some());
        // Where the camera alone has the board: the adjusted one has moved towards the LiDAR's.
        let pose = solved.camera_from_lidar.inverse() * scene.in_camera.camera_from_board;
        let plane = &u.fit.plane;
        let Ok((mut value, by_pose)) = PlaneResidual::parts(plane, &pose) else {
            continue;
        };
        value.z -= facing(plane) * solved.apparent_m.z;
        // As they were before clocks that differ made them look noisy: what is left says how noisy they are.
        let camera = scene.in_camera.information.try_inverse()?;
        let lidar = u.fit.information.try_inverse()?;
        let information = (lidar + by_pose * camera * by_pose.transpose()).try_inverse()?;
        let mut by = SMatrix::<f64, 3, 7>::zeros();
        by.fixed_columns_mut::<6>(0)
            .copy_from(&(-by_pose * pose.inverse().adjoint()));
        by.set_column(6, &(-by_pose * twist.unwrap_or_default()));
        normal += by.transpose() * information * by;
        right -= by.transpose() * information * value;
        squares += (value.transpose() * information * value)[0];
        rows += 3.0;
    }
    if moving < MIN_MOVING {
        return None;
    }
    let inverse = normal.try_inverse()?;
    let found = inverse * right;
    let left = (squares - right.dot(&found)).max(0.0) / f64::max(rows - 7.0, 1.0);
    Some(Late {
        seconds: found[6],
        sigma_s: (inverse[(6, 6)] * left.max(1.0)).sqrt(),
    })
}
