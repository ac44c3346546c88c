//! What residuals of a board's corners share where the rig moves on the spline: where a view lies in time, and how corners move with the
//! rig's pose, the lens and the board.

use lsfb_geometry::camera::{LensModel, MAX_PARAMETERS};
use lsfb_geometry::spline::{self, SplinePosition, SplineRotationJacobians, Weights};
use lsfb_geometry::{Camera, Se3, UnitQuaternion, Vector2, Vector3};
use lsfb_perception::projection::by_pose_of_inverse;
use lsfb_solver::{Linearization, Parameters, Shape, Undefined};
use nalgebra::{RowVector2, SMatrix, SVector};

use super::bend::{BEND, Bend, bends, bent};
use super::{Clock, ORDER};
use crate::projection::searched_camera;

/// [`ORDER`] rotations, [`ORDER`] positions, `camera_from_rig`, the [`Clock`], the lens, the board's [`Bend`].
pub(super) const SHAPES: [Shape; 2 * ORDER + 4] = {
    let mut shapes = [Shape::of::<UnitQuaternion<f64>>(); 2 * ORDER + 4];
    let mut k = ORDER;
    while k < 2 * ORDER {
        shapes[k] = Shape::of::<Vector3<f64>>();
        k += 1;
    }
    shapes[2 * ORDER] = Shape::of::<Se3>();
    shapes[2 * ORDER + 1] = Shape::of::<Clock>();
    shapes[2 * ORDER + 2] = Shape::of::<SVector<f64, MAX_PARAMETERS>>();
    shapes[2 * ORDER + 3] = Shape::of::<Bend>();
    shapes
};

/// A view of the board.
#[derive(Clone, Copy)]
pub(super) struct TimedView {
    pub model: LensModel,
    pub size: [u32; 2],
    /// Stamp of the view after the start of the first control point's segment, and the spacing, seconds.
    pub time_in_segment_s: f64,
    /// Stamp of the view after the time at which the offset holds, seconds.
    pub after_middle_s: f64,
    pub spacing_s: f64,
    /// Middle of the flat board.
    pub centre: Vector3<f64>,
    pub inverse_sigma: f64,
}

/// The values of the blocks.
pub(super) struct Values {
    rotations: [UnitQuaternion<f64>; ORDER],
    positions: [Vector3<f64>; ORDER],
    camera_from_rig: Se3,
    clock: Clock,
    pub camera: Camera,
    bend: Bend,
    centre: Vector3<f64>,
}

/// The rig on the spline, at one time.
pub(super) struct Motion {
    weights: Weights<ORDER>,
    rotation: SplineRotationJacobians<ORDER>,
    position: SplinePosition,
}

/// How `R` numbers move with a view's pose, lens and board.
pub(super) struct Derivatives<const R: usize> {
    /// By a right perturbation of `target_from_rig`.
    pub by_rig: SMatrix<f64, R, 6>,
    pub by_lens: SMatrix<f64, R, MAX_PARAMETERS>,
    pub by_bend: SMatrix<f64, R, BEND>,
}

impl TimedView {
    /// Undefined where the lens is none.
    pub fn values(&self, parameters: &Parameters<'_>) -> Result<Values, Undefined> {
        let lens: SVector<f64, MAX_PARAMETERS> = parameters.get(2 * ORDER + 2);
        Ok(Values {
            rotations: std::array::from_fn(|k| parameters.get(k)),
            positions: std::array::from_fn(|k| parameters.get(ORDER + k)),
            camera_from_rig: parameters.get(2 * ORDER),
            clock: parameters.get(2 * ORDER + 1),
            camera: searched_camera(self.model, self.size, &lens)?,
            bend: parameters.get(2 * ORDER + 3),
            centre: self.centre,
        })
    }

    fn weights(&self, clock: &Clock, later_s: f64) -> Weights<ORDER> {
        let time_s = self.time_in_segment_s + clock.x + clock.y * self.after_middle_s + later_s;
        Weights::at(time_s / self.spacing_s, self.spacing_s)
    }

    /// `rig_from_target` at the view's stamp.
    pub fn rig_from_target(&self, values: &Values) -> Result<Se3, Undefined> {
        let weights = self.weights(&values.clock, 0.0);
        let rotation = spline::rotation(&weights, &values.rotations).ok_or(Undefined)?;
        let position = spline::position(&weights, &values.positions).ok_or(Undefined)?;
        Ok(Se3::new(rotation.rotation, position.position).inverse())
    }

