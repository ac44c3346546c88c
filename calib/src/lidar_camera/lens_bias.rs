//! What a lens does to the pose that does not fit its own images: it turns every board as the camera sees it, each by another
//! angle, and all of them together by what looks like a turned camera.
//!
//! The pose goes with the lens that was given. How far it would move with the lens that the images have for themselves is how far it may
//! be off; and since each board is met differently, the pose is no better known than it scatters when one board after the other is left
//! out (jackknife: J. W. Tukey, 1958).

use lsfb_geometry::{Camera, Matrix6, Vector6};

use super::adjustment::adjust;
use super::association::Joined;
use super::solved::Solved;
use super::{LidarCameraConfig, MountedBoard, Scene, board_view, summary};
use crate::scatter::of_few;

/// Poses without which a scatter says nothing.
const MIN_LEFT_OUT: usize = 4;

/// Widens the covariance of the pose where the lens that was given does not fit.
pub(super) fn widen(
    board: &MountedBoard,
    name: &str,
    lens: &Camera,
    scenes: &mut [Scene],
    joined: &Joined,
    solved: &mut Solved,
    config: &LidarCameraConfig,
) {
    let own = summary::diagnosis(board, lens, scenes, solved).lens_of_its_own();
    let Some(own) = own else {
        return;
    };
    if let Some(variances) = jackknife(board, name, scenes, joined, solved, config) {
        let factors = Vector6::from_fn(|k, _| {
            let ratio = variances[k] / solved.covariance[(k, k)].max(f64::MIN_POSITIVE);
            ratio.max(1.0).sqrt()
        });
        let widened = |i: usize, j: usize| solved.covariance[(i, j)] * factors[i] * factors[j];
        solved.covariance = Matrix6::from_fn(widened);
    }
    let bias = lens_bias(board, name, &own, scenes, joined, solved, config);
    solved.covariance += bias * bias.transpose();
}

/// Variances of the pose's components by leaving out one board after the other; `None` with too few.
fn jackknife(
    board: &MountedBoard,
    name: &str,
    scenes: &[Scene],
    joined: &Joined,
    solved: &Solved,
    config: &LidarCameraConfig,
) -> Option<Vector6<f64>> {
    let without = |left_out: usize| {
        let mut patch = joined.patch.clone();
        patch[left_out] = None;
        let rest = Joined { patch, ..*joined };
        let found = adjust(board, name, scenes, &rest, config).ok()?;
        Some((solved.camera_from_lidar.inverse() * found.camera_from_lidar).log())
    };
    let found: Vec<Vector6<f64>> = solved
        .used
        .iter()
        .filter_map(|used| without(used.scene))
        .collect();
    if found.len() < MIN_LEFT_OUT {
        return None;
    }
    let count = found.len() as f64;
    let mean = found.iter().sum::<Vector6<f64>>() / count;
    let squares = found.iter().map(|one| (one - mean).map(|v| v * v));
    let freedom = count - 1.0;
    Some(squares.sum::<Vector6<f64>>() * (freedom / count * of_few(freedom)))
}

/// By how much the pose moves with the lens that the images have for themselves, as its tangent.
fn lens_bias(
    board: &MountedBoard,
    name: &str,
    own: &Camera,
    scenes: &mut [Scene],
    joined: &Joined,
    solved: &Solved,
    config: &LidarCameraConfig,
) -> Vector6<f64> {
    let given: Vec<_> = scenes
        .iter_mut()
        .map(|scene| {
            let seen = board_view::view(board, own, scene.corners)?;
            Some(std::mem::replace(&mut scene.in_camera, seen))
        })
        .collect();
    let moved = adjust(board, name, scenes, joined, config);
    for (scene, given) in scenes.iter_mut().zip(given) {
        if let Some(given) = given {
            scene.in_camera = given;
        }
    }
    moved.map_or_else(
        // Too few poses are left to say more.
        |_| Vector6::zeros(),
        |moved| (solved.camera_from_lidar.inverse() * moved.camera_from_lidar).log(),
    )
}
