use std::sync::Arc;

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

use super::moving_camera::{CameraCorrection, FrameMotion, MovingCamera};

/// A known point of the world, one of the HD map, seen by a camera of the rig in motion. Blocks: pose `world_from_rig` at the
/// stamp, correction of the camera.
///
/// `r = (π(X*) − x) / σ`, the first sum of eq. (5), from the pose of the row in which the point was seen; the derivatives are
/// those of [`MovingReprojection`](super::MovingReprojection). Undefined behind the lens.
#[derive(Clone, Debug)]
pub struct FixedPointReprojection {
    /// The camera, as the rig file has it.
    pub camera: Arc<MovingCamera>,
    /// Motion of the rig around the stamp.
    pub motion: FrameMotion,
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
        const { &[Shape::of::<Se3>(), Shape::of::<CameraCorrection>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (pose, correction): (Se3, CameraCorrection) = (parameters.get(0), parameters.get(1));
        let (row_px, point) = (self.pixel.y, &self.point_in_world);
        let camera = &self.camera;
        let sight = camera.sight(&pose, &self.motion, &correction, row_px, point);
        sight.reproject(&self.pixel, self.sigma_px, out)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use lsfb_solver::{Kernel, Problem, SolveConfig, check_residual_jacobian, solve};

    use super::super::moving_camera::tests::{correction, motion, phone, pose, sights};
    use super::*;

    #[test]
    fn known_points_fix_the_pose() {
        let mut problem = Problem::new();
        let found = problem.add_block(pose() * Se3::exp(&Vector6::repeat(0.02)));
        let known = problem.add_block(correction());
        problem.set_constant(known);
        for (point_in_world, pixel) in sights() {
            let residual = FixedPointReprojection {
                camera: phone(),
                motion: motion(),
                point_in_world,
                pixel,
                sigma_px: 0.7,
            };
            problem
                .add_residual(residual, &[found.id(), known.id()], Kernel::Squared)
                .expect("blocks fit");
        }
        check_residual_jacobian!(all of problem);
        solve(&mut problem, &SolveConfig::default()).expect("solves");
        assert!((pose().inverse() * problem.value(found)).log().norm() < 1e-5);
    }
}
