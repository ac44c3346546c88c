//! A rig in front of a board, at the level of corners and samples: exact truth, noise as a parameter, seeded.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use lsfb_calib::Target;
use lsfb_calib::camera::CameraViews;
use lsfb_calib::camera_imu::KnownCamera;
use lsfb_calib::detect::Corner;
use lsfb_geometry::camera::Lens;
use lsfb_geometry::rolling_shutter::row_time_s;
use lsfb_geometry::{
    Camera, ImuNoiseModel, Matrix3, Se3, UnitQuaternion, Vector2, Vector3, Vector6, so3,
};
use lsfb_types::{ImuSample, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The board.
pub const GRID: Target = Target::AprilGrid {
    columns: 6,
    rows: 6,
    tag_size_m: 0.088,
    spacing_ratio: 0.3,
};

/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.80665;
/// When the recording begins: a number that floats do not hold to the nanosecond.
const ORIGIN_NS: i64 = 1_772_359_200_000_000_000;

/// What is simulated.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// Seed of motion and noise.
    pub seed: u64,
    /// Length of the recording, seconds.
    pub duration_s: f64,
    /// Views per second of each camera.
    pub view_rate_hz: f64,
    /// Standard deviation of a corner in one direction, pixels.
    pub corner_sigma_px: f64,
    /// Amplitude of turning about each axis of the rig, rad.
    pub turning_rad: [f64; 3],
    /// Readout time of all cameras, seconds.
    pub readout_s: f64,
    /// Seconds by which the second camera's clock runs away from the IMU's in each second.
    pub drift: f64,
    /// Direction of the board's y axis: 1 up, −1 down.
    pub up: f64,
    /// How much later than the gyroscope the accelerometer measures, seconds.
    pub accel_delay_s: f64,
    /// Errors of the accelerometer's and gyroscope's scales.
    pub scale_error: f64,
    /// Standard deviation of each axis' scale, and of each angle (rad) by which it leans towards another, of both triads.
    pub axes_sigma: f64,
    /// Standard deviation of gravity's magnitude about the standard one, m/s².
    pub gravity_sigma_m_s2: f64,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            seed: 1,
            duration_s: 12.0,
            view_rate_hz: 20.0,
            corner_sigma_px: 0.15,
            turning_rad: [0.35, 0.3, 0.3],
            readout_s: 0.0,
            drift: 0.0,
            up: 1.0,
            accel_delay_s: 0.0,
            scale_error: 0.0,
            axes_sigma: 0.0,
            gravity_sigma_m_s2: 1e-3,
        }
    }
}

/// One camera as it is.
#[derive(Clone, Debug)]
pub struct TrueCamera {
    pub camera: Camera,
    pub camera_from_rig: Se3,
    pub rig_from_camera_s: f64,
}

/// What the sensors say, and the truth.
#[derive(Clone, Debug)]
pub struct Simulated {
    pub views: Vec<CameraViews>,
    pub imu: Vec<(Timestamp, ImuSample)>,
    pub truth: Vec<TrueCamera>,
    /// In the middle of the recording, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// In the middle of the recording, m/s².
    pub accel_bias: Vector3<f64>,
    /// In the target's frame, m/s².
    pub gravity: Vector3<f64>,
}

/// The IMU's noise.
pub fn noise() -> ImuNoiseModel {
    ImuNoiseModel {
        gyro_noise_density: 1.6e-4,
        accel_noise_density: 2e-3,
        gyro_bias_walk: 2e-5,
        accel_bias_walk: 2e-4,
    }
}

impl Simulated {
    /// Cameras with lenses and poses that are a little off, as a first calibration leaves them.
    pub fn known(&self) -> Vec<KnownCamera> {
        let first = self.truth[0].camera_from_rig;
        self.views
            .iter()
            .zip(&self.truth)
            .map(|(views, truth)| {
                let mut values = truth.camera.lens.parameters().values;
                values[0] *= 1.002;
                values[1] *= 1.002;
                values[2] += 0.3;
                let off = Se3::exp(&Vector6::new(1e-3, 0.0, -1e-3, 1e-3, 0.0, 1e-3));
                KnownCamera {
                    views: views.clone(),
                    camera: Camera {
                        lens: truth.camera.lens.model().lens(&values),
                        ..truth.camera
                    },
                    camera_from_first: truth.camera_from_rig * first.inverse() * off,
                    readout_s: 0.0,
                }
            })
            .collect()
    }
}

