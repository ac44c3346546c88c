use std::sync::Arc;

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

use super::ObservingCamera;

/// A known point of the world, one of the HD map, seen by a camera of the rig. Block: pose `world_from_rig`.
///
/// `r = (π(T_CR T_WR⁻¹ X*) − x) / σ`, the first sum of eq. (5); the derivative is that of
/// [`Reprojection`](super::Reprojection) by the pose. Undefined behind the lens.
#[derive(Clone, Debug)]
pub struct FixedPointReprojection {
    /// The camera.
    pub camera: Arc<ObservingCamera>,
    /// The known point.
    pub point_in_world: Vector3<f64>,
    /// Where it was seen.
    pub pixel: Vector2<f64>,
    /// Standard deviation of the pixel in each direction, the point's own uncertainty included.
    pub sigma_px: f64,
}

impl Residual for FixedPointReprojection {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let world_from_rig: Se3 = parameters.get(0);
        let seen = self.camera.see(&world_from_rig, &self.point_in_world)?;
        let weight = 1.0 / self.sigma_px;
        out.set_residual(&((seen.pixel - self.pixel) * weight));
        out.set_jacobian(0, &(seen.by_pose * weight));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use lsfb_solver::{Kernel, Problem, SolveConfig, check_residual_jacobian, solve};

    use super::*;
    use crate::residuals::reprojection::tests::stereo;

    #[test]
    fn known_points_fix_the_pose() {
        let truth = Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 1.0, 2.0, 0.5));
        let mut problem = Problem::new();
        let pose = problem.add_block(truth * Se3::exp(&Vector6::repeat(0.05)));
        for camera in stereo() {
            for seen_at in [[100.0, 80.0], [320.0, 300.0], [600.0, 50.0]] {
                let pixel = Vector2::from(seen_at);
                let ray = camera.camera().unproject(&pixel).expect("inside the lens");
                let in_rig = camera.camera_from_rig().inverse() * (ray * (2.0 + pixel.x * 0.01));
                let residual = FixedPointReprojection {
                    camera: camera.clone(),
                    point_in_world: truth * in_rig,
                    pixel,
                    sigma_px: 0.7,
                };
                problem
                    .add_residual(residual, &[pose.id()], Kernel::Cauchy { scale: 2.0 })
                    .expect("blocks fit");
            }
        }
        check_residual_jacobian!(all of problem);
        solve(&mut problem, &SolveConfig::default()).expect("solves");
        assert!((truth.inverse() * problem.value(pose)).log().norm() < 1e-6);
    }
}
