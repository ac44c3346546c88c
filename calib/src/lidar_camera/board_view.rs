//! The board in the camera: pose and information from its corners.

use lsfb_geometry::{Camera, Matrix3x6, Se3, so3};
use nalgebra::{Matrix6, SMatrix, Vector6};

use super::{InCamera, MountedBoard};
use crate::camera::pose_of_target;
use crate::detect::Corner;

/// Corners a pose needs.
const MIN_CORNERS: usize = 8;
const ITERATIONS: usize = 20;
/// Corners that miss by more than this many times the median are left out.
const OUTLIER_RATIO: f64 = 5.0;
/// Smallest spread of corners that is believed, pixels: lens and board are never better.
const LEAST_SIGMA_PX: f64 = 0.05;

/// Pose of the board; `None` with too few corners. The information is in units of the corners' own spread.
pub(super) fn view(board: &MountedBoard, camera: &Camera, corners: &[Corner]) -> Option<InCamera> {
    let mut known: Vec<Corner> = corners
        .iter()
        .filter(|c| c.index < board.target.corner_count())
        .copied()
        .collect();
    // One order, whatever was given: sums of floats depend on it.
    known.sort_by_key(|c| c.index);
    if known.len() < MIN_CORNERS {
        return None;
    }
    let camera_from_target = pose_of_target(&board.target, camera, &known)?;
    let target_from_board = Se3::new(Default::default(), board.target.corner(0) - board.corner(0));
    let mut pose = camera_from_target * target_from_board;
    let mut limit = f64::INFINITY;
    let mut fit = None;
    for _ in 0..2 {
        fit = descend(board, camera, &known, &mut pose, limit);
        let mut errors: Vec<f64> = known
            .iter()
            .filter_map(|c| {
                Some((camera.project(&(pose * board.corner(c.index)))? - c.pixel).norm())
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        limit = OUTLIER_RATIO * errors.get(errors.len() / 2)?.max(LEAST_SIGMA_PX);
    }
    let (normal, squares, count) = fit?;
    let freedom = (2 * count).checked_sub(6).filter(|n| *n > 0)? as f64;
    let sigma_px = (squares / freedom).sqrt().max(LEAST_SIGMA_PX);
    Some(InCamera {
        camera_from_board: pose,
        information: normal / (sigma_px * sigma_px),
        rms_px: (squares / count as f64).sqrt(),
    })
}

/// Normal matrix, squares and number of corners at the minimum.
fn descend(
    board: &MountedBoard,
    camera: &Camera,
    corners: &[Corner],
    pose: &mut Se3,
    limit_px: f64,
) -> Option<(Matrix6<f64>, f64, usize)> {
    let mut result = None;
    for _ in 0..ITERATIONS {
        let mut normal = Matrix6::zeros();
        let mut right = Vector6::zeros();
        let (mut squares, mut count) = (0.0, 0);
        let turn = pose.rotation_matrix();
        for corner in corners {
            let point = board.corner(corner.index);
            let Some(seen) = camera.project_with_jacobian(&(*pose * point)) else {
                continue;
            };
            let error = seen.pixel - corner.pixel;
            if error.norm() > limit_px {
                continue;
            }
            let mut moved = Matrix3x6::zeros();
            moved
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&(-turn * so3::hat(&point)));
            moved.fixed_view_mut::<3, 3>(0, 3).copy_from(&turn);
            let j: SMatrix<f64, 2, 6> = seen.pixel_by_point * moved;
            normal += j.transpose() * j;
            right -= j.transpose() * error;
            squares += error.norm_squared();
            count += 1;
        }
        let step = normal.cholesky()?.solve(&right);
        result = Some((normal, squares, count));
        if step.norm() < 1e-10 {
            break;
        }
        *pose = *pose * Se3::exp(&step);
    }
    result
}
