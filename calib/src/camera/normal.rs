//! Covariances of lenses and camera poses, and what the views do not determine.

use lsfb_geometry::{Se3, Vector3, Vector6};
use lsfb_solver::Influence;
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix};

use super::adjustment::Solved;
use crate::Error;
use crate::board::Target;
use crate::projection::moved_by_pose;
use crate::residual_diagnosis::{Field, moved_by_field};
use crate::scatter::Scatter;

/// Covariances of the parameters, for a residual variance of one.
pub(super) struct Covariances {
    /// By camera: the lens parameters, then rotation and translation of its pose.
    pub by_camera: Vec<DMatrix<f64>>,
    /// All of them together; zero where the first camera's pose is, which is the frame of all.
    joint: DMatrix<f64>,
}

/// How much less surely parameters are known than the weights say, by camera and parameter.
pub(super) struct Doubt {
    /// Factors on standard deviations, as instants scatter.
    pub factors: Vec<f64>,
    /// By how much what the models of lens and board do not know would move them.
    pub bias: Vec<f64>,
}

impl Covariances {
    /// With what moves pixels beyond the models of lens and board, by camera; `variance` is that of a corner in one direction, px².
    pub fn doubts(
        &self,
        target: &Target,
        solved: &Solved,
        fields: &[Field],
        variance: f64,
    ) -> Vec<Doubt> {
        let instants = instants(target, solved, fields);
        let zero = DVector::zeros(self.joint.nrows());
        let gradient = instants.iter().fold(zero, |sum, (_, own)| sum + own);
        let step = -(&self.joint * gradient);
        let influences: Vec<Influence> = instants
            .iter()
            .map(|(normal, gradient)| Influence {
                shift: -(&self.joint * (gradient + normal * &step)),
                noise: &self.joint * normal * &self.joint * variance,
            })
            .collect();
        let scatter = Scatter::of_neighbours(&(&self.joint * variance), &influences);
        let factors = scatter.factors(step.len());
        let per_camera = (step.len() / self.by_camera.len().max(1)).max(1);
        let biases = step.as_slice().chunks(per_camera);
        let factors = factors.chunks(per_camera).map(<[f64]>::to_vec);
        let both = factors.zip(biases.map(<[f64]>::to_vec));
        both.map(|(factors, bias)| Doubt { factors, bias })
            .collect()
    }
}

/// Tangent dimension of a pose.
const POSE: usize = 6;
/// Eigenvalue of the scaled normal matrix below which a direction is not determined.
const SINGULAR: f64 = 1e-12;

/// Normal matrix and gradient of an instant with the target's pose eliminated.
type Instant = (DMatrix<f64>, DVector<f64>);

/// The normal matrix with the target's poses eliminated, inverted.
pub(super) fn covariances(target: &Target, solved: &Solved) -> Result<Covariances, Error> {
    let nothing = vec![Field::zeros(); solved.cameras.len()];
    let instants = instants(target, solved, &nothing);
    invert(&instants, solved)
}

/// Normal matrices where pixels are moved by what the models of lens and board do not know, by camera.
fn instants(target: &Target, solved: &Solved, fields: &[Field]) -> Vec<Instant> {
    let lens_count = solved
        .cameras
        .first()
        .map_or(0, |c| c.camera.lens.parameters().count);
    let per_camera = lens_count + POSE;
    let size = per_camera * solved.cameras.len();
    let [width, height] = target.corners_size();
    let centre = Vector3::new(0.5 * width, 0.5 * height, 0.0);
    let mut instants = Vec::with_capacity(solved.first_from_target.len());
    for (instant, pose) in &solved.first_from_target {
        let mut of_pose = Matrix6::<f64>::zeros();
        let mut coupling = DMatrix::<f64>::zeros(size, POSE);
        let mut normal = DMatrix::<f64>::zeros(size, size);
        let mut gradient = DVector::<f64>::zeros(size);
        let mut gradient_of_pose = Vector6::<f64>::zeros();
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
                let by_board = seen.pixel_by_point
                    * start.camera_from_first.rotation_matrix()
                    * pose.rotation_matrix();
                let place = (point - centre) / centre.amax().max(1e-9);
                let moved = moved_by_field(&start.camera, &seen.pixel, &by_board, &place);
                let error = seen.pixel + moved * fields[k] - corner.pixel;
                gradient
                    .rows_mut(at, per_camera)
                    .gemv_tr(1.0, &row, &error, 1.0);
                gradient_of_pose += by_pose.transpose() * error;
                of_pose += by_pose.transpose() * by_pose;
                let mut rows = coupling.rows_mut(at, per_camera);
                rows += row.transpose() * by_pose;
            }
        }
        let Some(inverse) = of_pose.try_inverse() else {
            continue;
        };
        normal -= &coupling * inverse * coupling.transpose();
        gradient -= &coupling * (inverse * gradient_of_pose);
        instants.push((normal, gradient));
    }
    instants
}

fn invert(instants: &[Instant], solved: &Solved) -> Result<Covariances, Error> {
    let lens_count = solved
        .cameras
        .first()
        .map_or(0, |c| c.camera.lens.parameters().count);
    let size = (lens_count + POSE) * solved.cameras.len();
    let mut normal = DMatrix::<f64>::zeros(size, size);
    for (of_instant, _) in instants {
        normal += of_instant;
    }
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
    let mut joint = DMatrix::zeros(size, size);
    for (i, row) in free.iter().enumerate() {
        for (j, column) in free.iter().enumerate() {
            joint[(*row, *column)] = covariance(i, j);
            if row / per_camera == column / per_camera {
                by_camera[row / per_camera][(row % per_camera, column % per_camera)] =
                    joint[(*row, *column)];
            }
        }
    }
    Ok(Covariances { by_camera, joint })
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