/// A sum of sines for each of three axes.
struct Waves(Vec<[Vector3<f64>; 3]>);

impl Waves {
    fn new(rng: &mut ChaCha8Rng, amplitude: Vector3<f64>) -> Self {
        Self(
            [0.23, 0.51, 0.87]
                .iter()
                .map(|hz| {
                    let mut vary =
                        |low: f64, high: f64| Vector3::from_fn(|_, _| rng.random_range(low..high));
                    let rate = vary(0.8, 1.25) * (hz * TAU);
                    let size = amplitude.component_mul(&vary(0.4, 0.7));
                    [size, rate, vary(0.0, TAU)]
                })
                .collect(),
        )
    }

    /// Value, first and second derivative.
    fn at(&self, t: f64) -> [Vector3<f64>; 3] {
        let mut sums = [Vector3::zeros(); 3];
        for [size, rate, phase] in &self.0 {
            for k in 0..3 {
                let (sin, cos) = (rate[k] * t + phase[k]).sin_cos();
                sums[0][k] += size[k] * sin;
                sums[1][k] += size[k] * rate[k] * cos;
                sums[2][k] -= size[k] * rate[k] * rate[k] * sin;
            }
        }
        sums
    }
}

/// The motion: `target_from_rig` with its derivatives.
struct Motion {
    base: UnitQuaternion<f64>,
    turning: Waves,
    moving: Waves,
}

impl Motion {
    fn pose(&self, t: f64) -> Se3 {
        let centre = Vector3::new(0.33, 0.33, 0.75);
        Se3::new(
            self.base * so3::exp(&self.turning.at(t)[0]),
            centre + self.moving.at(t)[0],
        )
    }

    fn sample(&self, t: f64, gravity: &Vector3<f64>) -> [Vector3<f64>; 2] {
        let [turn, rate, _] = self.turning.at(t);
        let force = self.pose(t).rotation.inverse() * (self.moving.at(t)[2] - gravity);
        [so3::right_jacobian(&turn) * rate, force]
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..TAU));
    (-2.0 * u.ln()).sqrt() * v.cos()
}

fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

fn cameras(rng: &mut ChaCha8Rng) -> Vec<TrueCamera> {
    // Camera x is the rig's −y, camera y its −z, camera z its x.
    let rig_from_camera = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let facing = UnitQuaternion::from_matrix(&rig_from_camera);
    [0.06, -0.05]
        .iter()
        .map(|y| {
            let tilt = so3::exp(&(normal3(rng) * 0.03));
            let place = Vector3::new(0.03, *y, 0.02) + normal3(rng) * 0.01;
            TrueCamera {
                camera: Camera {
                    width: 640,
                    height: 480,
                    lens: Lens::KannalaBrandt {
                        focal_px: [310.0 + rng.random_range(-5.0..5.0), 311.0],
                        principal_px: [318.0 + rng.random_range(-4.0..4.0), 243.0],
                        distortion: [0.01, -0.008, 0.003, -0.0008],
                    },
                },
                camera_from_rig: Se3::new(facing * tilt, place).inverse(),
                rig_from_camera_s: rng.random_range(-0.02..0.02),
            }
        })
        .collect()
}

/// Simulates.
pub fn simulate(setup: &Setup) -> Simulated {
    let mut rng = ChaCha8Rng::seed_from_u64(setup.seed);
    let truth = cameras(&mut rng);
    // Looking at the board: x into it, y against its x, z along its y.
    let base = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0);
    let motion = Motion {
        base: UnitQuaternion::from_matrix(&base),
        turning: Waves::new(&mut rng, setup.turning_rad.into()),
        moving: Waves::new(&mut rng, Vector3::new(0.2, 0.18, 0.15)),
    };
    // A stream of its own: the noise of a seed stays what it was.
    let mut place = ChaCha8Rng::seed_from_u64(setup.seed ^ 0x67);
    let magnitude = GRAVITY_M_S2 + setup.gravity_sigma_m_s2 * normal(&mut place);
    let gravity = Vector3::new(0.0, -magnitude * setup.up, 0.0);
    let mut leaning = ChaCha8Rng::seed_from_u64(setup.seed ^ 0x4178);
    let axes = [(); 2].map(|()| {
        Matrix3::identity() * (1.0 + setup.scale_error)
            + Matrix3::from_fn(|_, _| setup.axes_sigma * normal(&mut leaning))
    });
    let (imu, [gyro_bias, accel_bias]) = imu(setup, &motion, &gravity, &axes, &mut rng);
    let views = truth
        .iter()
        .enumerate()
        .map(|(k, camera)| views(setup, k, camera, &motion, &mut rng))
        .collect();
    Simulated {
        views,
        imu,
        truth,
        gyro_bias,
        accel_bias,
        gravity,
    }
}

