//! A simulated walk round a block, with a stereo camera: keyframes that see points for a while, odometry between
//! neighbours, and at the end the points of the beginning again.

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix3, Matrix6, Se3, UnitQuaternion, Vector3, Vector6};
use lsfb_solver::{
    Block, BlockId, Diagnosis, Error, Incremental, Kernel, PosePrior, Problem, Residual,
    ResidualId, SolveConfig, solve,
};
use nalgebra::Rotation3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::g2o::Between;
use crate::stereo::{StereoCamera, StereoObservation};

const CAMERA: StereoCamera = StereoCamera {
    focal_px: [450.0, 450.0],
    centre_px: [320.0, 240.0],
    baseline_m: 0.12,
};

const HUBER_PX: f64 = 1.0;
const FIRST_SIGMA: f64 = 1e-3;
const ROTATION_SIGMA: f64 = 2e-3;
const TRANSLATION_SIGMA: f64 = 0.02;
const MAP_ERROR_M: f64 = 0.01;
const MAP_SEED: u64 = 1000;

/// Takes points of a map from both sides of the walk, and as many from each stretch of it.
const SPREAD: usize = 37;

/// What one keyframe adds.
pub struct Keyframe {
    /// Pose in the frame before, as odometry has it.
    pub odometry: Se3,
    /// Points, by number, and where they are seen.
    pub seen: Vec<(usize, Vector3<f64>)>,
}

pub struct Walk {
    pub truth: Vec<Se3>,
    pub keyframes: Vec<Keyframe>,
    pub points: usize,
    /// Points that a map has, and where: their places are known, and held.
    pub map: BTreeMap<usize, Vector3<f64>>,
}

impl Walk {
    /// One lap and a bit, half a metre between keyframes; no map.
    pub fn new(keyframes: usize, points_per_keyframe: usize, seed: u64) -> Self {
        Self::in_map(keyframes, points_per_keyframe, 0, seed)
    }

    /// The same walk, of whose points a map has so many percent (the fixed points of Eq. 5 in the paper), up to a centimetre beside where they are.
    pub fn in_map(
        keyframes: usize,
        points_per_keyframe: usize,
        map_percent: u32,
        seed: u64,
    ) -> Self {
        let mut map_rng = ChaCha8Rng::seed_from_u64(seed.wrapping_add(MAP_SEED));
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = move |half: f64| (rng.random::<f64>() * 2.0 - 1.0) * half;
        let turn = std::f64::consts::TAU / (0.96 * keyframes as f64);
        let radius = 0.5 / turn;
        let truth: Vec<Se3> = (0..keyframes)
            .map(|k| pose(radius, k as f64 * turn))
            .collect();
        let places = keyframes * points_per_keyframe / 8;
        let points: Vec<(f64, Vector3<f64>)> = (0..places)
            .map(|p| {
                let angle = std::f64::consts::TAU * p as f64 / places as f64;
                let side = if p % 2 == 0 { 3.0 } else { -3.0 } + uniform(1.0);
                let (sin, cos) = angle.sin_cos();
                let r = radius + side;
                (angle, Vector3::new(r * cos, r * sin, uniform(1.5)))
            })
            .collect();
        let mut frames = Vec::new();
        for (k, world_from_camera) in truth.iter().enumerate() {
            let odometry = match k.checked_sub(1) {
                Some(before) => {
                    let noise = Vector6::new(
                        uniform(2e-3),
                        uniform(2e-3),
                        uniform(2e-3),
                        uniform(0.02),
                        uniform(0.02),
                        uniform(0.02),
                    );
                    truth[before].inverse() * *world_from_camera * Se3::exp(&noise)
                }
                None => *world_from_camera,
            };
            let here = k as f64 * turn;
            let mut seen = Vec::new();
            for (number, (angle, point)) in points.iter().enumerate() {
                let ahead = (angle - here).rem_euclid(std::f64::consts::TAU) * radius;
                if !(1.5..6.0).contains(&ahead) {
                    continue;
                }
                let p = world_from_camera.inverse() * *point;
                let d = 1.0 / p.z;
                let x = CAMERA.focal_px[0] * p.x * d + CAMERA.centre_px[0];
                let right = x - CAMERA.focal_px[0] * CAMERA.baseline_m * d;
                let y = CAMERA.focal_px[1] * p.y * d + CAMERA.centre_px[1];
                if !(0.0..640.0).contains(&x) || !(0.0..480.0).contains(&y) {
                    continue;
                }
                let mut pixel = Vector3::new(x, right, y);
                for entry in pixel.iter_mut() {
                    // One in fifty is far off.
                    *entry += uniform(0.8)
                        + if seen.len() % 50 == 49 {
                            uniform(20.0)
                        } else {
                            0.0
                        };
                }
                seen.push((number, pixel));
            }
            frames.push(Keyframe { odometry, seen });
        }
        let mut beside = || map_rng.random_range(-MAP_ERROR_M..MAP_ERROR_M);
        let map = points
            .iter()
            .enumerate()
            .map(|(number, (_, point))| (number, point + Vector3::from_fn(|_, _| beside())))
            .filter(|(number, _)| (number * SPREAD % 100) < map_percent as usize)
            .collect();
        Self {
            truth,
            keyframes: frames,
            points: places,
            map,
        }
    }

