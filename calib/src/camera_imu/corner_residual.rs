//! Reprojection error of one corner against the motion, each row of the image at its own time.
//!
//! `r = (project(lens, camera_from_rig · R(t)ᵀ (X − p(t))) − x) / σ` with `t` the view's stamp plus the camera's offset plus the
//! share of the readout time at which the corner's row is exposed. Blocks: [`ORDER`] rotations, [`ORDER`] positions,
//! `camera_from_rig`, the [`Clock`], the lens, the board's [`Bend`], the readout time.

use lsfb_geometry::camera::{LensModel, MAX_PARAMETERS};
use lsfb_geometry::rolling_shutter::row_time_s;
use lsfb_geometry::spline::{self, Weights};
use lsfb_geometry::{Se3, UnitQuaternion, Vector2, Vector3, so3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{RowVector2, SVector, Vector1};

use super::bend::{Bend, bends};
use super::{Clock, ORDER, view_residual};
use crate::projection::{lens_camera, moved_by_pose};

pub(super) struct CornerResidual {
    pub model: LensModel,
    pub size: [u32; 2],
    /// Stamp of the view after the start of the first control point's segment, and the spacing, seconds.
    pub time_in_segment_s: f64,
    /// Stamp of the view after the time at which the offset holds, seconds.
    pub after_middle_s: f64,
    pub spacing_s: f64,
    /// Middle of the flat board.
    pub centre: Vector3<f64>,
    /// In the flat target.
    pub point: Vector3<f64>,
    pub pixel: Vector2<f64>,
    pub inverse_sigma: f64,
}

const VIEW: usize = view_residual::SHAPES.len();

const SHAPES: [Shape; VIEW + 1] = {
    let mut shapes = [Shape::of::<Vector1<f64>>(); VIEW + 1];
    let mut k = 0;
    while k < VIEW {
        shapes[k] = view_residual::SHAPES[k];
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
        let rotations: [UnitQuaternion<f64>; ORDER] = std::array::from_fn(|k| parameters.get(k));
        let positions: [Vector3<f64>; ORDER] = std::array::from_fn(|k| parameters.get(ORDER + k));
        let camera_from_rig: Se3 = parameters.get(2 * ORDER);
        let clock: Clock = parameters.get(2 * ORDER + 1);
        let lens: SVector<f64, MAX_PARAMETERS> = parameters.get(2 * ORDER + 2);
        let bend: Bend = parameters.get(2 * ORDER + 3);
        let readout: Vector1<f64> = parameters.get(VIEW);
        let camera = lens_camera(self.model, self.size, &lens);
        if camera.lens.problem().is_some() {
            return Err(Undefined);
        }
        let row_share = row_time_s(&camera, 1.0, self.pixel.y);
        let offset_s = clock.x + clock.y * self.after_middle_s;
        let time_s = self.time_in_segment_s + offset_s + row_share * readout.x;
        let weights = Weights::<ORDER>::at(time_s / self.spacing_s, self.spacing_s);
        let rotation = spline::rotation_with_jacobians(&weights, &rotations).ok_or(Undefined)?;
        let position = spline::position(&weights, &positions).ok_or(Undefined)?;
        let rig_from_target = rotation.at.rotation.inverse().to_rotation_matrix();
        let bends = bends(&(self.point - self.centre));
        let point = self.point + bends * bend;
        let in_rig = rig_from_target * (point - position.position);
        let seen = camera
            .project_full(&(camera_from_rig * in_rig))
            .ok_or(Undefined)?;
        out.set_residual(&((seen.pixel - self.pixel) * self.inverse_sigma));
        let by_point = seen.pixel_by_point * self.inverse_sigma;
        let by_in_rig = by_point * camera_from_rig.rotation_matrix();
        let by_turn = by_in_rig * so3::hat(&in_rig);
        let by_position = -(by_in_rig * rig_from_target.matrix());
        for j in 0..ORDER {
            out.set_jacobian(j, &(by_turn * rotation.rotation_by_control[j]));
            out.set_jacobian(ORDER + j, &(by_position * weights.value[j]));
        }
        out.set_jacobian(
            2 * ORDER,
            &(by_point * moved_by_pose(&camera_from_rig, &in_rig)),
        );
        let by_time = by_turn * rotation.at.angular_velocity + by_position * position.velocity;
        let by_clock = by_time * RowVector2::new(1.0, self.after_middle_s);
        out.set_jacobian(2 * ORDER + 1, &by_clock);
        out.set_jacobian(
            2 * ORDER + 2,
            &(seen.pixel_by_parameter * self.inverse_sigma),
        );
        let by_board = by_in_rig * rig_from_target.matrix();
        out.set_jacobian(2 * ORDER + 3, &(by_board * bends));
        out.set_jacobian(VIEW, &(by_time * row_share));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Vector6;
    use lsfb_geometry::camera::Lens;
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    #[test]
    fn jacobians_match_differences() {
        let mut problem = Problem::new();
        let mut blocks = Vec::new();
        for k in 0..ORDER {
            let turn = Vector3::new(0.02, 0.05, -0.03) * k as f64;
            blocks.push(problem.add_block(so3::exp(&turn)).id());
        }
        for k in 0..ORDER {
            let place = Vector3::new(0.1, 0.2, -1.0 + 0.01 * k as f64);
            blocks.push(problem.add_block(place).id());
        }
        let pose = Se3::exp(&Vector6::new(0.1, -0.05, 0.02, 0.01, 0.02, 0.03));
        blocks.push(problem.add_block(pose).id());
        blocks.push(problem.add_block(Clock::new(0.003, 2e-4)).id());
        let lens = Lens::PinholeRadtan {
            focal_px: [400.0, 401.0],
            principal_px: [320.0, 240.0],
            distortion: [-0.1, 0.02, 1e-3, 2e-3, 0.01],
        };
        let values: SVector<f64, MAX_PARAMETERS> = lens.parameters().values.into();
        blocks.push(problem.add_block(values).id());
        blocks.push(
            problem
                .add_block(Bend::new(3e-3, -8e-3, 2e-3, 1e-3, -2e-3, 4e-3))
                .id(),
        );
        blocks.push(problem.add_block(Vector1::new(0.02)).id());
        for (x, y) in [(0.0, 0.0), (0.3, 0.2)] {
            let corner = CornerResidual {
                model: lens.model(),
                size: [640, 480],
                time_in_segment_s: 0.007,
                after_middle_s: 3.0,
                spacing_s: 0.02,
                centre: Vector3::new(0.1, 0.1, 0.0),
                point: Vector3::new(x, y, 0.0),
                pixel: Vector2::new(300.0 + 300.0 * x, 200.0 + 400.0 * y),
                inverse_sigma: 1.0,
            };
            problem
                .add_residual(corner, &blocks, Kernel::Squared)
                .expect("fits");
        }
        check_residual_jacobian!(all of problem, within 1e-6);
    }
}
