use std::sync::Arc;

use lsfb_geometry::{Camera, Matrix2x3, Matrix2x6, Matrix3, RigCamera, Se3, Vector2, Vector3};
use lsfb_perception::projection::by_pose_of_inverse;
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

/// A camera of a rig, as residuals share it.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservingCamera {
    camera: Camera,
    camera_from_rig: Se3,
    camera_from_rig_rotation: Matrix3<f64>,
}

/// Where a point of the world is seen, and how that changes.
pub(super) struct ProjectedPoint {
    pub pixel: Vector2<f64>,
    pub by_pose: Matrix2x6<f64>,
    pub by_point: Matrix2x3<f64>,
}

impl ObservingCamera {
    /// From the rig's description of it.
    pub fn new(camera: &RigCamera) -> Arc<Self> {
        let camera_from_rig = camera.rig_from_camera.inverse();
        Arc::new(Self {
            camera: camera.camera,
            camera_from_rig,
            camera_from_rig_rotation: camera_from_rig.rotation_matrix(),
        })
    }

    /// Size and lens.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Pose of the rig in the camera frame.
    pub fn camera_from_rig(&self) -> Se3 {
        self.camera_from_rig
    }

    /// Pixel of a point in the world; `None` behind the lens.
    pub fn project(
        &self,
        world_from_rig: &Se3,
        point_in_world: &Vector3<f64>,
    ) -> Option<Vector2<f64>> {
        let point_in_rig = world_from_rig
            .rotation
            .inverse_transform_vector(&(point_in_world - world_from_rig.translation));
        self.camera.project(&(self.camera_from_rig * point_in_rig))
    }

    /// [`ObservingCamera::project`] with derivatives.
    #[inline]
    pub(super) fn see(
        &self,
        world_from_rig: &Se3,
        point_in_world: &Vector3<f64>,
    ) -> Result<ProjectedPoint, Undefined> {
        let rig_from_world = world_from_rig.rotation_matrix().transpose();
        let point_in_rig = rig_from_world * (point_in_world - world_from_rig.translation);
        let point_in_camera =
            self.camera_from_rig_rotation * point_in_rig + self.camera_from_rig.translation;
        let projection = self
            .camera
            .project_with_jacobian(&point_in_camera)
            .ok_or(Undefined)?;
        let by_point_in_rig = projection.pixel_by_point * self.camera_from_rig_rotation;
        Ok(ProjectedPoint {
            pixel: projection.pixel,
            by_pose: by_pose_of_inverse(&by_point_in_rig, &point_in_rig),
            by_point: by_point_in_rig * rig_from_world,
        })
    }
}

/// A point of the world seen by a camera of the rig. Blocks: pose `world_from_rig`, point.
///
/// `r = (π(T_CR T_WR⁻¹ X) − x) / σ`, with `p = T_WR⁻¹ X`, `Π = ∂π/∂p_C`:
/// `∂r/∂pose = Π R_CR [p]ₓ , −Π R_CR`; `∂r/∂X = Π R_CR R_WRᵀ`; all over σ. Undefined behind the lens.
#[derive(Clone, Debug)]
pub struct Reprojection {
    /// The camera.
    pub camera: Arc<ObservingCamera>,
    /// Where the point was seen.
    pub pixel: Vector2<f64>,
    /// Standard deviation of the pixel in each direction.
    pub sigma_px: f64,
}

impl Residual for Reprojection {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<Vector3<f64>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let world_from_rig: Se3 = parameters.get(0);
        let point: Vector3<f64> = parameters.get(1);
        let weight = 1.0 / self.sigma_px;
        if !(out.wants_jacobian(0) || out.wants_jacobian(1)) {
            let pixel = self
                .camera
                .project(&world_from_rig, &point)
                .ok_or(Undefined)?;
            out.set_residual(&((pixel - self.pixel) * weight));
            return Ok(());
        }
        let seen = self.camera.see(&world_from_rig, &point)?;
        out.set_residual(&((seen.pixel - self.pixel) * weight));
        out.set_jacobian(0, &(seen.by_pose * weight));
        out.set_jacobian(1, &(seen.by_point * weight));
        Ok(())
    }
}

