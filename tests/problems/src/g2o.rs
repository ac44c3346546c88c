//! Pose graphs in g2o format.

use lsfb_geometry::{Matrix3, Matrix6, Quaternion, Se3, UnitQuaternion, Vector3, Vector6, so3};
use lsfb_solver::{
    Block, Kernel, Linearization, Parameters, PosePrior, Problem, Residual, Shape, Undefined,
};

/// A measured transform between two poses, its error taken in SE(3). Blocks: `world_from_a`, `world_from_b`.
///
/// `r = W log(M⁻¹ T_A⁻¹ T_B)`; `∂r/∂b = W Jᵣ⁻¹(r)`, `∂r/∂a = −W Jᵣ⁻¹(r) Ad(T_B⁻¹ T_A)`.
pub struct Between {
    pub b_from_a_measured: Se3,
    pub sqrt_information: Matrix6<f64>,
}

impl Residual for Between {
    fn dimension(&self) -> usize {
        6
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<Se3>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (world_from_a, world_from_b): (Se3, Se3) = (parameters.get(0), parameters.get(1));
        let a_from_b = world_from_a.inverse() * world_from_b;
        let error = (self.b_from_a_measured * a_from_b).log();
        out.set_residual(&(self.sqrt_information * error));
        if out.wants_jacobian(0) || out.wants_jacobian(1) {
            let by_b = self.sqrt_information * right_jacobian_inverse(&error);
            out.set_jacobian(0, &-(by_b * a_from_b.inverse().adjoint()));
            out.set_jacobian(1, &by_b);
        }
        Ok(())
    }
}

/// Inverse of the right Jacobian of SE(3), of `[rotation, translation]`.
fn right_jacobian_inverse(tangent: &Vector6<f64>) -> Matrix6<f64> {
    let rotation: Vector3<f64> = tangent.fixed_rows::<3>(0).into_owned();
    let translation: Vector3<f64> = tangent.fixed_rows::<3>(3).into_owned();
    // Jᵣ(x) = Jₗ(−x).
    let (phi, rho) = (so3::hat(&-rotation), so3::hat(&-translation));
    let angle = rotation.norm();
    let square = angle * angle;
    let (a, b, c) = if angle < 1e-2 {
        (
            1.0 / 6.0 - square / 120.0,
            1.0 / 24.0 - square / 720.0,
            1.0 / 120.0 - square / 2520.0,
        )
    } else {
        let (sin, cos) = angle.sin_cos();
        (
            (angle - sin) / (square * angle),
            (square + 2.0 * cos - 2.0) / (2.0 * square * square),
            (2.0 * angle - 3.0 * sin + angle * cos) / (2.0 * square * square * angle),
        )
    };
    let mixed = phi * rho * phi;
    let q: Matrix3<f64> = rho * 0.5
        + (phi * rho + rho * phi + mixed) * a
        + (phi * phi * rho + rho * phi * phi - mixed * 3.0) * b
        + (phi * mixed + mixed * phi) * c;
    let inverse = so3::left_jacobian_inverse(&-rotation);
    let mut jacobian = Matrix6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&inverse);
    jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&inverse);
    jacobian
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&-(inverse * q * inverse));
    jacobian
}

/// A pose graph as a problem, its first pose held by a prior of 1 mm and 1 mrad.
pub struct PoseGraph {
    pub problem: Problem,
    pub poses: Vec<Block<Se3>>,
    pub edges: usize,
}

/// Reads `VERTEX_SE3:QUAT` and `EDGE_SE3:QUAT` lines.
pub fn parse(text: &str) -> Result<PoseGraph, Box<dyn std::error::Error>> {
    let mut problem = Problem::new();
    let mut poses: Vec<Block<Se3>> = Vec::new();
    let mut index = std::collections::BTreeMap::new();
    let mut edges = 0;
    for line in text.lines() {
        let mut words = line.split_ascii_whitespace();
        let kind = words.next().unwrap_or("");
        match kind {
            "VERTEX_SE3:QUAT" => {
                let id: usize = words.next().ok_or("vertex without a number")?.parse()?;
                let pose = problem.add_block(pose(&numbers(words)?)?);
                problem.set_name(pose.id(), format!("pose {id}"));
                index.insert(id, poses.len());
                poses.push(pose);
            }
            "EDGE_SE3:QUAT" => {
                let mut end = || -> Result<usize, Box<dyn std::error::Error>> {
                    let id: usize = words.next().ok_or("edge without its ends")?.parse()?;
                    Ok(*index.get(&id).ok_or("edge of an unknown vertex")?)
                };
                let (a, b) = (poses[end()?], poses[end()?]);
                let numbers = numbers(words)?;
                let between = Between {
                    b_from_a_measured: pose(&numbers)?.inverse(),
                    sqrt_information: sqrt_information(numbers.get(7..).unwrap_or(&[]))?,
                };
                problem.add_residual(between, &[a.id(), b.id()], Kernel::Squared)?;
                edges += 1;
            }
            _ => {}
        }
    }
    let first = *poses.first().ok_or("a graph without poses")?;
    let prior = PosePrior::isotropic(problem.value(first), 1e-3, 1e-3);
    problem.add_residual(prior, &[first.id()], Kernel::Squared)?;
    Ok(PoseGraph {
        problem,
        poses,
        edges,
    })
}

fn numbers<'a>(
    words: impl Iterator<Item = &'a str>,
) -> Result<Vec<f64>, std::num::ParseFloatError> {
    words.map(str::parse).collect()
}

fn pose(numbers: &[f64]) -> Result<Se3, String> {
    let &[x, y, z, i, j, k, w, ..] = numbers else {
        return Err(format!("a pose of {} numbers", numbers.len()));
    };
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Ok(Se3::new(rotation, Vector3::new(x, y, z)))
}

/// The upper triangle of the information, translation first, as the square root with rotation first.
fn sqrt_information(upper: &[f64]) -> Result<Matrix6<f64>, String> {
    if upper.len() < 21 {
        return Err(format!("an information matrix of {} numbers", upper.len()));
    }
    let mut information = Matrix6::zeros();
    let mut rest = upper.iter();
    for r in 0..6 {
        for c in r..6 {
            let value = rest.next().copied().unwrap_or(0.0);
            let (r, c) = ((r + 3) % 6, (c + 3) % 6);
            information[(r, c)] = value;
            information[(c, r)] = value;
        }
    }
    let factor = information
        .cholesky()
        .ok_or("an information matrix that is not positive definite")?;
    Ok(factor.l().transpose())
}
