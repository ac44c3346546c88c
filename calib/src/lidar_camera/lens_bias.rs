//! What a lens does to the pose that does not fit its own images: it turns every board as the camera sees it, each by another
//! angle, and all of them together by what looks like a turned camera.
//!
//! The pose goes with the lens that was given; how far it would move with the lens that the images have for themselves is how far it may
//! be off.

use lsfb_geometry::{Camera, Vector6};

use super::adjustment::adjust;
use super::association::Joined;
use super::solved::Solved;
use super::{LidarCameraConfig, MountedBoard, Scene, board_view, summary};

/// By how much the pose moves with that lens, as its tangent; zero where the lens that was given fits.
pub(super) fn lens_bias(
    board: &MountedBoard,
    name: &str,
    lens: &Camera,
    scenes: &mut [Scene],
    joined: &Joined,
    solved: &Solved,
    config: &LidarCameraConfig,
) -> Vector6<f64> {
    let own = summary::diagnosis(board, lens, scenes, solved).lens_of_its_own();
    let Some(own) = own else {
        return Vector6::zeros();
    };
    let given: Vec<_> = scenes
        .iter_mut()
        .map(|scene| {
            let seen = board_view::view(board, &own, scene.corners)?;
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
