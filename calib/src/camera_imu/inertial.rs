//! What gyroscope and accelerometer say about the motion.
//!
//! A bias is a line between two control points `b₀`, `b₁`: `b(t) = (1 − s) b₀ + s b₁`.

use lsfb_geometry::spline::{self, Weights};
use lsfb_geometry::{Matrix3, UnitQuaternion, Vector3, so3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{SMatrix, SVector, Vector1};

use super::ORDER;

/// Errors of a triad's axes by rows: `M − 1`.
pub(super) type AxisErrors = SVector<f64, 9>;
/// Those by which the accelerometer's x axis leaves that of the rig, and its y axis the plane of x and y: `xy, xz, yz`.
pub(super) const TURNED: [usize; 3] = [1, 2, 5];

pub(super) fn triad_matrix(errors: &AxisErrors) -> Matrix3<f64> {
    Matrix3::identity() + Matrix3::from_row_slice(errors.as_slice())
}

/// How a triad's samples, `M v`, change with its axes; rows by what is known of them.
fn by_axes(of: &Vector3<f64>, inverse_sigma: &Vector3<f64>) -> SMatrix<f64, 3, 9> {
    let mut by = SMatrix::<f64, 3, 9>::zeros();
    for row in 0..3 {
        let of_row = of.transpose() * inverse_sigma[row];
        by.fixed_view_mut::<1, 3>(row, 3 * row).copy_from(&of_row);
    }
    by
}

/// `r = (M ω(t) + b(t) − z) / σ`. Blocks: [`ORDER`] rotations, two control points of the bias, [`AxisErrors`].
pub(super) struct Gyro {
    pub weights: Weights<ORDER>,
    /// Where between the two control points of the bias.
    pub bias_share: f64,
    pub measured: Vector3<f64>,
    /// By axis; 0 where the sample says nothing.
    pub inverse_sigma: Vector3<f64>,
}

const GYRO_SHAPES: [Shape; ORDER + 3] = {
    let mut shapes = [Shape::of::<UnitQuaternion<f64>>(); ORDER + 3];
    shapes[ORDER] = Shape::of::<Vector3<f64>>();
    shapes[ORDER + 1] = Shape::of::<Vector3<f64>>();
    shapes[ORDER + 2] = Shape::of::<AxisErrors>();
    shapes
};

impl Residual for Gyro {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        &GYRO_SHAPES
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let rotations: [UnitQuaternion<f64>; ORDER] = std::array::from_fn(|k| parameters.get(k));
        let (b0, b1): (Vector3<f64>, Vector3<f64>) =
            (parameters.get(ORDER), parameters.get(ORDER + 1));
        let axes: AxisErrors = parameters.get(ORDER + 2);
        let at = spline::rotation_with_jacobians(&self.weights, &rotations).ok_or(Undefined)?;
        let weight = Matrix3::from_diagonal(&self.inverse_sigma);
        let matrix = triad_matrix(&axes);
        let rate = at.at.angular_velocity;
        let bias = b0 + (b1 - b0) * self.bias_share;
        out.set_residual(&(weight * (matrix * rate + bias - self.measured)));
        let by_rate = weight * matrix;
        for (j, by_control) in at.angular_velocity_by_control.iter().enumerate() {
            out.set_jacobian(j, &(by_rate * by_control));
        }
        out.set_jacobian(ORDER, &(weight * (1.0 - self.bias_share)));
        out.set_jacobian(ORDER + 1, &(weight * self.bias_share));
        out.set_jacobian(ORDER + 2, &by_axes(&rate, &self.inverse_sigma));
        Ok(())
    }
}

/// `r = (M R(t − d)ᵀ (a(t − d) − g) + b(t) − z) / σ` with `d` the delay after the gyroscope. Blocks: [`ORDER`] rotations,
/// [`ORDER`] positions, two control points of the bias, gravity, [`AxisErrors`], the delay.
pub(super) struct Accelerometer {
    /// Stamp of the sample after the start of the first control point's segment, and the spacing, seconds.
    pub time_in_segment_s: f64,
    pub spacing_s: f64,
    /// Where between the two control points of the bias.
    pub bias_share: f64,
    pub measured: Vector3<f64>,
    /// By axis; 0 where the sample says nothing.
    pub inverse_sigma: Vector3<f64>,
}

