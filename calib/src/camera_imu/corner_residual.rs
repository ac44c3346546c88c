//! Reprojection error of one corner against the motion, each row of the image at its own time.
//!
//! `r = (project(lens, camera_from_rig · R(t)ᵀ (X − p(t))) − x) / σ` with `t` the view's stamp plus the camera's offset plus the
//! share of the readout time at which the corner's row is exposed. Blocks: [`timed_view::SHAPES`], the readout time.

use lsfb_geometry::rolling_shutter::row_time_s;
use lsfb_geometry::{Vector2, Vector3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::Vector1;

use super::timed_view::{self, Derivatives, TimedView};

pub(super) struct CornerResidual {
    pub view: TimedView,
    /// In the flat target.
    pub point: Vector3<f64>,
    pub pixel: Vector2<f64>,
}

const VIEW: usize = timed_view::SHAPES.len();

const SHAPES: [Shape; VIEW + 1] = {
    let mut shapes = [Shape::of::<Vector1<f64>>(); VIEW + 1];
    let mut k = 0;
    while k < VIEW {
        shapes[k] = timed_view::SHAPES[k];
        k += 1;
    }
    shapes
};

impl Residual for CornerResidual {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        &SHAPES
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let values = self.view.values(parameters)?;
        let readout: Vector1<f64> = parameters.get(VIEW);
        let row_share = row_time_s(&values.camera, 1.0, self.pixel.y);
        let motion = self.view.motion(&values, row_share * readout.x)?;
        let (pixel, by) = values.see(&motion.rig_from_target(), &self.point)?;
        let weight = self.view.inverse_sigma;
        out.set_residual(&((pixel - self.pixel) * weight));
        let by = Derivatives {
            by_rig: by.by_rig * weight,
            by_lens: by.by_lens * weight,
            by_bend: by.by_bend * weight,
        };
        let by_time = by.write(&self.view, &motion, out);
        out.set_jacobian(VIEW, &(by_time * row_share));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_imu::timed_view::tests::add_blocks;
    use lsfb_geometry::camera::Lens;
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    #[test]
    fn jacobians_match_differences() {
        let mut problem = Problem::new();
        let lens = Lens::PinholeRadtan {
            focal_px: [400.0, 401.0],
            principal_px: [320.0, 240.0],
            distortion: [-0.1, 0.02, 1e-3, 2e-3, 0.01],
        };
        let mut blocks = add_blocks(&mut problem, &lens);
        blocks.push(problem.add_block(Vector1::new(0.02)).id());
        for (x, y) in [(0.0, 0.0), (0.3, 0.2)] {
            let corner = CornerResidual {
                view: TimedView {
                    model: lens.model(),
                    size: [640, 480],
                    time_in_segment_s: 0.007,
                    after_middle_s: 3.0,
                    spacing_s: 0.02,
                    centre: Vector3::new(0.1, 0.1, 0.0),
                    inverse_sigma: 1.0,
                },
                point: Vector3::new(x, y, 0.0),
                pixel: Vector2::new(300.0 + 300.0 * x, 200.0 + 400.0 * y),
            };
            problem
                .add_residual(corner, &blocks, Kernel::Squared)
                .expect("fits");
        }
        check_residual_jacobian!(all of problem, within 1e-6);
    }
}
