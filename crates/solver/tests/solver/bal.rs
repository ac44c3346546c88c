//! A real bundle adjustment problem in the large (BAL), with the optimum that two other programs found.

use std::io::Read;

use flate2::read::GzDecoder;
use lsfb_geometry::{Matrix2, Matrix2x3, UnitQuaternion, Vector2, Vector3, so3};
use lsfb_solver::{
    Kernel, Linearization, Manifold, Parameters, Problem, Residual, Shape, SolveConfig, Undefined,
    check_jacobians, solve,
};
use nalgebra::{SMatrix, Vector3 as V3};

/// Camera of the BAL format: looks along −z, two radial terms, one focal length.
pub struct BalCamera {
    camera_from_world: UnitQuaternion<f64>,
    translation: Vector3<f64>,
    /// Focal length, k1, k2.
    intrinsics: Vector3<f64>,
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
}

pub struct BalObservation {
    pixel: Vector2<f64>,
}

impl Residual for BalObservation {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<BalCamera>(), Shape::of::<V3<f64>>()] }
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

/// The problem from the text of a BAL file.
pub fn parse(text: &str) -> Problem {
    let mut numbers = text.split_ascii_whitespace().map(|word| {
        word.parse::<f64>()
            .unwrap_or_else(|_| panic!("a number in the BAL file: {word}"))
    });
    let mut next = || numbers.next().expect("BAL file goes on");
    let (cameras, points, observations) = (next() as usize, next() as usize, next() as usize);
    let seen: Vec<(usize, usize, Vector2<f64>)> = (0..observations)
        .map(|_| {
            (
                next() as usize,
                next() as usize,
                Vector2::new(next(), next()),
            )
        })
        .collect();
    let mut problem = Problem::new();
    let vector = |next: &mut dyn FnMut() -> f64| Vector3::new(next(), next(), next());
    let cameras: Vec<_> = (0..cameras)
        .map(|_| {
            problem.add_block(BalCamera {
                camera_from_world: so3::exp(&vector(&mut next)),
                translation: vector(&mut next),
                intrinsics: vector(&mut next),
            })
        })
        .collect();
    let points: Vec<_> = (0..points)
        .map(|_| problem.add_eliminated_point(vector(&mut next)))
        .collect();
    for (camera, point, pixel) in seen {
        let blocks = [cameras[camera].id(), points[point].id()];
        problem
            .add_residual(BalObservation { pixel }, &blocks, Kernel::Squared)
            .expect("blocks fit");
    }
    problem
}

#[test]
fn ladybug_reaches_the_known_optimum() {
    let test = "ladybug_reaches_the_known_optimum";
    let Some(path) = lsfb_tests::recordings(test, "vision/ba/problem-16-22106-pre.txt.gz") else {
        return;
    };
    let mut text = String::new();
    GzDecoder::new(std::fs::File::open(path).expect("file opens"))
        .read_to_string(&mut text)
        .expect("file is text");
    let mut problem = parse(&text);

    let started = std::time::Instant::now();
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    println!(
        "solved in {:.3} s: {report:?}",
        started.elapsed().as_secs_f64()
    );
    assert!((report.initial_cost - 4_185_659.518).abs() < 1e-2);
    assert!((report.final_cost / 18_033.9 - 1.0).abs() < 1e-3);
    assert_eq!(report.undefined_at_start, 0);
    assert_eq!(
        (report.reduced_dimension, report.eliminated_points),
        (144, 22_106)
    );
}

#[test]
fn bal_jacobians_match_differences() {
    let text =
        "1 1 1  0 0 -300.0 120.0  0.1 -0.2 0.3  0.5 -0.4 -5.0  500.0 -0.1 0.02  1.0 2.0 -3.0";
    check_jacobians(&parse(text), 1e-7).expect("Jacobians match");
}
