//! The board in the camera: pose and information from its corners.

use lsfb_geometry::{Camera, Matrix2x6, Matrix6, Se3};
use lsfb_perception::projection::moved_by_pose;
use lsfb_perception::statistics::median;
use lsfb_solver::gauss_newton::{NormalEquations, minimise, until_shorter_than};

use super::{InCamera, MountedBoard};
use crate::camera::pose_of_target;
use crate::detect::Corner;

/// Corners a pose needs.
const MIN_CORNERS: usize = 8;
const ITERATIONS: u32 = 20;
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
    let mut limit_px = f64::INFINITY;
    let mut fit = None;
    for _ in 0..2 {
        let found = fitted(board, camera, &known, pose, limit_px)?;
        pose = found.camera_from_board;
        let errors = known.iter().filter_map(|c| {
            Some((camera.project(&(pose * board.corner(c.index)))? - c.pixel).norm())
        });
        limit_px = OUTLIER_RATIO * median(errors.collect())?.max(LEAST_SIGMA_PX);
        fit = Some(found);
    }
    let fit = fit?;
    let freedom = (2 * fit.corners).checked_sub(6).filter(|n| *n > 0)? as f64;
    let sigma_px = (fit.squares / freedom).sqrt().max(LEAST_SIGMA_PX);
    Some(InCamera {
        camera_from_board: pose,
        information: fit.information / (sigma_px * sigma_px),
        rms_px: (fit.squares / fit.corners as f64).sqrt(),
    })
}

/// A pose with what its corners say of it.
struct Fit {
    camera_from_board: Se3,
    information: Matrix6<f64>,
    /// Sum over the corners used, pixels squared.
    squares: f64,
    corners: usize,
}

/// The pose at which corners that miss by no more than `limit_px` fit best.
fn fitted(
    board: &MountedBoard,
    camera: &Camera,
    corners: &[Corner],
    start: Se3,
    limit_px: f64,
) -> Option<Fit> {
    let (mut squares, mut used) = (0.0, 0);
    let terms = |pose: &Se3| {
        let mut terms = NormalEquations::default();
        (squares, used) = (0.0, 0);
        for corner in corners {
            let point = board.corner(corner.index);
            let Some(seen) = camera.project_with_jacobian(&(*pose * point)) else {
                continue;
            };
            let error = seen.pixel - corner.pixel;
            if error.norm() > limit_px {
                continue;
            }
            let by_pose: Matrix2x6<f64> = seen.pixel_by_point * moved_by_pose(pose, &point);
            terms.add_block(&error, &by_pose, 1.0);
            squares += error.norm_squared();
            used += 1;
        }
        Some(terms)
    };
    let found = minimise(start, ITERATIONS, terms, until_shorter_than(1e-10))?;
    Some(Fit {
        camera_from_board: found.value,
        information: found.information,
        squares,
        corners: used,
    })
}
