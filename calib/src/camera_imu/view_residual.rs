//! Reprojection errors of all corners of one view of a global shutter against the motion.
//!
//! With `t` the view's stamp plus the camera's offset and drift, the errors are
//! `e_i = (project(lens, camera_from_rig · R(t)ᵀ (X_i − p(t))) − x_i) / σ`. All corners depend on the motion through the six
//! components of one pose, so their derivative is `E D`: `E` by that pose, the lens and the board, with two rows per corner, and `D` by the
//! blocks. With `E = Q U` (QR) the residual `[Qᵀ e, ‖e − Q Qᵀ e‖]` has the derivative `[U D, 0]`: the same cost, gradient and
//! normal matrix in 21 rows, however many corners there are.
//!
//! Blocks: [`ORDER`] rotations, [`ORDER`] positions, `camera_from_rig`, the [`Clock`], the lens, the board's [`Bend`].

use lsfb_geometry::camera::{LensModel, MAX_PARAMETERS};
use lsfb_geometry::spline::{self, Weights};
use lsfb_geometry::{Camera, Matrix2x6, Se3, UnitQuaternion, Vector2, Vector3, so3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{DMatrix, SMatrix, SVector};

use super::bend::{BEND, Bend, bends};
use super::{Clock, ORDER};
use crate::projection::lens_camera;

/// The pose's components, the lens's and the board's.
const INNER: usize = 6 + MAX_PARAMETERS + BEND;
const ROWS: usize = INNER + 1;
type Rows<const N: usize> = SMatrix<f64, ROWS, N>;

pub(super) struct ViewResidual {
    pub model: LensModel,
    pub size: [u32; 2],
    /// Stamp of the view after the start of the first control point's segment, and the spacing, seconds.
    pub time_in_segment_s: f64,
    /// Stamp of the view after the time at which the offset holds, seconds.
    pub after_middle_s: f64,
    pub spacing_s: f64,
    /// Middle of the flat board.
    pub centre: Vector3<f64>,
    /// Corner in the flat target, where it is seen.
    pub corners: Vec<(Vector3<f64>, Vector2<f64>)>,
    pub inverse_sigma: f64,
}

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

impl Residual for ViewResidual {
    fn dimension(&self) -> usize {
        ROWS
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
        let camera = lens_camera(self.model, self.size, &lens);
        if camera.lens.problem().is_some() {
            return Err(Undefined);
        }
        let time_s = self.time_in_segment_s + clock.x + clock.y * self.after_middle_s;
        let weights = Weights::<ORDER>::at(time_s / self.spacing_s, self.spacing_s);
        let position = spline::position(&weights, &positions).ok_or(Undefined)?;
        let wanted = out.wants_jacobians();
        if !wanted {
            // Only the norm counts.
            let rotation = spline::rotation(&weights, &rotations).ok_or(Undefined)?;
            let target_from_rig = Se3::new(rotation.rotation, position.position);
            let mut residual = SVector::<f64, ROWS>::zeros();
            residual[0] = self
                .squares(
                    &camera,
                    &(camera_from_rig * target_from_rig.inverse()),
                    &bend,
                )?
                .sqrt();
            out.set_residual(&residual);
            return Ok(());
        }
        let rotation = spline::rotation_with_jacobians(&weights, &rotations).ok_or(Undefined)?;
        let target_from_rig = Se3::new(rotation.at.rotation, position.position);
        let inner = self.reduce(&camera, &camera_from_rig, &target_from_rig.inverse(), &bend)?;
        out.set_residual(&inner.residual);

        // The rig turned by φ and moved by ρ in its own frame: what the IMU's place in the camera does is the opposite.
        let by_turn: Rows<3> = inner.by_rig.fixed_columns::<3>(0).into_owned();
        let by_position = inner.by_rig.fixed_columns::<3>(3)
            * rotation
                .at
                .rotation
                .inverse()
                .to_rotation_matrix()
                .into_inner();
        for j in 0..ORDER {
            out.set_jacobian(j, &(by_turn * rotation.rotation_by_control[j]));
            out.set_jacobian(ORDER + j, &(by_position * weights.value[j]));
        }
        out.set_jacobian(2 * ORDER, &-inner.by_rig);
        let by_offset = by_turn * rotation.at.angular_velocity + by_position * position.velocity;
        let mut by_clock = Rows::<2>::zeros();
        by_clock.set_column(0, &by_offset);
        by_clock.set_column(1, &(by_offset * self.after_middle_s));
        out.set_jacobian(2 * ORDER + 1, &by_clock);
        out.set_jacobian(2 * ORDER + 2, &inner.by_lens);
        out.set_jacobian(2 * ORDER + 3, &inner.by_bend);
        Ok(())
    }
}

/// `[Qᵀ e, ‖e − Q Qᵀ e‖]` and `[U, 0]`, by columns.
struct Inner {
    residual: SVector<f64, ROWS>,
    /// By a right perturbation of `target_from_rig`.
    by_rig: Rows<6>,
    by_lens: Rows<MAX_PARAMETERS>,
    by_bend: Rows<BEND>,
}

impl ViewResidual {
    fn bent(&self, point: &Vector3<f64>, bend: &Bend) -> Vector3<f64> {
        point + bends(&(point - self.centre)) * bend
    }

    /// `‖e‖²`.
    fn squares(
        &self,
        camera: &Camera,
        camera_from_target: &Se3,
        bend: &Bend,
    ) -> Result<f64, Undefined> {
        let mut squares = 0.0;
        for (point, pixel) in &self.corners {
            let seen = camera
                .project(&(*camera_from_target * self.bent(point, bend)))
                .ok_or(Undefined)?;
            squares += (seen - pixel).norm_squared();
        }
        Ok(squares * self.inverse_sigma * self.inverse_sigma)
    }

    fn reduce(
        &self,
        camera: &Camera,
        camera_from_rig: &Se3,
        rig_from_target: &Se3,
        bend: &Bend,
    ) -> Result<Inner, Undefined> {
        // E and, as its last column, e.
        let mut table = DMatrix::<f64>::zeros((2 * self.corners.len()).max(ROWS), INNER + 1);
        let turn = camera_from_rig.rotation_matrix();
        let turn_of_board = rig_from_target.rotation_matrix();
        for (k, (point, pixel)) in self.corners.iter().enumerate() {
            let in_rig = *rig_from_target * self.bent(point, bend);
            let seen = camera
                .project_full(&(*camera_from_rig * in_rig))
                .ok_or(Undefined)?;
            let by_in_rig = seen.pixel_by_point * turn;
            let mut by_rig = Matrix2x6::zeros();
            by_rig
                .fixed_view_mut::<2, 3>(0, 0)
                .copy_from(&(by_in_rig * so3::hat(&in_rig)));
            by_rig.fixed_view_mut::<2, 3>(0, 3).copy_from(&-by_in_rig);
            let mut rows = table.fixed_rows_mut::<2>(2 * k);
            rows.fixed_columns_mut::<6>(0).copy_from(&by_rig);
            rows.fixed_columns_mut::<MAX_PARAMETERS>(6)
                .copy_from(&seen.pixel_by_parameter);
            let by_bend = (by_in_rig * turn_of_board) * bends(&(point - self.centre));
            rows.fixed_columns_mut::<BEND>(6 + MAX_PARAMETERS)
                .copy_from(&by_bend);
            rows.column_mut(INNER).copy_from(&(seen.pixel - pixel));
        }
        table *= self.inverse_sigma;
        make_triangular(&mut table);
        let mut residual = SVector::<f64, ROWS>::zeros();
        residual
            .fixed_rows_mut::<INNER>(0)
            .copy_from(&table.view((0, INNER), (INNER, 1)));
        residual[INNER] = table
            .view((INNER, INNER), (table.nrows() - INNER, 1))
            .norm();
        let mut triangle = SMatrix::<f64, ROWS, INNER>::zeros();
        triangle
            .fixed_rows_mut::<INNER>(0)
            .copy_from(&table.view((0, 0), (INNER, INNER)));
        Ok(Inner {
            residual,
            by_rig: triangle.fixed_columns::<6>(0).into_owned(),
            by_lens: triangle.fixed_columns::<MAX_PARAMETERS>(6).into_owned(),
            by_bend: triangle
                .fixed_columns::<BEND>(6 + MAX_PARAMETERS)
                .into_owned(),
        })
    }
}

/// Householder's reflections that make all columns but the last upper triangular, applied to the last one too.
fn make_triangular(table: &mut DMatrix<f64>) {
    let (rows, columns) = table.shape();
    let values = table.as_mut_slice();
    for k in 0..columns - 1 {
        let (done, rest) = values.split_at_mut((k + 1) * rows);
        let axis = &mut done[k * rows + k..];
        let norm = dot(axis, axis).sqrt();
        if norm == 0.0 {
            continue;
        }
        // The sign that does not cancel.
        let diagonal = if axis[0] > 0.0 { -norm } else { norm };
        axis[0] -= diagonal;
        let scale = 2.0 / dot(axis, axis);
        for column in rest.chunks_exact_mut(rows) {
            let column = &mut column[k..];
            let share = scale * dot(axis, column);
            for (c, a) in column.iter_mut().zip(&*axis) {
                *c -= share * a;
            }
        }
        axis.fill(0.0);
        axis[0] = diagonal;
    }
}

/// In sums side by side, none of which waits for another.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const SUMS: usize = 8;
    let (a, a_rest) = a.as_chunks::<SUMS>();
    let (b, b_rest) = b.as_chunks::<SUMS>();
    let mut sums = [0.0; SUMS];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    let rest = a_rest.iter().zip(b_rest).map(|(a, b)| a * b);
    rest.fold(sums.iter().sum(), |sum, product| sum + product)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_imu::corner_residual::CornerResidual;
    use lsfb_geometry::Vector6;
    use lsfb_geometry::camera::Lens;
    use lsfb_solver::{
        BlockId, DenseJacobian, Kernel, Problem, SolveConfig, dense_jacobian, solve,
    };

    const CENTRE: Vector3<f64> = Vector3::new(0.3, 0.2, 0.0);
    const LENS: Lens = Lens::KannalaBrandt {
        focal_px: [190.0, 191.0],
        principal_px: [255.0, 256.0],
        distortion: [0.003, 0.001, -0.002, 2e-4],
    };

    fn problem() -> (Problem, Vec<BlockId>) {
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
        let lens = SVector::from(LENS.parameters().values);
        let lens = problem.add_block::<SVector<f64, MAX_PARAMETERS>>(lens);
        let absent: Vec<usize> = (LENS.parameters().count..MAX_PARAMETERS).collect();
        problem
            .set_constant_components(lens, &absent)
            .expect("in the lens");
        blocks.push(lens.id());
        blocks.push(
            problem
                .add_block(Bend::new(3e-3, -8e-3, 2e-3, 1e-3, -2e-3, 4e-3))
                .id(),
        );
        (problem, blocks)
    }

    fn view(corners: Vec<(Vector3<f64>, Vector2<f64>)>) -> ViewResidual {
        ViewResidual {
            model: LENS.model(),
            size: [512, 512],
            time_in_segment_s: 0.007,
            after_middle_s: -2.0,
            spacing_s: 0.02,
            centre: CENTRE,
            corners,
            inverse_sigma: 5.0,
        }
    }

    fn points() -> impl Iterator<Item = Vector3<f64>> {
        (0..24).map(|k| Vector3::new(0.1 * f64::from(k % 6), 0.15 * f64::from(k / 6), 0.0))
    }

    #[test]
    fn same_cost_gradient_and_normal_matrix_as_single_corners() {
        let corners: Vec<_> = points()
            .enumerate()
            .map(|(k, p)| {
                (
                    p,
                    Vector2::new(250.0 + 4.0 * k as f64, 260.0 - 3.0 * k as f64),
                )
            })
            .collect();
        let (mut one, blocks) = problem();
        one.add_residual(view(corners.clone()), &blocks, Kernel::Squared)
            .expect("fits");
        let (mut many, mut blocks) = problem();
        let readout = many.add_block(nalgebra::Vector1::new(0.0));
        many.set_constant(readout);
        blocks.push(readout.id());
        for (point, pixel) in corners {
            let corner = CornerResidual {
                model: LENS.model(),
                size: [512, 512],
                time_in_segment_s: 0.007,
                after_middle_s: -2.0,
                spacing_s: 0.02,
                centre: CENTRE,
                point,
                pixel,
                inverse_sigma: 5.0,
            };
            many.add_residual(corner, &blocks, Kernel::Squared)
                .expect("fits");
        }
        let [a, b] = [&one, &many].map(|p| dense_jacobian(p).expect("small"));
        let close = |a: &DMatrix<f64>, b: &DMatrix<f64>| (a - b).norm() < 1e-9 * b.norm();
        let normal = |j: &DenseJacobian| j.matrix.transpose() * &j.matrix;
        let gradient = |j: &DenseJacobian| j.matrix.transpose() * &j.residual;
        // The blocks of both were added in one order.
        assert!(close(&normal(&a), &normal(&b)));
        assert!((gradient(&a) - gradient(&b)).norm() < 1e-9 * gradient(&b).norm());
        assert!((a.residual.norm() / b.residual.norm() - 1.0).abs() < 1e-12);
        // Without derivatives the norm is the same.
        let config = SolveConfig {
            max_iterations: 1,
            ..SolveConfig::default()
        };
        let [a, b] = [one, many].map(|mut p| solve(&mut p, &config).expect("solved").initial_cost);
        assert!((a / b - 1.0).abs() < 1e-12);
    }
}
