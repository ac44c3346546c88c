//! Reprojection errors of all corners of one view of a global shutter against the motion.
//!
//! With `t` the view's stamp plus the camera's offset and drift, the errors are
//! `e_i = (project(lens, camera_from_rig · R(t)ᵀ (X_i − p(t))) − x_i) / σ`. All corners depend on the motion through the six
//! components of one pose, so their derivative is `E D`: `E` by that pose, the lens and the board, with two rows per corner, and `D` by the
//! blocks. With `E = Q U` (QR) the residual `[Qᵀ e, ‖e − Q Qᵀ e‖]` has the derivative `[U D, 0]`: the same cost, gradient and
//! normal matrix in 21 rows, however many corners there are.
//!
//! Blocks: [`SHAPES`].

use lsfb_geometry::camera::MAX_PARAMETERS;
use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{DMatrix, DVectorView, SMatrix, SVector};

use super::bend::BEND;
use super::timed_view::{Derivatives, SHAPES, TimedView, Values};

/// The pose's components, the lens's and the board's.
const INNER: usize = 6 + MAX_PARAMETERS + BEND;
const ROWS: usize = INNER + 1;

pub(super) struct ViewResidual {
    pub view: TimedView,
    /// Corner in the flat target, where it is seen.
    pub corners: Vec<(Vector3<f64>, Vector2<f64>)>,
}

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
        let values = self.view.values(parameters)?;
        if !out.wants_jacobians() {
            // Only the norm counts.
            let mut residual = SVector::<f64, ROWS>::zeros();
            residual[0] = self.norm(&values)?;
            out.set_residual(&residual);
            return Ok(());
        }
        let motion = self.view.motion(&values, 0.0)?;
        let (residual, by) = self.reduce(&values, &motion.rig_from_target())?;
        out.set_residual(&residual);
        by.write(&self.view, &motion, out);
        Ok(())
    }
}

impl ViewResidual {
    /// `‖e‖`.
    fn norm(&self, values: &Values) -> Result<f64, Undefined> {
        let rig_from_target = self.view.rig_from_target(values)?;
        let mut squares = 0.0;
        for (point, pixel) in &self.corners {
            squares += (values.pixel(&rig_from_target, point)? - pixel).norm_squared();
        }
        let weight = self.view.inverse_sigma;
        Ok((squares * weight * weight).sqrt())
    }

    /// `[Qᵀ e, ‖e − Q Qᵀ e‖]` and `[U, 0]`, by columns.
    fn reduce(
        &self,
        values: &Values,
        rig_from_target: &Se3,
    ) -> Result<(SVector<f64, ROWS>, Derivatives<ROWS>), Undefined> {
        // E and, as its last column, e.
        let mut table = DMatrix::<f64>::zeros((2 * self.corners.len()).max(ROWS), INNER + 1);
        for (k, (point, pixel)) in self.corners.iter().enumerate() {
            let (seen, by) = values.see(rig_from_target, point)?;
            let mut rows = table.fixed_rows_mut::<2>(2 * k);
            rows.fixed_columns_mut::<6>(0).copy_from(&by.by_rig);
            rows.fixed_columns_mut::<MAX_PARAMETERS>(6)
                .copy_from(&by.by_lens);
            rows.fixed_columns_mut::<BEND>(6 + MAX_PARAMETERS)
                .copy_from(&by.by_bend);
            rows.column_mut(INNER).copy_from(&(seen - pixel));
        }
        table *= self.view.inverse_sigma;
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
        let derivatives = Derivatives {
            by_rig: triangle.fixed_columns::<6>(0).into_owned(),
            by_lens: triangle.fixed_columns::<MAX_PARAMETERS>(6).into_owned(),
            by_bend: triangle
                .fixed_columns::<BEND>(6 + MAX_PARAMETERS)
                .into_owned(),
        };
        Ok((residual, derivatives))
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

/// The vectors' own, not the strided columns' of a matrix: those take a seventh longer.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    DVectorView::from_slice(a, a.len()).dot(&DVectorView::from_slice(b, b.len()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_imu::corner_residual::CornerResidual;
    use crate::camera_imu::timed_view::tests::add_blocks;
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
        let blocks = add_blocks(&mut problem, &LENS);
        (problem, blocks)
    }

    fn view() -> TimedView {
        TimedView {
            model: LENS.model(),
            size: [512, 512],
            time_in_segment_s: 0.007,
            after_middle_s: -2.0,
            spacing_s: 0.02,
            centre: CENTRE,
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
        let whole = ViewResidual {
            view: view(),
            corners: corners.clone(),
        };
        one.add_residual(whole, &blocks, Kernel::Squared)
            .expect("fits");
        let (mut many, mut blocks) = problem();
        let readout = many.add_block(nalgebra::Vector1::new(0.0));
        many.set_constant(readout);
        blocks.push(readout.id());
        for (point, pixel) in corners {
            let corner = CornerResidual {
                view: view(),
                point,
                pixel,
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
