//! What the adjustment minimises: corners in images, and corners off the surfaces that the LiDAR saw.

use lsfb_geometry::{Camera, Matrix2x3, Se3, Vector2, Vector3, Vector6};
use lsfb_perception::projection::by_pose_of_inverse;
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::Vector1;

/// Nearest that a corner may be to the camera, metres.
const NEAREST_M: f64 = 0.1;

/// A corner in an image, `r = (π((T exp(v τ) E)⁻¹ X) − x) / σ`, where `T` is the LiDAR's pose at the image's stamp, `v` how fast that
/// changes, `τ` what is to be added to the stamp, and `E` the camera's pose on the LiDAR. Blocks: `E`, `τ`, `T`, `X`.
pub(super) struct CornerResidual {
    pub camera: Camera,
    /// Of the LiDAR, perturbed on the right, per second.
    pub twist: Vector6<f64>,
    pub pixel: Vector2<f64>,
    pub sigma_px: f64,
}

/// A corner on a plane, `r = nᵀ(X − q) / σ`. Block: `X`.
pub(super) struct OnPlane {
    pub place: Vector3<f64>,
    pub normal: Vector3<f64>,
    pub sigma_m: f64,
}

/// Where a corner is seen, pixels, and how that moves with the corner.
pub(super) struct ProjectedCorner {
    pub pixel: Vector2<f64>,
    pub by_corner: Matrix2x3<f64>,
    by_camera: Matrix2x3<f64>,
    by_lidar: Matrix2x3<f64>,
    in_camera: Vector3<f64>,
    in_lidar: Vector3<f64>,
}

impl ProjectedCorner {
    /// `None` behind the lens, or too near.
    pub fn new(
        camera: &Camera,
        lidar_from_camera: &Se3,
        world_from_lidar: &Se3,
        corner: &Vector3<f64>,
    ) -> Option<Self> {
        let in_lidar = world_from_lidar.inverse() * *corner;
        let in_camera = lidar_from_camera.inverse() * in_lidar;
        if in_camera.z < NEAREST_M {
            return None;
        }
        let projected = camera.project_with_jacobian(&in_camera)?;
        let by_camera = projected.pixel_by_point;
        let by_lidar = by_camera * lidar_from_camera.rotation_matrix().transpose();
        Some(Self {
            pixel: projected.pixel,
            by_corner: by_lidar * world_from_lidar.rotation_matrix().transpose(),
            by_camera,
            by_lidar,
            in_camera,
            in_lidar,
        })
    }
}

impl Residual for CornerResidual {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        const {
            &[
                Shape::of::<Se3>(),
                Shape::of::<Vector1<f64>>(),
                Shape::of::<Se3>(),
                Shape::of::<Vector3<f64>>(),
            ]
        }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (lidar_from_camera, delay_s): (Se3, Vector1<f64>) =
            (parameters.get(0), parameters.get(1));
        let (at_stamp, corner): (Se3, Vector3<f64>) = (parameters.get(2), parameters.get(3));
        let moved = Se3::exp(&(self.twist * delay_s.x));
        let world_from_lidar = at_stamp * moved;
        let seen =
            ProjectedCorner::new(&self.camera, &lidar_from_camera, &world_from_lidar, &corner)
                .ok_or(Undefined)?;
        let weight = 1.0 / self.sigma_px;
        out.set_residual(&((seen.pixel - self.pixel) * weight));
        let by_mounting = by_pose_of_inverse(&seen.by_camera, &seen.in_camera);
        let by_pose = by_pose_of_inverse(&seen.by_lidar, &seen.in_lidar);
        out.set_jacobian(0, &(by_mounting * weight));
        out.set_jacobian(1, &(by_pose * self.twist * weight));
        out.set_jacobian(2, &(by_pose * moved.inverse().adjoint() * weight));
        out.set_jacobian(3, &(seen.by_corner * weight));
        Ok(())
    }
}

impl Residual for OnPlane {
    fn dimension(&self) -> usize {
        1
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Vector3<f64>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let corner: Vector3<f64> = parameters.get(0);
        let across = self.normal.transpose() / self.sigma_m;
        out.set_residual(&(across * (corner - self.place)));
        out.set_jacobian(0, &across);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    use super::*;

    #[test]
    fn jacobians_match_differences() {
        let mut problem = Problem::new();
        let mounted = problem.add_block(Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 0.1, 0.2, -0.1)));
        let delay = problem.add_block(Vector1::new(0.03));
        let pose = problem.add_block(Se3::exp(&Vector6::new(-0.2, 0.1, 0.2, 1.0, 0.5, 0.2)));
        let in_camera = Vector3::new(0.4, -0.3, 2.5);
        let world_from_camera = problem.value(pose) * problem.value(mounted);
        let corner = problem.add_block(world_from_camera * in_camera);
        let residual = CornerResidual {
            camera: Camera::pinhole(640, 400, [350.0, 340.0], [319.5, 199.5]),
            twist: Vector6::new(0.4, 0.2, -0.3, 0.9, 0.5, -0.6),
            pixel: Vector2::new(300.0, 180.0),
            sigma_px: 0.3,
        };
        let blocks = [mounted.id(), delay.id(), pose.id(), corner.id()];
        problem
            .add_residual(residual, &blocks, Kernel::Squared)
            .expect("blocks fit");
        let plane = OnPlane {
            place: Vector3::new(0.3, 0.2, 0.1),
            normal: Vector3::new(0.6, 0.0, 0.8),
            sigma_m: 0.02,
        };
        problem
            .add_residual(plane, &[corner.id()], Kernel::Squared)
            .expect("blocks fit");
        check_residual_jacobian!(all of problem, within 1e-6);
    }
}