const ACCELEROMETER_SHAPES: [Shape; 2 * ORDER + 5] = {
    let mut shapes = [Shape::of::<Vector3<f64>>(); 2 * ORDER + 5];
    let mut k = 0;
    while k < ORDER {
        shapes[k] = Shape::of::<UnitQuaternion<f64>>();
        k += 1;
    }
    shapes[2 * ORDER + 3] = Shape::of::<AxisErrors>();
    shapes[2 * ORDER + 4] = Shape::of::<Vector1<f64>>();
    shapes
};

/// Half the step over which accelerations are compared, seconds. They are parabolas, of which differences are exact.
const HALF_STEP_S: f64 = 1e-3;

impl Accelerometer {
    fn weights(&self, time_s: f64) -> Weights<ORDER> {
        Weights::at(time_s / self.spacing_s, self.spacing_s)
    }
}

impl Residual for Accelerometer {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        &ACCELEROMETER_SHAPES
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let rotations: [UnitQuaternion<f64>; ORDER] = std::array::from_fn(|k| parameters.get(k));
        let positions: [Vector3<f64>; ORDER] = std::array::from_fn(|k| parameters.get(ORDER + k));
        let [b0, b1, gravity]: [Vector3<f64>; 3] =
            std::array::from_fn(|k| parameters.get(2 * ORDER + k));
        let axes: AxisErrors = parameters.get(2 * ORDER + 3);
        let delay: Vector1<f64> = parameters.get(2 * ORDER + 4);
        let time_s = self.time_in_segment_s - delay.x;
        let weights = self.weights(time_s);
        let rotation = spline::rotation_with_jacobians(&weights, &rotations).ok_or(Undefined)?;
        let position = spline::position(&weights, &positions).ok_or(Undefined)?;
        let rig_from_target: Matrix3<f64> = rotation
            .at
            .rotation
            .inverse()
            .to_rotation_matrix()
            .into_inner();
        let force = rig_from_target * (position.acceleration - gravity);
        let weight = Matrix3::from_diagonal(&self.inverse_sigma);
        let by_force = weight * triad_matrix(&axes);
        let bias = b0 + (b1 - b0) * self.bias_share;
        out.set_residual(&(by_force * force + weight * (bias - self.measured)));
        let turned = by_force * so3::hat(&force);
        let moved = by_force * rig_from_target;
        for j in 0..ORDER {
            out.set_jacobian(j, &(turned * rotation.rotation_by_control[j]));
            out.set_jacobian(ORDER + j, &(moved * weights.acceleration[j]));
        }
        out.set_jacobian(2 * ORDER, &(weight * (1.0 - self.bias_share)));
        out.set_jacobian(2 * ORDER + 1, &(weight * self.bias_share));
        out.set_jacobian(2 * ORDER + 2, &-moved);
        out.set_jacobian(2 * ORDER + 3, &by_axes(&force, &self.inverse_sigma));
        if out.wants_jacobian(2 * ORDER + 4) {
            let acceleration = |weights: &Weights<ORDER>| -> Vector3<f64> {
                let terms = positions.iter().zip(weights.acceleration);
                terms.map(|(p, w)| p * w).sum()
            };
            let [before, after] =
                [-HALF_STEP_S, HALF_STEP_S].map(|step| acceleration(&self.weights(time_s + step)));
            let jerk = (after - before) / (2.0 * HALF_STEP_S);
            let force_rate = rig_from_target * jerk - rotation.at.angular_velocity.cross(&force);
            out.set_jacobian(2 * ORDER + 4, &-(by_force * force_rate));
        }
        Ok(())
    }
}

/// `r = (b₁ − b₀) / σ`: biases walk. Blocks: two neighbouring control points of a bias.
pub(super) struct BiasWalk {
    pub inverse_sigma: f64,
}

const WALK_SHAPES: [Shape; 2] = [Shape::of::<Vector3<f64>>(); 2];

