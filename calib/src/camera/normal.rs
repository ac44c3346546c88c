//! Covariances of lenses and camera poses, and what the views do not determine.

use lsfb_geometry::Se3;
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix};

use super::adjustment::Solved;
use crate::Error;
use crate::board::Target;
use crate::projection::moved_by_pose;

/// Covariances of the parameters, for a residual variance of one.
pub(super) struct Covariances {
    /// By camera: the lens parameters, then rotation and translation of its pose.
    pub by_camera: Vec<DMatrix<f64>>,
}

/// Tangent dimension of a pose.
const POSE: usize = 6;
/// Eigenvalue of the scaled normal matrix below which a direction is not determined.
const SINGULAR: f64 = 1e-12;

/// The normal matrix with the target's poses eliminated, inverted.
pub(super) fn covariances(target: &Target, solved: &Solved) -> Result<Covariances, Error> {
    let lens_count = solved
        .cameras
        .first()
        .map_or(0, |c| c.camera.lens.parameters().count);
    let per_camera = lens_count + POSE;
    let size = per_camera * solved.cameras.len();
    let mut normal = DMatrix::<f64>::zeros(size, size);
    for (instant, pose) in &solved.first_from_target {
        let mut of_pose = Matrix6::<f64>::zeros();
        let mut coupling = DMatrix::<f64>::zeros(size, POSE);
        for (k, start) in solved.cameras.iter().enumerate() {
            let (Some(corners), Some(inliers)) = (
                start.views.views.get(instant),
                solved.inliers[k].get(instant),
            ) else {
                continue;
            };
            let at = k * per_camera;
            for (corner, _) in corners.iter().zip(inliers).filter(|(_, inlier)| **inlier) {
                let point = target.corner(corner.index);
                let in_first = *pose * point;
                let in_camera = start.camera_from_first * in_first;
                let Some(seen) = start.camera.project_full(&in_camera) else {
                    continue;
                };
                let by_extrinsic: SMatrix<f64, 2, 6> =
                    seen.pixel_by_point * moved_by_pose(&start.camera_from_first, &in_first);
                let by_pose: SMatrix<f64, 2, 6> = seen.pixel_by_point
                    * start.camera_from_first.rotation_matrix()
                    * moved_by_pose(pose, &point);
                let mut row = DMatrix::<f64>::zeros(2, per_camera);
                row.columns_mut(0, lens_count)
                    .copy_from(&seen.pixel_by_parameter.columns(0, lens_count));
                if k > 0 {
                    row.columns_mut(lens_count, POSE).copy_from(&by_extrinsic);
                }
                let mut block = normal.view_mut((at, at), (per_camera, per_camera));
                block += row.transpose() * &row;
                of_pose += by_pose.transpose() * by_pose;
                let mut rows = coupling.rows_mut(at, per_camera);
                rows += row.transpose() * by_pose;
            }
        }
        let Some(inverse) = of_pose.try_inverse() else {
            continue;
        };
        normal -= &coupling * inverse * coupling.transpose();
    }
    invert(&normal, solved, lens_count)
}

fn invert(normal: &DMatrix<f64>, solved: &Solved, lens_count: usize) -> Result<Covariances, Error> {
    let per_camera = lens_count + POSE;
    // The first camera's pose is the frame of all: its rows are empty.
    let free: Vec<usize> = (0..normal.nrows())
        .filter(|k| !(lens_count..per_camera).contains(k))
        .collect();
    let scale: Vec<f64> = free
        .iter()
        .map(|k| normal[(*k, *k)].max(1e-30).sqrt())
        .collect();
    let scaled = DMatrix::from_fn(free.len(), free.len(), |i, j| {
        normal[(free[i], free[j])] / (scale[i] * scale[j])
    });
    let eigen = scaled.symmetric_eigen();
    let weakest = eigen.eigenvalues.imin();
    if !(eigen.eigenvalues[weakest] > SINGULAR) {
        let direction: DVector<f64> = eigen.eigenvectors.column(weakest).into_owned();
        let row = free[direction.iamax()];
        let camera = &solved.cameras[row / per_camera];
        let names = camera.camera.lens.model().parameter_names();
        let name = names.get(row % per_camera).copied();
        return Err(Error::Undetermined {
            camera: camera.views.name.clone(),
            parameters: name.unwrap_or("its pose on the rig").to_owned(),
            advice: "show the target tilted by 30° about both of its axes, near and far, and in every part of the image",
        });
    }
    let covariance = |i: usize, j: usize| {
        let sum: f64 = (0..free.len())
            .map(|m| eigen.eigenvectors[(i, m)] * eigen.eigenvectors[(j, m)] / eigen.eigenvalues[m])
            .sum();
        sum / (scale[i] * scale[j])
    };
    let mut by_camera = vec![DMatrix::zeros(per_camera, per_camera); solved.cameras.len()];
    for (i, row) in free.iter().enumerate() {
        for (j, column) in free.iter().enumerate() {
            if row / per_camera == column / per_camera {
                by_camera[row / per_camera][(row % per_camera, column % per_camera)] =
                    covariance(i, j);
            }
        }
    }
    Ok(Covariances { by_camera })
}

/// Number of parameters that [`covariances`] is about, poses of the target included.
pub(super) fn parameter_count(solved: &Solved) -> usize {
    let lenses: usize = solved
        .cameras
        .iter()
        .map(|c| c.camera.lens.parameters().count)
        .sum();
    let poses: &std::collections::BTreeMap<i64, Se3> = &solved.first_from_target;
    lenses + POSE * (solved.cameras.len() - 1 + poses.len())
}
