use std::sync::Arc;

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

use super::moving_camera::{CameraCorrection, FrameMotion, MovingCamera};

/// A point of the world seen by a camera of the rig in motion. Blocks: pose `world_from_rig` at the stamp, correction of
/// the camera, point.
///
/// `r = (π(X) − x) / σ` with the pose of the row in which the point was seen; derivatives at [`MovingCamera`]. The motion is
/// held: poses and biases change it by less than it matters over a readout. Undefined behind the lens.
#[derive(Clone, Debug)]
pub struct MovingReprojection {
    /// The camera, as the rig file has it.
    pub camera: Arc<MovingCamera>,
    /// Motion of the rig around the stamp.
    pub motion: FrameMotion,
    /// Where the point was seen.
    pub pixel: Vector2<f64>,
    /// Standard deviation of the pixel in each direction.
    pub sigma_px: f64,
}

impl Residual for MovingReprojection {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        const {
            &[
                Shape::of::<Se3>(),
                Shape::of::<CameraCorrection>(),
                Shape::of::<Vector3<f64>>(),
            ]
        }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (pose, correction): (Se3, CameraCorrection) = (parameters.get(0), parameters.get(1));
        let point: Vector3<f64> = parameters.get(2);
        let row_px = self.pixel.y;
        let camera = &self.camera;
        let sight = camera.sight(&pose, &self.motion, &correction, row_px, &point);
        if let Some(by_point) = sight.reproject(&self.pixel, self.sigma_px, out)? {
            out.set_jacobian(2, &by_point);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    use super::super::moving_camera::tests::{correction, motion, phone, pose, sights};
    use super::*;

    #[test]
    fn jacobians_match_differences() {
        let mut problem = Problem::new();
        let pose = problem.add_block(pose());
        let correction = problem.add_block(correction());
        for (point, pixel) in sights() {
            let point = problem.add_block(point);
            let residual = MovingReprojection {
                camera: phone(),
                motion: motion(),
                pixel: pixel + Vector2::new(1.0, -2.0),
                sigma_px: 0.7,
            };
            let blocks = [pose.id(), correction.id(), point.id()];
            problem
                .add_residual(residual, &blocks, Kernel::Squared)
                .expect("blocks fit");
        }
        check_residual_jacobian!(all of problem);
    }
}
