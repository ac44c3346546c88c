//! Cameras and observations of the BAL format ("bundle adjustment in the large"), and problems read from it.

use lsfb_geometry::{Matrix2, Matrix2x3, UnitQuaternion, Vector2, Vector3, so3};
use lsfb_solver::{
    Block, Kernel, Linearization, Manifold, Parameters, Problem, Residual, Shape, Undefined,
};
use nalgebra::SMatrix;

/// Camera of the BAL format: looks along −z, two radial terms, one focal length.
pub struct BalCamera {
    pub camera_from_world: UnitQuaternion<f64>,
    pub translation: Vector3<f64>,
    /// Focal length, k1, k2.
    pub intrinsics: Vector3<f64>,
}

impl Manifold for BalCamera {
    const STORED: usize = 10;
    const TANGENT: usize = 9;

    fn load(stored: &[f64]) -> Self {
        Self {
            camera_from_world: UnitQuaternion::load(&stored[..4]),
            translation: Vector3::load(&stored[4..7]),
            intrinsics: Vector3::load(&stored[7..10]),
        }
    }

    fn store(&self, stored: &mut [f64]) {
        self.camera_from_world.store(&mut stored[..4]);
        self.translation.store(&mut stored[4..7]);
        self.intrinsics.store(&mut stored[7..10]);
    }

    fn plus(&self, delta: &[f64]) -> Self {
        Self {
            camera_from_world: self.camera_from_world.plus(&delta[..3]),
            translation: self.translation.plus(&delta[3..6]),
            intrinsics: self.intrinsics.plus(&delta[6..9]),
        }
    }

    fn turn(delta: &[f64]) -> f64 {
        UnitQuaternion::turn(&delta[..3])
    }

    fn tangent_name(component: usize) -> &'static str {
        let names = [
            "rotation x",
            "rotation y",
            "rotation z",
            "translation x",
            "translation y",
            "translation z",
            "focal length",
            "k1",
            "k2",
        ];
        names.get(component).copied().unwrap_or("")
    }
}

/// Where a camera saw a point.
pub struct BalObservation {
    pub pixel: Vector2<f64>,
}

impl Residual for BalObservation {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<BalCamera>(), Shape::of::<Vector3<f64>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let camera: BalCamera = parameters.get(0);
        let point: Vector3<f64> = parameters.get(1);
        let rotation = camera.camera_from_world.to_rotation_matrix().into_inner();
        let p = rotation * point + camera.translation;
        let inverse_z = 1.0 / p.z;
        let n = Vector2::new(-p.x * inverse_z, -p.y * inverse_z);
        let squared = n.norm_squared();
        let (f, k1, k2) = (
            camera.intrinsics.x,
            camera.intrinsics.y,
            camera.intrinsics.z,
        );
        let distortion = 1.0 + squared * (k1 + k2 * squared);
        out.set_residual(&(n * (f * distortion) - self.pixel));
        if !out.wants_jacobian(0) && !out.wants_jacobian(1) {
            return Ok(());
        }
        let n_by_p = Matrix2x3::new(
            -inverse_z,
            0.0,
            p.x * inverse_z * inverse_z,
            0.0,
            -inverse_z,
            p.y * inverse_z * inverse_z,
        );
        let pixel_by_n = n * n.transpose() * (f * (2.0 * k1 + 4.0 * k2 * squared))
            + Matrix2::identity() * (f * distortion);
        let by_p = pixel_by_n * n_by_p;
        let by_point = by_p * rotation;
        let mut by_camera = SMatrix::<f64, 2, 9>::zeros();
        by_camera
            .fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&(-by_point * so3::hat(&point)));
        by_camera.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_p);
        by_camera.set_column(6, &(n * distortion));
        by_camera.set_column(7, &(n * (f * squared)));
        by_camera.set_column(8, &(n * (f * squared * squared)));
        out.set_jacobian(0, &by_camera);
        out.set_jacobian(1, &by_point);
        Ok(())
    }
}

/// A problem, and the blocks it has.
pub struct BalProblem {
    pub problem: Problem,
    pub cameras: Vec<Block<BalCamera>>,
    pub points: Vec<Block<Vector3<f64>>>,
}

/// The problem from the text of a BAL file.
pub fn parse(text: &str, kernel: Kernel) -> Result<BalProblem, Box<dyn std::error::Error>> {
    let mut words = text.split_ascii_whitespace();
    let count = |word: Option<&str>| -> Result<usize, Box<dyn std::error::Error>> {
        Ok(word.ok_or("the file ends too early")?.parse()?)
    };
    let number = |word: Option<&str>| -> Result<f64, Box<dyn std::error::Error>> {
        Ok(word.ok_or("the file ends too early")?.parse()?)
    };
    let cameras = count(words.next())?;
    let points = count(words.next())?;
    let observations = count(words.next())?;
    let mut seen = Vec::new();
    for _ in 0..observations {
        let (camera, point) = (count(words.next())?, count(words.next())?);
        let pixel = Vector2::new(number(words.next())?, number(words.next())?);
        seen.push((camera, point, pixel));
    }
    let mut vector = || -> Result<Vector3<f64>, Box<dyn std::error::Error>> {
        let mut next = || number(words.next());
        Ok(Vector3::new(next()?, next()?, next()?))
    };
    let mut bal = BalProblem {
        problem: Problem::new(),
        cameras: Vec::new(),
        points: Vec::new(),
    };
    for k in 0..cameras {
        let camera = bal.problem.add_block(BalCamera {
            camera_from_world: so3::exp(&vector()?),
            translation: vector()?,
            intrinsics: vector()?,
        });
        bal.problem.set_name(camera.id(), format!("camera {k}"));
        bal.cameras.push(camera);
    }
    for _ in 0..points {
        let point = bal.problem.add_eliminated_point(vector()?);
        bal.points.push(point);
    }
    for (camera, point, pixel) in seen {
        let camera = bal
            .cameras
            .get(camera)
            .ok_or("a camera that is not there")?;
        let point = bal.points.get(point).ok_or("a point that is not there")?;
        let blocks = [camera.id(), point.id()];
        bal.problem
            .add_residual(BalObservation { pixel }, &blocks, kernel)?;
    }
    Ok(bal)
}
