//! What a LiDAR says of a board whose pose is `lidar_from_board = camera_from_lidar⁻¹ · camera_from_board`.
//!
//! Plane: slope along both axes of the measured plane and height at its origin, whitened. With the board's normal `n` and a
//! point `t` of it in the LiDAR, `r = W [−e₁·n/(m·n), −e₂·n/(m·n), n·(t − o)/(m·n)]`, where `m` is the measured normal.
//!
//! What all ranges are too long by moves the measured plane along its normal by `|m·u|` of that, with `u` the ray to its origin.
//!
//! Edge: the ray meets the board's plane at `q` in the board's frame; `r = (s·(q − d) − (half size + excess)) / σ` for the side
//! with outward normal `s`, where `d` is how far the plate's middle lies from where it was said to be. Blocks of both:
//! `camera_from_lidar`, `camera_from_board`, and the apparent values: excess of half the width and height, and of every
//! range; for edges also `d`.

use lsfb_geometry::{Matrix3, Se3, Vector2, Vector3, so3};
use lsfb_perception::projection::moved_by_inverse;
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};
use nalgebra::{RowVector3, SMatrix, SVector};

use super::plane::Plane;

pub(super) type Rows<const D: usize> = SMatrix<f64, D, 6>;

const SHAPES: [Shape; 4] = [
    Shape::of::<Se3>(),
    Shape::of::<Se3>(),
    Shape::of::<Vector3<f64>>(),
    Shape::of::<Vector2<f64>>(),
];
/// Planes do not know where the plate's middle is.
const PLANE_BLOCKS: usize = 3;

/// Pose of the board in the LiDAR, and a derivative by its tangent carried to the two blocks.
struct Joined {
    lidar_from_board: Se3,
}

impl Joined {
    fn of(parameters: &Parameters) -> Self {
        let (camera_from_lidar, camera_from_board): (Se3, Se3) =
            (parameters.get(0), parameters.get(1));
        Self {
            lidar_from_board: camera_from_lidar.inverse() * camera_from_board,
        }
    }

    fn write<const D: usize>(&self, by_pose: &Rows<D>, out: &mut Linearization) {
        // (T exp δ)⁻¹ B = T⁻¹B exp(−Ad(B⁻¹T) δ)
        out.set_jacobian(0, &(-by_pose * self.lidar_from_board.inverse().adjoint()));
        out.set_jacobian(1, by_pose);
    }
}

pub(super) struct PlaneResidual {
    pub plane: Plane,
    /// Square root of the information: upper triangular factor.
    pub whitening: Matrix3<f64>,
}

impl PlaneResidual {
    /// Slopes and height of the board on the measured plane, and their derivative by the board's tangent.
    pub fn parts(
        measured: &Plane,
        lidar_from_board: &Se3,
    ) -> Result<(Vector3<f64>, Rows<3>), Undefined> {
        let turn = lidar_from_board.rotation_matrix();
        let normal: Vector3<f64> = turn.column(2).into();
        let along = measured.normal.dot(&normal);
        if along.abs() < 1e-3 {
            return Err(Undefined);
        }
        let offset = lidar_from_board.translation - measured.origin;
        let [x, y] = measured.axes;
        let tops = Vector3::new(-x.dot(&normal), -y.dot(&normal), offset.dot(&normal));
        // By the normal, which turns by −R ẑ^ φ, and by the point, which moves by R ρ.
        let normal_by_turn = -turn * so3::hat(&Vector3::z());
        let mut by_pose = Rows::<3>::zeros();
        for (row, by_normal) in [-x, -y, offset].iter().enumerate() {
            let slope = (by_normal - measured.normal * (tops[row] / along)) / along;
            by_pose
                .fixed_view_mut::<1, 3>(row, 0)
                .copy_from(&(slope.transpose() * normal_by_turn));
        }
        by_pose
            .fixed_view_mut::<1, 3>(2, 3)
            .copy_from(&(normal.transpose() * turn / along));
        Ok((tops / along, by_pose))
    }
}

impl Residual for PlaneResidual {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        &SHAPES[..PLANE_BLOCKS]
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let joined = Joined::of(parameters);
        let (value, by_pose) = Self::parts(&self.plane, &joined.lidar_from_board)?;
        let apparent: Vector3<f64> = parameters.get(2);
        let facing = facing(&self.plane);
        let moved = Vector3::new(0.0, 0.0, facing * apparent.z);
        out.set_residual(&(self.whitening * (value - moved)));
        let mut by_apparent = Matrix3::zeros();
        by_apparent[(2, 2)] = -facing;
        out.set_jacobian(2, &(self.whitening * by_apparent));
        if out.wants_jacobian(0) || out.wants_jacobian(1) {
            joined.write(&(self.whitening * by_pose), out);
        }
        Ok(())
    }
}