    /// What [`Added::add`] makes a problem of, for other programs: lines of a word and numbers. `camera`: focal lengths,
    /// centre, baseline, scale of the Huber kernel (pixels, metres); `sigmas`: of the first pose, of odometry in rotation and
    /// translation (radians, metres); `keyframe`: pose in the frame before as quaternion xyzw and translation; `see`: number of
    /// a point, its column in the left and right image, and its row, in the keyframe above; `map`: number of a point that is
    /// known, and where it is.
    pub fn to_text(&self) -> String {
        let [fx, fy] = CAMERA.focal_px;
        let [cx, cy] = CAMERA.centre_px;
        let baseline_m = CAMERA.baseline_m;
        let mut text = format!(
            "# a growing walk with a stereo camera\ncamera {fx} {fy} {cx} {cy} {baseline_m} {HUBER_PX}\n"
        );
        text += &format!("sigmas {FIRST_SIGMA} {ROTATION_SIGMA} {TRANSLATION_SIGMA}\n");
        let join = |numbers: &[f64]| {
            let numbers: Vec<String> = numbers.iter().map(f64::to_string).collect();
            numbers.join(" ")
        };
        for (number, place) in &self.map {
            text += &format!("map {number} {}\n", join(place.as_slice()));
        }
        for keyframe in &self.keyframes {
            let pose = &keyframe.odometry;
            let rotation = join(pose.rotation.quaternion().coords.as_slice());
            let translation = join(pose.translation.as_slice());
            text += &format!("keyframe {rotation} {translation}\n");
            for (point, pixel) in &keyframe.seen {
                text += &format!("see {point} {}\n", join(pixel.as_slice()));
            }
        }
        text
    }
}

fn pose(radius: f64, angle: f64) -> Se3 {
    let (sin, cos) = angle.sin_cos();
    let forward = Vector3::new(-sin, cos, 0.0);
    let right = Vector3::new(cos, sin, 0.0);
    let down = Vector3::new(0.0, 0.0, -1.0);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
    Se3::new(
        UnitQuaternion::from_rotation_matrix(&rotation),
        Vector3::new(radius * cos, radius * sin, 0.0),
    )
}

/// Where a walk is added to: a problem that grows, or one that is solved at once.
pub enum Target<'a> {
    Growing(&'a mut Incremental),
    Whole(&'a mut Problem),
}

impl Target<'_> {
    fn add_residual(
        &mut self,
        residual: impl Residual + 'static,
        blocks: &[BlockId],
        kernel: Kernel,
    ) -> Result<ResidualId, Error> {
        match self {
            Self::Growing(problem) => problem.add_residual(residual, blocks, kernel),
            Self::Whole(problem) => problem.add_residual(residual, blocks, kernel),
        }
    }

    fn add_pose(&mut self, pose: Se3) -> Block<Se3> {
        match self {
            Self::Growing(problem) => problem.add_block(pose),
            Self::Whole(problem) => problem.add_block(pose),
        }
    }

    fn add_point(&mut self, point: Vector3<f64>) -> Block<Vector3<f64>> {
        match self {
            Self::Growing(problem) => problem.add_eliminated_point(point),
            Self::Whole(problem) => problem.add_eliminated_point(point),
        }
    }

    fn add_known_point(&mut self, point: Vector3<f64>) -> Block<Vector3<f64>> {
        match self {
            Self::Growing(problem) => {
                let block = problem.add_block(point);
                problem.set_constant(block);
                block
            }
            Self::Whole(problem) => {
                let block = problem.add_block(point);
                problem.set_constant(block);
                block
            }
        }
    }

    fn pose(&self, block: Block<Se3>) -> Se3 {
        match self {
            Self::Growing(problem) => problem.value(block),
            Self::Whole(problem) => problem.value(block),
        }
    }
}

