//! A board before a LiDAR and a camera, at the level of returns and corners: exact truth, noise as a parameter, seeded.

use std::f64::consts::{PI, TAU};

use lsfb_calib::Target;
use lsfb_calib::detect::Corner;
use lsfb_calib::lidar_camera::{
    BoardPose, BoardSight, LidarCameraCalibration, LidarCameraConfig, MountedBoard,
    calibrate_lidar_camera,
};
use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, Matrix3, Se3, UnitQuaternion, Vector2, Vector3, Vector6};
use lsfb_types::{LidarPoint, LidarScan, no_progress};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The board as it is said to be.
pub const BOARD: MountedBoard = MountedBoard {
    target: Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088,
        spacing_ratio: 0.3,
    },
    width_m: 0.83,
    height_m: 0.75,
    offset_m: [0.0, 0.0],
};

/// VLP-32C (63-9325, p. 54): elevation in 0.001°, azimuth offset in 0.1°, from the lowest beam.
const BEAMS: [(i32, i32); 32] = [
    (-25_000, 14),
    (-15_639, -14),
    (-11_310, 14),
    (-8_843, -14),
    (-7_254, 14),
    (-6_148, -14),
    (-5_333, 42),
    (-4_667, 14),
    (-4_000, -14),
    (-3_667, -42),
    (-3_333, 42),
    (-3_000, 14),
    (-2_667, -14),
    (-2_333, -42),
    (-2_000, 42),
    (-1_667, 14),
    (-1_333, -14),
    (-1_000, -42),
    (-667, 42),
    (-333, 14),
    (0, -14),
    (333, -42),
    (667, 42),
    (1_000, 14),
    (1_333, -14),
    (1_667, -42),
    (2_333, 14),
    (3_333, -14),
    (4_667, 14),
    (7_000, -14),
    (10_333, 14),
    (15_000, -14),
];

/// The camera.
pub fn camera() -> Camera {
    Camera {
        width: 1280,
        height: 800,
        lens: Lens::KannalaBrandt {
            focal_px: [560.0, 561.0],
            principal_px: [641.0, 397.0],
            distortion: [-0.02, 0.006, -0.003, 0.0004],
        },
    }
}

/// The LiDAR in a camera that looks along its x axis, a little beside and below it.
pub fn truth() -> Se3 {
    let axes = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0);
    let forward = UnitQuaternion::from_matrix(&axes);
    Se3::new(forward, Vector3::zeros())
        * Se3::exp(&Vector6::new(0.02, -0.03, 0.01, 0.1, 0.02, -0.2))
}

/// What is simulated.
#[derive(Clone, Copy, Debug)]
pub struct Session {
    pub poses: usize,
    pub tilt_rad: f64,
    pub noise_m: f64,
    /// The board as it is.
    pub board: MountedBoard,
    /// Whether the LiDAR does not see it.
    pub behind_wall: bool,
    /// Whether every other pose has the board on its head.
    pub turned: bool,
    /// Speed of the board to the rig, m/s, and half as much in rad/s.
    pub speed_m_s: f64,
    /// By how much the LiDAR's stamps are late, seconds.
    pub lidar_late_s: f64,
    /// By how much ranges to its dark half, x below zero, are longer than to its bright one, metres.
    pub dark_excess_m: f64,
}

impl Default for Session {
    fn default() -> Self {
        Self {
            poses: 30,
            tilt_rad: 0.7,
            noise_m: 0.03,
            board: BOARD,
            behind_wall: false,
            turned: false,
            speed_m_s: 0.0,
            lidar_late_s: 0.0,
            dark_excess_m: 0.0,
        }
    }
}

fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..1.0));
    (-2.0 * a.ln()).sqrt() * (TAU * b).cos()
}

/// Where the board is in the camera over time.
struct Motion {
    start: Se3,
    velocity: Vector6<f64>,
}