/// How squarely the ray to a plane's origin meets it.
pub(super) fn facing(plane: &Plane) -> f64 {
    (plane.normal.dot(&plane.origin) / plane.origin.norm()).abs()
}

pub(super) struct EdgeResidual {
    pub ray: Vector3<f64>,
    /// Outward normal of its side in the board's frame.
    pub side: Vector2<f64>,
    /// Half the board's size across the side, metres.
    pub half_m: f64,
    pub sigma_m: f64,
}

impl EdgeResidual {
    /// Where a ray meets the board, in its frame.
    pub fn place(ray: &Vector3<f64>, lidar_from_board: &Se3) -> Option<Vector2<f64>> {
        let origin = lidar_from_board.inverse() * Vector3::zeros();
        let direction = lidar_from_board.rotation.inverse() * ray;
        (direction.z.abs() > 0.05).then(|| (origin - direction * (origin.z / direction.z)).xy())
    }
}

impl Residual for EdgeResidual {
    fn dimension(&self) -> usize {
        1
    }

    fn blocks(&self) -> &[Shape] {
        &SHAPES
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let joined = Joined::of(parameters);
        let apparent: Vector3<f64> = parameters.get(2);
        let pose = &joined.lidar_from_board;
        let place = Self::place(&self.ray, pose).ok_or(Undefined)?;
        let which = self.side.map(f64::abs);
        let shift: Vector2<f64> = parameters.get(3);
        let value = self.side.dot(&(place - shift)) - self.half_m - which.dot(&apparent.xy());
        out.set_residual(&SVector::<f64, 1>::new(value / self.sigma_m));
        if out.wants_jacobian(0) || out.wants_jacobian(1) {
            let origin = pose.inverse() * Vector3::zeros();
            let direction = pose.rotation.inverse() * self.ray;
            // Points in the board move by −φ × p − ρ, directions by −φ × u.
            let origin_by = moved_by_inverse(&origin);
            let mut direction_by = SMatrix::<f64, 3, 6>::zeros();
            direction_by
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&so3::hat(&direction));
            let depth = origin.z / direction.z;
            let depth_by = (origin_by.row(2) - direction_by.row(2) * depth) / direction.z;
            let side = Vector3::new(self.side.x, self.side.y, 0.0).transpose();
            let by_pose: Rows<1> =
                side * origin_by - side * direction_by * depth - depth_by * (side * direction)[0];
            joined.write(&(by_pose / self.sigma_m), out);
        }
        out.set_jacobian(
            2,
            &RowVector3::new(-which.x / self.sigma_m, -which.y / self.sigma_m, 0.0),
        );
        out.set_jacobian(3, &(-self.side.transpose() / self.sigma_m));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Vector6;
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    #[test]
    fn jacobians_are_those_of_differences() {
        let mut problem = Problem::new();
        let camera_from_lidar =
            problem.add_block(Se3::exp(&Vector6::new(1.1, -1.2, 1.3, 0.1, 0.2, -0.3)));
        let camera_from_board =
            problem.add_block(Se3::exp(&Vector6::new(0.2, -0.3, 0.4, 0.1, 0.3, 2.0)));
        let apparent = problem.add_block(Vector3::new(0.003, -0.004, 0.006));
        let pose = problem.value(camera_from_lidar).inverse() * problem.value(camera_from_board);
        let normal = pose.rotation * Vector3::new(0.05, -0.03, 1.0);
        let origin = pose * Vector3::new(0.03, -0.05, 0.02);
        let plane = Plane::new(origin, normal).expect("a plane");
        let whitening = Matrix3::new(30.0, 2.0, 3.0, 0.0, 40.0, 1.0, 0.0, 0.0, 300.0);
        let blocks = [
            camera_from_lidar.id(),
            camera_from_board.id(),
            apparent.id(),
        ];
        problem
            .add_residual(PlaneResidual { plane, whitening }, &blocks, Kernel::Squared)
            .expect("two poses");
        let shift = problem.add_block(Vector2::new(0.002, 0.001));
        let blocks = [blocks[0], blocks[1], blocks[2], shift.id()];
        for side in [[1.0, 0.0], [0.0, -1.0]] {
            let residual = EdgeResidual {
                ray: (pose * Vector3::new(0.31, -0.4, 0.0)).normalize(),
                side: Vector2::from(side),
                half_m: 0.3,
                sigma_m: 0.004,
            };
            problem
                .add_residual(residual, &blocks, Kernel::Squared)
                .expect("two poses and the excess");
        }
        check_residual_jacobian!(all of problem, within 1e-6);
    }
}
