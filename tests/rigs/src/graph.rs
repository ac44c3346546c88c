//! Rigs of four cameras and a LiDAR with the transforms that separate calibrations would give: exact truth, seeded noise.

use std::f64::consts::FRAC_PI_2;

use lsfb_calib::TransformEdge;
use lsfb_calib::joint::{IMU, JointConfig, LIDAR};
use lsfb_geometry::{Matrix6, Se3, UnitQuaternion, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A rig and what was measured of it.
pub struct Graph {
    pub cameras: Vec<Se3>,
    pub lidar: Se3,
    pub edges: Vec<TransformEdge>,
}

/// Where the errors of the measured transforms come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Errors {
    /// ΣC and ΣL of Eq. 3, made smaller so that they are degrees and centimetres; edges carry no covariance.
    Paper,
    /// As calibrations have them: of all sizes, correlated, different for each edge, which carries its covariance.
    Measured,
}

impl Graph {
    /// The graph of a seed.
    pub fn simulate(errors: Errors, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (cameras, lidar) = rig(&mut rng);
        let edges = match errors {
            Errors::Paper => separate(&cameras, &lidar, &mut rng),
            Errors::Measured => measured(&cameras, &lidar, &mut rng),
        };
        Self {
            cameras,
            lidar,
            edges,
        }
    }

    /// The LiDAR in the IMU by one camera alone.
    pub fn chain(&self, camera: usize) -> Se3 {
        let [to_imu, to_lidar] = [2 * camera, 2 * camera + 1].map(|k| &self.edges[k]);
        let camera_from_lidar = if to_lidar.source == LIDAR {
            to_lidar.target_from_source
        } else {
            to_lidar.target_from_source.inverse()
        };
        to_imu.target_from_source * camera_from_lidar
    }

    /// Where a sensor truly is.
    pub fn truth(&self, sensor: &str) -> Se3 {
        match sensor {
            LIDAR => self.lidar,
            name => self.cameras[usize::from(name.as_bytes()[3] - b'0')],
        }
    }

    /// Mean over the chains of the variances, and variances of all chains together, of rotation and translation of the LiDAR
    /// in its own axes, as errors of [`Errors::Paper`] have them.
    pub fn expected_squares(&self) -> [[f64; 2]; 2] {
        let [camera, lidar] = paper_covariances();
        let mut information = Matrix6::zeros();
        let mut mean = Matrix6::zeros();
        let to_lidar = self.lidar.inverse().adjoint();
        for pose in &self.cameras {
            // Errors of both edges, carried to the IMU, then into the LiDAR.
            let through = pose.adjoint();
            let chain = camera + through * lidar * through.transpose();
            let chain = to_lidar * chain * to_lidar.transpose();
            information += chain.try_inverse().expect("a covariance");
            mean += chain / self.cameras.len() as f64;
        }
        let joint = information.try_inverse().expect("a covariance");
        [mean, joint].map(|c| [0, 3].map(|k| c.fixed_view::<3, 3>(k, k).trace()))
    }
}

/// Tangent of the difference between two poses, in the second's axes.
pub fn difference(a: &Se3, b: &Se3) -> Vector6<f64> {
    (b.inverse() * *a).log()
}

/// Squares of rotation and translation.
pub fn squares(a: &Se3, b: &Se3) -> [f64; 2] {
    let d = difference(a, b);
    [
        d.fixed_rows::<3>(0).norm_squared(),
        d.fixed_rows::<3>(3).norm_squared(),
    ]
}

fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..1.0));
    (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

fn draw(covariance: &Matrix6<f64>, rng: &mut ChaCha8Rng) -> Vector6<f64> {
    let factor = covariance.cholesky().expect("positive").l();
    factor * Vector6::from_fn(|_, _| gauss(rng))
}

/// Four cameras that look around and a LiDAR above them, as the backpack of the paper has them.
fn rig(rng: &mut ChaCha8Rng) -> (Vec<Se3>, Se3) {
    let forward = UnitQuaternion::from_euler_angles(-FRAC_PI_2, 0.0, -FRAC_PI_2);
    let mut jitter =
        |size: f64| Vector6::from_fn(|k, _| if k < 3 { 0.1 } else { 0.02 } * size * gauss(rng));
    let cameras = (0..4)
        .map(|k| {
            let yaw = UnitQuaternion::from_euler_angles(0.0, 0.0, FRAC_PI_2 * f64::from(k));
            let place = yaw * Vector3::new(0.11, 0.0, 0.15);
            Se3::new(yaw * forward, place) * Se3::exp(&jitter(0.3))
        })
        .collect();
    let lidar = Se3::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, 0.35));
    (cameras, lidar * Se3::exp(&jitter(0.5)))
}

/// An edge without covariance.
pub fn edge(target: &str, source: &str, target_from_source: Se3) -> TransformEdge {
    TransformEdge {
        target: target.to_owned(),
        source: source.to_owned(),
        target_from_source,
        covariance: None,
    }
}

/// ΣC and ΣL, made smaller: 0.01 rad² becomes (0.2°)², 0.03 m² (6 mm)².
fn paper_covariances() -> [Matrix6<f64>; 2] {
    const SHRINK: f64 = 0.0012;
    let config = JointConfig::default();
    [config.camera_variance, config.lidar_variance]
        .map(|d| Matrix6::from_diagonal(&Vector6::from(d)) * SHRINK)
}

/// The separate calibrations of a rig, each wrong as Eq. 3 has it: `log(true · measured⁻¹)` drawn from ΣC and ΣL, made
/// smaller so that they are degrees and centimetres.
fn separate(cameras: &[Se3], lidar: &Se3, rng: &mut ChaCha8Rng) -> Vec<TransformEdge> {
    let [of_camera, of_lidar] = paper_covariances();
    let mut edges = Vec::new();
    for (k, camera) in cameras.iter().enumerate() {
        let name = format!("cam{k}");
        let wrong = Se3::exp(&-draw(&of_camera, rng)) * *camera;
        edges.push(edge(IMU, &name, wrong));
        let truth = camera.inverse() * *lidar;
        let wrong = Se3::exp(&-draw(&of_lidar, rng)) * truth;
        edges.push(edge(&name, LIDAR, wrong));
    }
    edges
}

/// Covariances as calibrations measure them: of all sizes, correlated, different for each edge.
fn measured(cameras: &[Se3], lidar: &Se3, rng: &mut ChaCha8Rng) -> Vec<TransformEdge> {
    let mut edges = Vec::new();
    let mut add = |target: &str, source: &str, truth: Se3, rng: &mut ChaCha8Rng| {
        let size = 3f64.powf(rng.random_range(-1.0..1.0));
        let mixing = Matrix6::from_fn(|i, j| {
            let scale = if i < 3 { 5e-4 } else { 2e-3 };
            scale * size * (f64::from(u8::from(i == j)) + 0.4 * gauss(rng))
        });
        let covariance = mixing * mixing.transpose() + Matrix6::identity() * 1e-8;
        let delta = draw(&covariance, rng);
        edges.push(TransformEdge {
            // The truth is the measured one perturbed on the right.
            covariance: Some(covariance),
            ..edge(target, source, truth * Se3::exp(&-delta))
        });
    };
    for (k, camera) in cameras.iter().enumerate() {
        let name = format!("cam{k}");
        add(IMU, &name, *camera, rng);
        // Some tools give the other direction.
        if k % 2 == 0 {
            add(&name, LIDAR, camera.inverse() * *lidar, rng);
        } else {
            add(LIDAR, &name, lidar.inverse() * *camera, rng);
        }
    }
    edges
}
