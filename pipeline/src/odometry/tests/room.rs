//! A furnished room in closed form: boxes, a walk with known derivatives, a VLP-32C and an IMU in it.

use lsfb_geometry::{ImuNoiseModel, RigCamera, RigLidar, Se3, Vector2, Vector3, Vector6, so3};
use lsfb_types::{Image, ImuSample, LidarPoint, LidarScan, Stamped, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// VLP-32C elevations in firing order, degrees (User Manual 63-9325, table 9-2).
const ELEVATIONS_DEG: [f64; 32] = [
    -25.0, -1.0, -1.667, -15.639, -11.31, 0.0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148,
    -5.333, 1.333, 0.667, -4.0, -4.667, 1.667, 1.0, -3.667, -3.333, 3.333, 2.333, -2.667, -3.0,
    7.0, 4.667, -2.333, -2.0, 15.0, 10.333, -1.333,
];

struct Solid {
    low: Vector3<f64>,
    high: Vector3<f64>,
}

pub struct Room {
    /// The first is the room itself, seen from inside; the rest stand in it.
    solids: Vec<Solid>,
}

impl Room {
    /// 9 m × 4 m × 2.6 m, divided by a thin wall with a door, with some furniture.
    pub fn furnished() -> Self {
        let solid = |l: [f64; 3], h: [f64; 3]| Solid {
            low: l.into(),
            high: h.into(),
        };
        Self {
            solids: vec![
                solid([-2.5, -2.0, 0.0], [6.5, 2.0, 2.6]),
                solid([2.5, -2.0, 0.0], [2.6, 0.3, 2.6]),
                solid([2.5, 1.3, 0.0], [2.6, 2.0, 2.6]),
                solid([-2.5, -2.0, 0.0], [-1.7, -0.8, 0.75]),
                solid([-2.5, 1.2, 0.0], [-2.1, 2.0, 1.9]),
                solid([0.5, -2.0, 0.0], [1.7, -1.5, 0.9]),
                solid([5.2, 1.4, 0.0], [6.5, 2.0, 1.2]),
                solid([4.0, -2.0, 0.0], [4.3, -1.7, 2.6]),
            ],
        }
    }

    /// Boxes, each by its lowest and its highest corner: the first is seen from inside, the rest stand in it.
    pub fn of(boxes: &[[[f64; 3]; 2]]) -> Self {
        let solid = |[low, high]: &[[f64; 3]; 2]| Solid {
            low: (*low).into(),
            high: (*high).into(),
        };
        Self {
            solids: boxes.iter().map(solid).collect(),
        }
    }

    /// What a VLP-32C that stands sees, in its own frame.
    pub fn seen_from(&self, world_from_lidar: &Se3, noise_m: f64, seed: u64) -> Vec<Vector3<f64>> {
        const FIRINGS: u64 = 450;
        (0..FIRINGS)
            .into_par_iter()
            .flat_map_iter(|firing| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed * FIRINGS + firing);
                let azimuth = std::f64::consts::TAU * firing as f64 / FIRINGS as f64;
                let points: Vec<_> = ELEVATIONS_DEG
                    .iter()
                    .map(|elevation| {
                        let e = elevation.to_radians();
                        let ray =
                            Vector3::new(e.cos() * azimuth.cos(), e.cos() * azimuth.sin(), e.sin());
                        let in_world = world_from_lidar.rotation * ray;
                        let range = self.cast(&world_from_lidar.translation, &in_world);
                        ray * (range + noise_m * gaussian(&mut rng))
                    })
                    .collect();
                points
            })
            .collect()
    }

    /// The furnished room with floor and ceiling out of sight: nothing but the IMU tells the height.
    pub fn without_floor() -> Self {
        let mut room = Self::furnished();
        for solid in &mut room.solids {
            (solid.low.z, solid.high.z) = (-40.0, 40.0);
        }
        room
    }

    /// A corridor whose ends are out of sight: nothing but the IMU tells how far one is.
    pub fn endless_corridor() -> Self {
        Self {
            solids: vec![Solid {
                low: [-300.0, -1.5, 0.0].into(),
                high: [300.0, 1.5, 2.6].into(),
            }],
        }
    }

    /// Distance of a point to the nearest surface.
    pub fn distance_to_surface(&self, point: &Vector3<f64>) -> f64 {
        let off = |solid: &Solid| {
            let outside = (solid.low - point).sup(&(point - solid.high));
            let inside = outside.max();
            if inside <= 0.0 {
                -inside
            } else {
                outside.map(|x| x.max(0.0)).norm()
            }
        };
        self.solids.iter().map(off).fold(f64::INFINITY, f64::min)
    }

    /// Distance of a point to the nearest edge of a solid that runs along `direction` (within 15°).
    pub fn distance_to_edge(&self, point: &Vector3<f64>, direction: &Vector3<f64>) -> f64 {
        let axis = direction.abs().imax();
        if direction[axis].abs() < 0.966 {
            return f64::INFINITY;
        }
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let off = |solid: &Solid| {
            let beyond = (solid.low[axis] - point[axis]).max(point[axis] - solid.high[axis]);
            let across = |k: usize| {
                let to_low = (point[k] - solid.low[k]).abs();
                to_low.min((point[k] - solid.high[k]).abs())
            };
            across(u).hypot(across(v)).hypot(beyond.max(0.0))
        };
        self.solids.iter().map(off).fold(f64::INFINITY, f64::min)
    }

    /// Distance along a unit ray to the first surface.
    pub fn cast(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> f64 {
        let mut nearest = f64::INFINITY;
        for (i, solid) in self.solids.iter().enumerate() {
            let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
            for axis in 0..3 {
                let a = (solid.low[axis] - origin[axis]) / direction[axis];
                let b = (solid.high[axis] - origin[axis]) / direction[axis];
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
            if i == 0 {
                nearest = nearest.min(leave);
            } else if enter < leave && enter > 0.0 {
                nearest = nearest.min(enter);
            }
        }
        nearest
    }
}

/// A walk that stands for a second, then wanders through the door and back while turning and swaying.
pub fn world_from_rig(t: f64) -> Se3 {
    let w = (t - 1.0).max(0.0);
    // starts with zero velocity and acceleration
    let s = w - 1.0 + (-w).exp() * (1.0 + 0.5 * w * w);
    let position = Vector3::new(
        2.0 * (1.0 - (0.5 * s).cos()),
        0.6 * (0.4 * s).sin(),
        1.5 + 0.03 * (2.0 * s).sin(),
    );
    let yaw = Vector3::new(0.0, 0.0, 1.5 * (0.45 * s).sin());
    let sway = Vector3::new(0.05 * (1.9 * s).sin(), 0.08 * (1.3 * s).sin(), 0.0);
    Se3::new(so3::exp(&yaw) * so3::exp(&sway), position)
}

pub fn lidar() -> RigLidar {
    RigLidar {
        rig_from_lidar: Se3::exp(&Vector6::new(0.02, -0.03, 0.5, 0.05, 0.02, 0.35)),
        range_noise_m: 0.03,
    }
}

pub fn imu() -> ImuNoiseModel {
    ImuNoiseModel {
        gyro_noise_density: 1e-4,
        accel_noise_density: 1e-3,
        gyro_bias_walk: 1e-5,
        accel_bias_walk: 1e-4,
    }
}

fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

pub fn time(t: f64) -> Timestamp {
    Timestamp::from_nanos(1_772_359_200_000_000_000).plus_secs(t)
}

/// One revolution that begins at `t`, a firing each 111 µs.
pub fn scan(room: &Room, t: f64, seed: u64) -> Stamped<LidarScan> {
    scan_on(world_from_rig, room, t, seed)
}

/// The same on another walk.
pub fn scan_on(motion: fn(f64) -> Se3, room: &Room, t: f64, seed: u64) -> Stamped<LidarScan> {
    const FIRINGS: u64 = 900;
    let lidar = lidar();
    let points = (0..FIRINGS)
        .into_par_iter()
        .flat_map_iter(|firing| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed * FIRINGS + firing);
            let offset_ns = firing * 100_000_000 / FIRINGS;
            let world_from_lidar = motion(t + offset_ns as f64 * 1e-9) * lidar.rig_from_lidar;
            let azimuth = -std::f64::consts::TAU * firing as f64 / FIRINGS as f64;
            let points: Vec<_> = ELEVATIONS_DEG
                .iter()
                .map(|elevation| {
                    let below = ELEVATIONS_DEG.iter().filter(|e| *e < elevation);
                    let ring = below.count() as u16;
                    let e = elevation.to_radians();
                    let ray =
                        Vector3::new(e.cos() * azimuth.cos(), e.cos() * azimuth.sin(), e.sin());
                    let range = room.cast(
                        &world_from_lidar.translation,
                        &(world_from_lidar.rotation * ray),
                    );
                    let p = ray * (range + lidar.range_noise_m * gaussian(&mut rng));
                    LidarPoint {
                        position_m: [p.x as f32, p.y as f32, p.z as f32],
                        intensity: 10,
                        ring,
                        time_offset_ns: offset_ns as u32,
                        ..LidarPoint::default()
                    }
                })
                .collect();
            points
        })
        .collect();
    Stamped {
        time: time(t),
        arrival: time(t + 0.1),
        device_ticks: 0,
        sample: LidarScan { points },
    }
}