impl Motion {
    fn at(&self, time_s: f64) -> Se3 {
        self.start * Se3::exp(&(self.velocity * time_s))
    }
}

impl Session {
    /// The poses of a seed.
    pub fn simulate(&self, seed: u64) -> Vec<BoardPose> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut poses = Vec::new();
        while poses.len() < self.poses {
            let motion = self.motion(poses.len(), &mut rng);
            if self.beams(&motion.start) < MIN_BEAMS {
                continue;
            }
            // Three images around the scan, or one of a board at rest.
            let times_s: &[f64] = if self.speed_m_s > 0.0 {
                &[-0.02, 0.04, 0.12]
            } else {
                &[0.0]
            };
            let sights: Option<Vec<BoardSight>> = times_s
                .iter()
                .map(|t| {
                    Some(BoardSight {
                        instant: 0,
                        time_offset_ns: (t * 1e9) as i64,
                        corners: self.corners(&motion.at(*t), &mut rng)?,
                    })
                })
                .collect();
            let Some(sights) = sights else {
                continue;
            };
            poses.push(BoardPose {
                name: format!("pose {:02}", poses.len()),
                sights,
                scan: self.scan(&motion, &mut rng),
            });
        }
        poses
    }

    fn motion(&self, number: usize, rng: &mut ChaCha8Rng) -> Motion {
        let mut uniform = |size: f64| rng.random_range(-1.0..=1.0) * size;
        let distance = 2.0 + uniform(0.7);
        let place = Vector3::new(uniform(0.45) * distance, uniform(0.2) * distance, distance);
        let tilt = [uniform(self.tilt_rad), uniform(self.tilt_rad)];
        let spin = uniform(0.6)
            + if self.turned && number % 2 == 1 {
                PI
            } else {
                0.0
            };
        let facing = UnitQuaternion::from_euler_angles(PI, 0.0, 0.0);
        let tilted = UnitQuaternion::from_euler_angles(tilt[0], tilt[1], spin);
        let velocity = if self.speed_m_s > 0.0 {
            Vector6::from_fn(|k, _| uniform(self.speed_m_s) * if k < 3 { 0.5 } else { 1.0 })
        } else {
            Vector6::zeros()
        };
        Motion {
            start: Se3::new(tilted * facing, place),
            velocity,
        }
    }

    /// Beams whose elevation lies between those of the lowest and the highest point of the board.
    fn beams(&self, camera_from_board: &Se3) -> usize {
        let lidar_from_board = truth().inverse() * *camera_from_board;
        let half = [0.5 * self.board.width_m, 0.5 * self.board.height_m];
        let elevations = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|[x, y]| {
            let corner = lidar_from_board * Vector3::new(x * half[0], y * half[1], 0.0);
            (corner.z / corner.norm()).asin().to_degrees() * 1e3
        });
        let low = elevations.iter().copied().fold(f64::INFINITY, f64::min);
        let high = elevations.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let meets = |beam: &&(i32, i32)| (low..high).contains(&f64::from(beam.0));
        BEAMS.iter().filter(meets).count()
    }

    /// All corners, or `None` where one is out of view.
    fn corners(&self, camera_from_board: &Se3, rng: &mut ChaCha8Rng) -> Option<Vec<Corner>> {
        let camera = camera();
        (0..self.board.target.corner_count())
            .map(|index| {
                let point = *camera_from_board * self.board.corner(index);
                let pixel = camera.project(&point).filter(|p| camera.contains(p, 5.0))?;
                let noise = Vector2::new(gauss(rng), gauss(rng)) * 0.15;
                Some(Corner {
                    index,
                    pixel: pixel + noise,
                })
            })
            .collect()
    }

    /// The board on a pole in a room of 9 × 7 × 3 m.
    fn scan(&self, motion: &Motion, rng: &mut ChaCha8Rng) -> LidarScan {
        const TURN_S: f64 = 0.1;
        let half = [0.5 * self.board.width_m, 0.5 * self.board.height_m];
        let low = Vector3::new(-4.0, -3.5, -1.3);
        let high = Vector3::new(5.0, 3.5, 1.7);
        let phase = rng.random_range(0.0..0.2);
        let mut points = Vec::new();
        for step in 0..1800 {
            let time_s = TURN_S * f64::from(step) / 1800.0;
            let camera_from_board = motion.at(time_s - self.lidar_late_s);
            let lidar_from_board = truth().inverse() * camera_from_board;
            let board_from_lidar = lidar_from_board.inverse();
            let origin = board_from_lidar.translation;
            // Behind the board, whichever way it is tilted.
            let rear = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]
                .map(|[x, y]| lidar_from_board * Vector3::new(x * half[0], y * half[1], 0.0))
                .iter()
                .fold(f64::NEG_INFINITY, |far, corner| far.max(corner.x));
            let middle = lidar_from_board.translation;
            let pole = Vector3::new(rear + POLE_BEHIND_M, middle.y, middle.z);
            for (ring, (elevation, offset)) in BEAMS.iter().enumerate() {
                let azimuth =
                    (0.2 * f64::from(step) + phase + 0.1 * f64::from(*offset)).to_radians();
                let elevation = (f64::from(*elevation) * 1e-3).to_radians();
                let ray = Vector3::new(
                    elevation.cos() * azimuth.cos(),
                    elevation.cos() * azimuth.sin(),
                    elevation.sin(),
                );
                let mut range = (0..3)
                    .map(|k| if ray[k] > 0.0 { high[k] } else { low[k] } / ray[k])
                    .fold(f64::INFINITY, f64::min);
                let in_board = board_from_lidar.rotation * ray;
                let depth = -origin.z / in_board.z;
                let hit = origin + in_board * depth;
                let on_board = hit.x.abs() < half[0] && hit.y.abs() < half[1];
                let mut intensity = BRIGHT;
                if depth > 0.0 && on_board && !self.behind_wall && depth < range {
                    let is_dark = hit.x < 0.0;
                    range = depth + if is_dark { self.dark_excess_m } else { 0.0 };
                    intensity = if is_dark { DARK } else { BRIGHT };
                }
                // A pole of 4 cm from the middle of the board to the floor.
                let flat = ray.xy().norm_squared();
                let along = pole.xy().dot(&ray.xy()) / flat;
                let miss = (ray.xy() * along - pole.xy()).norm();
                if along > 0.0 && miss < 0.02 && ray.z * along < pole.z {
                    range = range.min(along);
                }
                let range = range + self.noise_m * gauss(rng);
                let range = (range / 0.004).round() * 0.004;
                points.push(LidarPoint {
                    position_m: (ray * range).map(|x| x as f32).into(),
                    ring: ring as u16,
                    time_offset_ns: (time_s * 1e9) as u32,
                    intensity,
                    ..LidarPoint::default()
                });
            }
        }
        LidarScan { points }
    }
}

/// Intensities of the two halves of the board.
const DARK: u8 = 3;
const BRIGHT: u8 = 60;

/// Beams that meet the board where it is held: by three it could be seen, by as many more it is.
const MIN_BEAMS: usize = 6;

/// How far behind the rearmost corner of the board its pole stands, metres.
const POLE_BEHIND_M: f64 = 0.06;

/// Calibrates with the default settings.
pub fn calibrate(
    board: &MountedBoard,
    poses: &[BoardPose],
) -> Result<LidarCameraCalibration, lsfb_calib::Error> {
    let config = LidarCameraConfig::default();
    calibrate_lidar_camera(board, "cam0", &camera(), poses, &config, &no_progress)
}

/// What was found to the truth: rotation (rad) and translation (m), in LiDAR axes.
pub fn error(found: &LidarCameraCalibration) -> Vector6<f64> {
    (found.camera_from_lidar.inverse() * truth()).log()
}