fn imu(
    setup: &Setup,
    motion: &Motion,
    gravity: &Vector3<f64>,
    axes: &[Matrix3<f64>; 2],
    rng: &mut ChaCha8Rng,
) -> (Vec<(Timestamp, ImuSample)>, [Vector3<f64>; 2]) {
    const RATE_HZ: f64 = 200.0;
    let noise = noise();
    let mut gyro_bias = normal3(rng) * 0.005;
    let mut accel_bias = normal3(rng) * 0.03;
    let mut middle = [Vector3::zeros(); 2];
    let count = (setup.duration_s * RATE_HZ) as i64;
    let samples = (0..count)
        .map(|k| {
            let time_s = k as f64 / RATE_HZ;
            let [rate, _] = motion.sample(time_s, gravity);
            let [_, force] = motion.sample(time_s - setup.accel_delay_s, gravity);
            let root = RATE_HZ.sqrt();
            let gyro =
                axes[0] * rate + gyro_bias + normal3(rng) * (noise.gyro_noise_density * root);
            let accel =
                axes[1] * force + accel_bias + normal3(rng) * (noise.accel_noise_density * root);
            if k == count / 2 {
                middle = [gyro_bias, accel_bias];
            }
            gyro_bias += normal3(rng) * (noise.gyro_bias_walk / root);
            accel_bias += normal3(rng) * (noise.accel_bias_walk / root);
            let sample = ImuSample {
                angular_velocity_rad_s: gyro.into(),
                specific_force_m_s2: accel.into(),
            };
            (Timestamp::from_nanos(ORIGIN_NS + k * 5_000_000), sample)
        })
        .collect();
    (samples, middle)
}

fn views(
    setup: &Setup,
    number: usize,
    camera: &TrueCamera,
    motion: &Motion,
    rng: &mut ChaCha8Rng,
) -> CameraViews {
    let mut views = BTreeMap::new();
    let count = ((setup.duration_s - 0.3) * setup.view_rate_hz) as i64;
    for k in 0..count {
        let stamp_s = 0.15 + k as f64 / setup.view_rate_hz;
        let drift_s = if number == 1 {
            setup.drift * stamp_s
        } else {
            0.0
        };
        let time_s = stamp_s + camera.rig_from_camera_s + drift_s;
        let corners: Vec<Corner> = (0..GRID.corner_count())
            .filter_map(|index| {
                let project = |time_s: f64| -> Option<Vector2<f64>> {
                    let in_rig = motion.pose(time_s).inverse() * GRID.corner(index);
                    camera.camera.project(&(camera.camera_from_rig * in_rig))
                };
                let mut pixel = project(time_s)?;
                if setup.readout_s != 0.0 {
                    for _ in 0..8 {
                        let row_s = row_time_s(&camera.camera, setup.readout_s, pixel.y);
                        pixel = project(time_s + row_s)?;
                    }
                }
                camera.camera.contains(&pixel, 2.0).then(|| Corner {
                    index,
                    pixel: pixel + Vector2::new(normal(rng), normal(rng)) * setup.corner_sigma_px,
                })
            })
            .collect();
        if corners.len() >= 12 {
            views.insert(ORIGIN_NS + (stamp_s * 1e9).round() as i64, corners);
        }
    }
    CameraViews {
        name: format!("cam{number}"),
        width: camera.camera.width,
        height: camera.camera.height,
        images: count as usize,
        views,
    }
}