/// Inertial samples at 200 Hz with constant biases and white noise.
pub fn imu_samples(duration_s: f64, seed: u64) -> Vec<Stamped<ImuSample>> {
    imu_samples_on(world_from_rig, duration_s, seed)
}

/// The same on another walk.
pub fn imu_samples_on(
    motion: fn(f64) -> Se3,
    duration_s: f64,
    seed: u64,
) -> Vec<Stamped<ImuSample>> {
    const RATE_HZ: f64 = 200.0;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let gyro_bias = Vector3::new(0.004, -0.003, 0.006);
    let accel_bias = Vector3::new(0.04, -0.03, 0.05);
    let noise = imu();
    let h = 1e-4;
    (0..(duration_s * RATE_HZ) as usize)
        .map(|i| {
            let t = i as f64 / RATE_HZ;
            let (a, b, c) = (motion(t - h), motion(t), motion(t + h));
            let rate = so3::log(&(a.rotation.inverse() * c.rotation)) / (2.0 * h);
            let acceleration = (a.translation - b.translation * 2.0 + c.translation) / (h * h);
            let force = b.rotation.inverse() * (acceleration + Vector3::new(0.0, 0.0, 9.80665));
            let mut white = |density: f64| {
                let sigma = density * RATE_HZ.sqrt();
                Vector3::new(
                    sigma * gaussian(&mut rng),
                    sigma * gaussian(&mut rng),
                    sigma * gaussian(&mut rng),
                )
            };
            let rate = rate + gyro_bias + white(noise.gyro_noise_density);
            let force = force + accel_bias + white(noise.accel_noise_density);
            Stamped {
                time: time(t),
                arrival: time(t),
                device_ticks: i as u64,
                sample: ImuSample {
                    angular_velocity_rad_s: rate.into(),
                    specific_force_m_s2: force.into(),
                },
            }
        })
        .collect()
}