    /// The same with its derivatives, so long after the stamp.
    pub fn motion(&self, values: &Values, later_s: f64) -> Result<Motion, Undefined> {
        let weights = self.weights(&values.clock, later_s);
        let rotation = spline::rotation_with_jacobians(&weights, &values.rotations);
        let position = spline::position(&weights, &values.positions);
        Ok(Motion {
            weights,
            rotation: rotation.ok_or(Undefined)?,
            position: position.ok_or(Undefined)?,
        })
    }
}

impl Motion {
    pub fn rig_from_target(&self) -> Se3 {
        Se3::new(self.rotation.at.rotation, self.position.position).inverse()
    }
}

impl Values {
    fn in_rig(&self, rig_from_target: &Se3, point: &Vector3<f64>) -> Vector3<f64> {
        *rig_from_target * bent(point, &self.centre, &self.bend)
    }

    /// Where a corner of the flat board is seen.
    pub fn pixel(
        &self,
        rig_from_target: &Se3,
        point: &Vector3<f64>,
    ) -> Result<Vector2<f64>, Undefined> {
        let in_camera = self.camera_from_rig * self.in_rig(rig_from_target, point);
        self.camera.project(&in_camera).ok_or(Undefined)
    }

    /// The same with derivatives.
    pub fn see(
        &self,
        rig_from_target: &Se3,
        point: &Vector3<f64>,
    ) -> Result<(Vector2<f64>, Derivatives<2>), Undefined> {
        let in_rig = self.in_rig(rig_from_target, point);
        let seen = self.camera.project_full(&(self.camera_from_rig * in_rig));
        let seen = seen.ok_or(Undefined)?;
        let by_in_rig = seen.pixel_by_point * self.camera_from_rig.rotation_matrix();
        let by_corner = by_in_rig * rig_from_target.rotation_matrix();
        let derivatives = Derivatives {
            by_rig: by_pose_of_inverse(&by_in_rig, &in_rig),
            by_lens: seen.pixel_by_parameter,
            by_bend: by_corner * bends(&(point - self.centre)),
        };
        Ok((seen.pixel, derivatives))
    }
}

impl<const R: usize> Derivatives<R> {
    /// Writes those by all blocks of [`SHAPES`]; returns those by the time.
    pub fn write(
        &self,
        view: &TimedView,
        motion: &Motion,
        out: &mut Linearization<'_>,
    ) -> SVector<f64, R> {
        let Motion {
            weights,
            rotation,
            position,
        } = motion;
        // The rig turned by φ and moved by ρ in its own frame: what the IMU's place in the camera does is the opposite.
        let by_turn = self.by_rig.fixed_columns::<3>(0).into_owned();
        let rig_from_target = rotation.at.rotation.inverse().to_rotation_matrix();
        let by_position = self.by_rig.fixed_columns::<3>(3) * rig_from_target.into_inner();
        for j in 0..ORDER {
            out.set_jacobian(j, &(by_turn * rotation.rotation_by_control[j]));
            out.set_jacobian(ORDER + j, &(by_position * weights.value[j]));
        }
        out.set_jacobian(2 * ORDER, &-self.by_rig);
        let by_time = by_turn * rotation.at.angular_velocity + by_position * position.velocity;
        let by_clock = by_time * RowVector2::new(1.0, view.after_middle_s);
        out.set_jacobian(2 * ORDER + 1, &by_clock);
        out.set_jacobian(2 * ORDER + 2, &self.by_lens);
        out.set_jacobian(2 * ORDER + 3, &self.by_bend);
        by_time
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use lsfb_geometry::camera::Lens;
    use lsfb_geometry::{Vector6, so3};
    use lsfb_solver::{BlockId, Problem};

    /// A rig that turns and moves, with all that is searched somewhat off.
    pub fn add_blocks(problem: &mut Problem, lens: &Lens) -> Vec<BlockId> {
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
        let parameters = lens.parameters();
        let values: SVector<f64, MAX_PARAMETERS> = parameters.values.into();
        let lens = problem.add_block(values);
        let absent: Vec<usize> = (parameters.count..MAX_PARAMETERS).collect();
        let held = problem.set_constant_components(lens, &absent);
        held.expect("in the lens");
        let bend = Bend::new(3e-3, -8e-3, 2e-3, 1e-3, -2e-3, 4e-3);
        blocks.extend([lens.id(), problem.add_block(bend).id()]);
        blocks
    }
}