#[cfg(test)]
pub(super) mod tests {
    use lsfb_geometry::{Vector6, camera::Lens};
    use lsfb_solver::{Kernel, Problem, SolveConfig, check_residual_jacobian, solve};

    use super::*;

    /// Two cameras that look forward (x of the rig), one with a wide lens.
    pub fn stereo() -> [Arc<ObservingCamera>; 2] {
        let forward = Se3::new(
            lsfb_geometry::UnitQuaternion::from_matrix(&Matrix3::new(
                0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0,
            )),
            Vector3::new(0.05, 0.06, 0.01),
        );
        let radtan = Camera {
            lens: Lens::PinholeRadtan {
                focal_px: [350.0, 352.0],
                principal_px: [320.0, 199.0],
                distortion: [-0.1, 0.02, 1e-3, -2e-3, 1e-3],
            },
            width: 640,
            height: 400,
        };
        let wide = Camera {
            lens: Lens::KannalaBrandt {
                focal_px: [280.0, 281.0],
                principal_px: [318.0, 201.0],
                distortion: [0.01, -0.02, 3e-3, -1e-3],
            },
            ..radtan
        };
        [radtan, wide].map(|camera| {
            ObservingCamera::new(&RigCamera {
                camera,
                rig_from_camera: forward * Se3::exp(&Vector6::new(0.02, 0.1, -0.05, 0.0, 0.1, 0.0)),
                timing: Default::default(),
                sigmas: Default::default(),
            })
        })
    }

    #[test]
    fn jacobians_match_differences() {
        let mut problem = Problem::new();
        let pose = problem.add_block(Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 1.0, 2.0, 0.5)));
        for camera in stereo() {
            for seen_at in [[100.0, 80.0], [320.0, 200.0], [600.0, 350.0]] {
                let pixel = Vector2::from(seen_at);
                let ray = camera.camera().unproject(&pixel).expect("inside the lens");
                let in_rig = camera.camera_from_rig().inverse() * (ray * 3.0);
                let point = problem.add_block(problem.value(pose) * in_rig);
                let residual = Reprojection {
                    camera: camera.clone(),
                    pixel: pixel + Vector2::new(1.0, -2.0),
                    sigma_px: 0.7,
                };
                problem
                    .add_residual(residual, &[pose.id(), point.id()], Kernel::Squared)
                    .expect("blocks fit");
            }
        }
        check_residual_jacobian!(all of problem);
    }

    #[test]
    fn two_views_triangulate() {
        let [_, camera] = stereo();
        let truth = Vector3::new(4.0, 0.3, -0.2);
        let mut problem = Problem::new();
        let point = problem.add_eliminated_point(truth + Vector3::new(0.5, -0.2, 0.3));
        for y in [0.0, 0.5] {
            let world_from_rig = Se3::new(Default::default(), Vector3::new(0.0, y, 0.0));
            let pose = problem.add_block(world_from_rig);
            problem.set_constant(pose);
            let residual = Reprojection {
                camera: camera.clone(),
                pixel: camera.project(&world_from_rig, &truth).expect("in front"),
                sigma_px: 1.0,
            };
            problem
                .add_residual(residual, &[pose.id(), point.id()], Kernel::Squared)
                .expect("blocks fit");
        }
        solve(&mut problem, &SolveConfig::default()).expect("solves");
        assert!((problem.value(point) - truth).norm() < 1e-6);
    }

    #[test]
    fn behind_the_camera_is_undefined() {
        let [radtan, _] = stereo();
        let mut problem = Problem::new();
        let pose = problem.add_block(Se3::identity());
        let point = problem.add_block(Vector3::new(-3.0, 0.0, 0.0));
        let residual = Reprojection {
            camera: radtan,
            pixel: Vector2::new(320.0, 200.0),
            sigma_px: 1.0,
        };
        problem
            .add_residual(residual, &[pose.id(), point.id()], Kernel::Squared)
            .expect("blocks fit");
        let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
        assert_eq!(report.undefined_at_start, 1);
    }
}
