//! Reprojection error of one corner of the target.
//!
//! `r = project(lens, camera_from_first · first_from_target · X) − x`, in pixels. Blocks: lens parameters, `camera_from_first`,
//! `first_from_target`.

use lsfb_geometry::camera::LensModel;
use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_perception::projection::moved_by_pose;
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::SVector;

use crate::projection::searched_camera;

pub(super) struct CornerResidual<const N: usize> {
    pub model: LensModel,
    pub size: [u32; 2],
    pub point_in_target: Vector3<f64>,
    pub pixel: Vector2<f64>,
}

impl<const N: usize> CornerResidual<N> {
    const SHAPES: [Shape; 3] = [
        Shape::of::<SVector<f64, N>>(),
        Shape::of::<Se3>(),
        Shape::of::<Se3>(),
    ];
}

impl<const N: usize> Residual for CornerResidual<N> {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        &Self::SHAPES
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let lens: SVector<f64, N> = parameters.get(0);
        let camera_from_first: Se3 = parameters.get(1);
        let first_from_target: Se3 = parameters.get(2);
        let camera = searched_camera(self.model, self.size, &lens)?;
        let in_first = first_from_target * self.point_in_target;
        let in_camera = camera_from_first * in_first;
        let seen = camera.project_full(&in_camera).ok_or(Undefined)?;
        out.set_residual(&(seen.pixel - self.pixel));
        out.set_jacobian(
            0,
            &seen.pixel_by_parameter.fixed_columns::<N>(0).into_owned(),
        );
        if out.wants_jacobian(1) {
            out.set_jacobian(
                1,
                &(seen.pixel_by_point * moved_by_pose(&camera_from_first, &in_first)),
            );
        }
        if out.wants_jacobian(2) {
            let rotated = seen.pixel_by_point * camera_from_first.rotation_matrix();
            out.set_jacobian(
                2,
                &(rotated * moved_by_pose(&first_from_target, &self.point_in_target)),
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Vector6;
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    #[test]
    fn jacobians_match_differences() {
        let mut problem = Problem::new();
        let lens = problem.add_block(SVector::<f64, 6>::from_column_slice(&[
            158.0, 158.5, 255.0, 254.0, -0.17, 0.59,
        ]));
        let turn = Vector6::new(0.1, -0.2, 0.05, 0.1, 0.02, 0.03);
        let extrinsic = problem.add_block(Se3::exp(&turn));
        let pose = problem.add_block(Se3::exp(&Vector6::new(0.3, 0.2, 0.1, -0.2, -0.1, 0.7)));
        for (x, y) in [(0.0, 0.0), (0.3, 0.1), (0.5, 0.5)] {
            let residual = CornerResidual::<6> {
                model: LensModel::DoubleSphere,
                size: [512, 512],
                point_in_target: Vector3::new(x, y, 0.0),
                pixel: Vector2::new(250.0, 200.0),
            };
            let blocks = [lens.id(), extrinsic.id(), pose.id()];
            problem
                .add_residual(residual, &blocks, Kernel::Squared)
                .expect("fits");
        }
        check_residual_jacobian!(all of problem, within 1e-6);
    }
}