/// The blocks of what was added so far, and the values they began with.
#[derive(Default)]
pub struct Added {
    pub poses: Vec<Block<Se3>>,
    pub points: Vec<Option<Block<Vector3<f64>>>>,
    pub first_poses: Vec<Se3>,
    pub first_points: Vec<Option<Vector3<f64>>>,
}

impl Added {
    /// Adds the next keyframe of a walk. What `begun` began with is used again where it goes that far.
    pub fn add(
        &mut self,
        walk: &Walk,
        target: &mut Target<'_>,
        begun: Option<&Added>,
    ) -> Result<(), Error> {
        let k = self.poses.len();
        let keyframe = &walk.keyframes[k];
        let guess = match (begun, self.poses.last()) {
            (Some(begun), _) => begun.first_poses[k],
            (None, Some(last)) => target.pose(*last) * keyframe.odometry,
            (None, None) => keyframe.odometry,
        };
        let pose = target.add_pose(guess);
        match self.poses.last() {
            Some(last) => {
                let (r, t) = (ROTATION_SIGMA, TRANSLATION_SIGMA);
                let sigmas = Vector6::new(r, r, r, t, t, t);
                let between = Between {
                    b_from_a_measured: keyframe.odometry.inverse(),
                    sqrt_information: Matrix6::from_diagonal(&sigmas.map(|s| 1.0 / s)),
                };
                target.add_residual(between, &[last.id(), pose.id()], Kernel::Squared)?;
            }
            None => {
                let prior = PosePrior::isotropic(guess, FIRST_SIGMA, FIRST_SIGMA);
                target.add_residual(prior, &[pose.id()], Kernel::Squared)?;
            }
        }
        self.poses.push(pose);
        self.first_poses.push(guess);
        self.points.resize(walk.points, None);
        self.first_points.resize(walk.points, None);
        for (number, pixel) in &keyframe.seen {
            let point = match self.points[*number] {
                Some(point) => point,
                None => {
                    let point = match walk.map.get(number) {
                        Some(place) => target.add_known_point(*place),
                        None => {
                            let start = begun
                                .and_then(|b| b.first_points[*number])
                                .unwrap_or_else(|| guess * triangulated(pixel));
                            self.first_points[*number] = Some(start);
                            target.add_point(start)
                        }
                    };
                    self.points[*number] = Some(point);
                    point
                }
            };
            let seen = StereoObservation {
                camera: CAMERA,
                measured_px: *pixel,
            };
            target.add_residual(
                seen,
                &[pose.id(), point.id()],
                Kernel::Huber { scale: HUBER_PX },
            )?;
        }
        Ok(())
    }
}

/// Solves a problem from where it is to the last digit, and gives its cost there: a cost that no longer falls by 1e-12 of itself
/// leaves poses micrometres from the optimum.
pub fn solve_to_the_last_digit(problem: &mut Problem) -> Result<f64, Error> {
    let config = SolveConfig {
        cost_tolerance: 0.0,
        gradient_tolerance: 0.0,
        step_tolerance: 1e-13,
        initial_damping: 1e-12,
        max_iterations: 200,
        diagnosis: Diagnosis::Off,
        ..SolveConfig::default()
    };
    Ok(solve(problem, &config)?.final_cost)
}

/// Largest distance between the positions of poses, metres; infinite where one is no number.
pub fn farthest_m(poses: impl IntoIterator<Item = (Se3, Se3)>) -> f64 {
    poses.into_iter().fold(0.0, |farthest, (a, b)| {
        let apart_m = (a.translation - b.translation).norm();
        // `f64::max` would pass over what is no number.
        if apart_m.is_nan() {
            f64::INFINITY
        } else {
            apart_m.max(farthest)
        }
    })
}

/// A point in the camera, from what both of its images saw.
fn triangulated(pixel: &Vector3<f64>) -> Vector3<f64> {
    let disparity = (pixel.x - pixel.y).max(1.0);
    let z = CAMERA.focal_px[0] * CAMERA.baseline_m / disparity;
    Vector3::new(
        (pixel.x - CAMERA.centre_px[0]) * z / CAMERA.focal_px[0],
        (pixel.z - CAMERA.centre_px[1]) * z / CAMERA.focal_px[1],
        z,
    )
}