/// Brightness of the surface at a point, 0–1: noise of two sizes.
fn texture(point: &Vector3<f64>) -> f64 {
    let lattice = |cell: [i64; 3]| {
        let mixed = cell.iter().fold(0x9e37_79b9_u64, |hash, c| {
            (hash ^ *c as u64)
                .wrapping_mul(0x2545_f491_4f6c_dd1d)
                .rotate_left(29)
        });
        (mixed >> 40) as f64 / (1u64 << 24) as f64
    };
    let noise = |size_m: f64| {
        let p = point / size_m;
        let (low, f) = (p.map(f64::floor), p.map(|x| x - x.floor()));
        (0..8)
            .map(|corner: u32| {
                let bit = |axis: u32| (corner >> axis) & 1;
                let weight = |axis: usize| {
                    if bit(axis as u32) == 1 {
                        f[axis]
                    } else {
                        1.0 - f[axis]
                    }
                };
                let cell = [0, 1, 2].map(|a: usize| low[a] as i64 + i64::from(bit(a as u32)));
                weight(0) * weight(1) * weight(2) * lattice(cell)
            })
            .sum::<f64>()
    };
    0.6 * noise(0.07) + 0.4 * noise(0.23)
}

/// The image a camera takes at `t`.
pub fn render(room: &Room, camera: &RigCamera, t: f64) -> Stamped<Image> {
    let world_from_camera = world_from_rig(t) * camera.rig_from_camera;
    let (width, height) = (camera.camera.width, camera.camera.height);
    let pixels = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let pixel = Vector2::new(f64::from(i % width), f64::from(i / width));
            let Some(ray) = camera.camera.unproject(&pixel) else {
                return 0;
            };
            let ray = world_from_camera.rotation * ray;
            let range = room.cast(&world_from_camera.translation, &ray);
            (255.0 * texture(&(world_from_camera.translation + ray * range))) as u8
        })
        .collect();
    Stamped {
        time: time(t),
        arrival: time(t),
        device_ticks: 0,
        sample: Image {
            width,
            height,
            pixels,
            exposure_ns: 0,
            frame_id: (t * 10.0).round() as u32,
        },
    }
}