impl Residual for BiasWalk {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        &WALK_SHAPES
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let (b0, b1): (Vector3<f64>, Vector3<f64>) = (parameters.get(0), parameters.get(1));
        out.set_residual(&((b1 - b0) * self.inverse_sigma));
        let by_end = Matrix3::identity() * self.inverse_sigma;
        out.set_jacobian(0, &-by_end);
        out.set_jacobian(1, &by_end);
        Ok(())
    }
}

/// `r = (‖g‖ − g₀) / σ`: gravity's magnitude is known. Block: gravity.
pub(super) struct GravityNorm {
    pub expected_m_s2: f64,
    pub inverse_sigma: f64,
}

const GRAVITY_SHAPES: [Shape; 1] = [Shape::of::<Vector3<f64>>()];

impl Residual for GravityNorm {
    fn dimension(&self) -> usize {
        1
    }

    fn blocks(&self) -> &[Shape] {
        &GRAVITY_SHAPES
    }

    fn evaluate(
        &self,
        parameters: &Parameters<'_>,
        out: &mut Linearization<'_>,
    ) -> Result<(), Undefined> {
        let gravity: Vector3<f64> = parameters.get(0);
        let norm = gravity.norm();
        if !(norm > 1e-6) {
            return Err(Undefined);
        }
        out.set_residual(&Vector1::new(
            (norm - self.expected_m_s2) * self.inverse_sigma,
        ));
        let by: SMatrix<f64, 1, 3> = (gravity / norm).transpose() * self.inverse_sigma;
        out.set_jacobian(0, &by);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    #[test]
    fn jacobians_match_differences() {
        let mut problem = Problem::new();
        let rotations: Vec<_> = (0..ORDER)
            .map(|k| {
                let turn = Vector3::new(0.02, 0.05, -0.03) * (k * k) as f64;
                problem.add_block(so3::exp(&turn)).id()
            })
            .collect();
        let positions: Vec<_> = (0..ORDER)
            .map(|k| {
                let place = Vector3::new(0.1, 2e-4 * (k * k * k) as f64, 1e-3 * (k * k) as f64);
                problem.add_block(place).id()
            })
            .collect();
        let biases = [Vector3::new(0.01, 0.02, 0.03), Vector3::new(0.0, 0.1, -0.1)];
        let biases = biases.map(|b| problem.add_block(b).id());
        let gravity = problem.add_block(Vector3::new(0.1, -9.7, 0.5)).id();
        let error = |k: usize| 0.01 * (k as f64 - 3.0);
        let gyro_axes = problem.add_block(AxisErrors::from_fn(|k, _| error(k))).id();
        let accel_axes = problem.add_block(AxisErrors::from_fn(|k, _| error(k))).id();
        let delay = problem.add_block(Vector1::new(0.003)).id();
        let weights = Weights::at(0.4, 0.1);
        let measured = Vector3::new(0.1, 0.2, 0.3);
        let inverse_sigma = Vector3::new(2.0, 3.0, 0.0);
        let gyro = Gyro {
            weights,
            bias_share: 0.3,
            measured,
            inverse_sigma,
        };
        let accelerometer = Accelerometer {
            time_in_segment_s: 0.04,
            spacing_s: 0.1,
            bias_share: 0.3,
            measured,
            inverse_sigma,
        };
        let norm = GravityNorm {
            expected_m_s2: 9.8,
            inverse_sigma: 10.0,
        };
        let walk = BiasWalk { inverse_sigma: 4.0 };
        let of_gyro = [&rotations[..], &biases, &[gyro_axes]].concat();
        let last = [gravity, accel_axes, delay];
        let of_accel = [&rotations[..], &positions, &biases, &last].concat();
        let squared = Kernel::Squared;
        problem.add_residual(gyro, &of_gyro, squared).expect("fits");
        problem
            .add_residual(accelerometer, &of_accel, squared)
            .expect("fits");
        problem
            .add_residual(norm, &[gravity], squared)
            .expect("fits");
        problem.add_residual(walk, &biases, squared).expect("fits");
        check_residual_jacobian!(all of problem, within 1e-6);
    }
}
