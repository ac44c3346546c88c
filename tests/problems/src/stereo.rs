//! Stereo odometry as GTSAM's example data has it.

use std::collections::BTreeMap;
use std::error::Error;

use lsfb_geometry::{Matrix3, Se3, UnitQuaternion, Vector3, so3};
use lsfb_solver::{
    Block, Kernel, Linearization, Parameters, PosePrior, Problem, Residual, Shape, Undefined,
};
use nalgebra::{Rotation3, SMatrix};

/// A rectified stereo camera.
#[derive(Clone, Copy)]
pub struct StereoCamera {
    pub focal_px: [f64; 2],
    pub centre_px: [f64; 2],
    pub baseline_m: f64,
}

/// A point seen by a stereo camera: column in the left and right image, and row. Blocks: `world_from_camera`, point.
pub struct StereoObservation {
    pub camera: StereoCamera,
    pub measured_px: Vector3<f64>,
}

impl Residual for StereoObservation {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<Vector3<f64>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (pose, point): (Se3, Vector3<f64>) = (parameters.get(0), parameters.get(1));
        let camera_from_world = pose.rotation_matrix().transpose();
        let p = camera_from_world * (point - pose.translation);
        if !(p.z > 0.0) {
            return Err(Undefined);
        }
        let [fx, fy] = self.camera.focal_px;
        let [cx, cy] = self.camera.centre_px;
        let d = 1.0 / p.z;
        let right_x = p.x - self.camera.baseline_m;
        let pixel = Vector3::new(fx * p.x * d + cx, fx * right_x * d + cx, fy * p.y * d + cy);
        out.set_residual(&(pixel - self.measured_px));
        if out.wants_jacobian(0) || out.wants_jacobian(1) {
            let by_p = Matrix3::new(
                fx * d,
                0.0,
                -fx * p.x * d * d,
                fx * d,
                0.0,
                -fx * right_x * d * d,
                0.0,
                fy * d,
                -fy * p.y * d * d,
            );
            let mut by_pose = SMatrix::<f64, 3, 6>::zeros();
            by_pose
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&(by_p * so3::hat(&p)));
            by_pose.fixed_view_mut::<3, 3>(0, 3).copy_from(&-by_p);
            out.set_jacobian(0, &by_pose);
            out.set_jacobian(1, &(by_p * camera_from_world));
        }
        Ok(())
    }
}

/// The three files.
pub struct Texts {
    pub calibration: String,
    pub poses: String,
    pub factors: String,
}

/// The first pose held by a prior of 1 mm and 1 mrad; Huber's kernel at 1.345 px.
pub fn parse(texts: &Texts) -> Result<Problem, Box<dyn Error>> {
    let calibration = row(&texts.calibration)?;
    let &[fx, fy, _, cx, cy, baseline_m] = calibration.as_slice() else {
        return Err("a calibration has six numbers".into());
    };
    let camera = StereoCamera {
        focal_px: [fx, fy],
        centre_px: [cx, cy],
        baseline_m,
    };
    let mut problem = Problem::new();
    let mut poses: BTreeMap<usize, Block<Se3>> = BTreeMap::new();
    for line in texts.poses.lines().filter(|line| !line.trim().is_empty()) {
        let numbers = row(line)?;
        let [id, matrix @ ..] = numbers.as_slice() else {
            continue;
        };
        let m = |r: usize, c: usize| matrix.get(4 * r + c).copied().unwrap_or(f64::NAN);
        let rotation = Matrix3::from_fn(m);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        let rotation = UnitQuaternion::new_normalize(rotation.into_inner());
        let block = problem.add_block(Se3::new(rotation, Vector3::new(m(0, 3), m(1, 3), m(2, 3))));
        poses.insert(*id as usize, block);
    }
    let (_, first) = poses.first_key_value().ok_or("no pose")?;
    let prior = PosePrior::isotropic(problem.value(*first), 1e-3, 1e-3);
    problem.add_residual(prior, &[first.id()], Kernel::Squared)?;
    // In order of the poses, as an odometry adds them: a point starts where the first of them saw it.
    let mut factors: Vec<Vec<f64>> = texts
        .factors
        .lines()
        .filter(|line| !line.trim().is_empty())
        .map(row)
        .collect::<Result<_, _>>()?;
    factors.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut points: BTreeMap<usize, Block<Vector3<f64>>> = BTreeMap::new();
    for numbers in &factors {
        let &[pose, point, left, right, down, x, y, z, ..] = numbers.as_slice() else {
            return Err("a stereo factor has eight numbers".into());
        };
        let pose = *poses.get(&(pose as usize)).ok_or("an unknown pose")?;
        let point = *points.entry(point as usize).or_insert_with(|| {
            let start = problem.value(pose) * Vector3::new(x, y, z);
            problem.add_eliminated_point(start)
        });
        let seen = StereoObservation {
            camera,
            measured_px: Vector3::new(left, right, down),
        };
        let kernel = Kernel::Huber { scale: 1.345 };
        problem.add_residual(seen, &[pose.id(), point.id()], kernel)?;
    }
    Ok(problem)
}

fn row(line: &str) -> Result<Vec<f64>, std::num::ParseFloatError> {
    line.split_ascii_whitespace().map(str::parse).collect()
}
