//! Two fisheyes and an IMU that move before an AprilGrid: images as PNG files named by their stamps, samples as a table, the rig.

use std::path::Path;

use lsfb_calib::board::tag_cells;
use lsfb_geometry::camera::Lens;
use lsfb_geometry::{
    Camera, CameraTiming, ImuNoiseModel, Matrix3, Rig, RigCamera, Se3, UnitQuaternion, Vector2,
    Vector3, so3,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A printed AprilGrid.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    pub columns: u32,
    pub rows: u32,
    pub tag_m: f64,
    pub spacing: f64,
    /// Whether its tags are those of the family.
    pub tags: Tags,
}

/// What is printed in the tags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tags {
    /// Codes of the family 36h11.
    Own,
    /// Black for white inside of the border.
    Other,
}

/// The board as `--april-grid` takes it.
pub const GRID: &str = "4,3,0.14,0.3";

/// The same as it is printed.
pub const BOARD: Grid = Grid {
    columns: 4,
    rows: 3,
    tag_m: 0.14,
    spacing: 0.3,
    tags: Tags::Own,
};

/// When it begins, nanoseconds.
pub const ORIGIN_NS: i64 = 1_772_359_200_000_000_000;
const SAMPLE_NS: i64 = 5_000_000;
const GRAVITY_M_S2: f64 = 9.80665;
/// Rays per pixel along each axis.
const RAYS: u32 = 2;
/// The same where edges must lie where they are to a tenth of a pixel.
const FINE_RAYS: u32 = 5;
/// Step of the differences that velocities and accelerations are made of, seconds.
const STEP_S: f64 = 1e-3;

/// What a walk is like.
#[derive(Clone, Copy, Debug)]
pub struct Walk {
    pub seconds: f64,
    pub views_per_s: f64,
    /// Amplitudes of turning about the axes of the rig, rad.
    pub turning_rad: [f64; 3],
    /// Amplitudes of moving along the axes of the board, metres.
    pub moving_m: [f64; 3],
    /// The lens of both cameras.
    pub lens: Lens,
    /// Whether the board hangs on its head.
    pub upside_down: bool,
    /// What is printed in its tags.
    pub tags: Tags,
    /// The cameras that record.
    pub cameras: &'static [&'static str],
}

impl Default for Walk {
    fn default() -> Self {
        Self {
            seconds: 12.0,
            views_per_s: 10.0,
            turning_rad: [0.35, 0.3, 0.3],
            moving_m: [0.18, 0.15, 0.15],
            lens: FISHEYE,
            upside_down: false,
            tags: Tags::Own,
            cameras: &["cam0", "cam1"],
        }
    }
}

/// A fisheye of 110° across.
pub const FISHEYE: Lens = Lens::KannalaBrandt {
    focal_px: [165.0, 165.5],
    principal_px: [161.0, 118.0],
    distortion: [0.01, -0.008, 0.003, -0.0008],
};

/// A sample: stamp, angular velocity, specific force.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub stamp_ns: i64,
    pub gyro_rad_s: [f64; 3],
    pub accel_m_s2: [f64; 3],
}

impl Walk {
    fn camera(&self) -> Camera {
        Camera {
            width: 320,
            height: 240,
            lens: self.lens,
        }
    }

    /// The rig as it is.
    pub fn rig(&self) -> Rig {
        // Camera x is the rig's −y, camera y its −z, camera z its x.
        let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let facing = UnitQuaternion::from_matrix(&axes);
        let mounted = |name: &str, y_m: f64| {
            let tilt = so3::exp(&Vector3::new(0.02, -0.03, 0.3 * y_m));
            let camera = RigCamera {
                camera: self.camera(),
                rig_from_camera: Se3::new(facing * tilt, Vector3::new(0.03, y_m, 0.02)),
                timing: CameraTiming::default(),
                sigmas: Default::default(),
            };
            (name.to_owned(), camera)
        };
        Rig {
            cameras: [mounted("cam0", 0.06), mounted("cam1", -0.05)].into(),
            imus: lsfb_geometry::RigImu::from(ImuNoiseModel {
                gyro_noise_density: 1.6e-4,
                accel_noise_density: 2e-3,
                gyro_bias_walk: 2e-5,
                accel_bias_walk: 2e-4,
            })
            .alone(),
            ..Rig::empty("walk")
        }
    }

    /// `board_from_rig`.
    fn pose(&self, time_s: f64) -> Se3 {
        const RATES: [f64; 3] = [1.5, 3.1, 5.3];
        let wave = |size: [f64; 3], phase: f64| {
            Vector3::from_fn(|k, _| {
                let of = |(n, rate): (usize, f64)| {
                    let rate = rate * (1.0 + 0.13 * k as f64);
                    (rate * time_s + phase + 1.7 * (k + 2 * n) as f64).sin() * 0.5
                };
                size[k] * RATES.into_iter().enumerate().map(of).sum::<f64>()
            })
        };
        // Looking at the board: x into it, y against its x, z along its y.
        let base = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0);
        let base = UnitQuaternion::from_matrix(&base);
        let middle = Vector3::new(0.36, 0.27, 0.62);
        Se3::new(
            base * so3::exp(&wave(self.turning_rad, 0.3)),
            middle + wave(self.moving_m, 1.1),
        )
    }

    /// The IMU's samples, with noise.
    pub fn samples(&self) -> Vec<Sample> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let noise = self.rig().imu_noise().cloned().expect("an IMU");
        let per_sample = (1e9 / SAMPLE_NS as f64).sqrt();
        let mut uniform = || rng.random_range(-1.0..1.0) * 3f64.sqrt();
        let up = if self.upside_down { -1.0 } else { 1.0 };
        let gravity = Vector3::new(0.0, -GRAVITY_M_S2 * up, 0.0);
        let count = (self.seconds * 1e9) as i64 / SAMPLE_NS;
        (0..count)
            .map(|k| {
                let time_s = (k * SAMPLE_NS) as f64 * 1e-9;
                let [before, here, after] =
                    [-STEP_S, 0.0, STEP_S].map(|step| self.pose(time_s + step));
                let turn = so3::log(&(before.rotation.inverse() * after.rotation));
                let pushed = (before.translation + after.translation - here.translation * 2.0)
                    / (STEP_S * STEP_S);
                let force = here.rotation.inverse() * (pushed - gravity);
                let mut noisy = |value: Vector3<f64>, bias: f64, density: f64| {
                    value
                        .map(|v| v + bias + density * per_sample * uniform())
                        .into()
                };
                Sample {
                    stamp_ns: ORIGIN_NS + k * SAMPLE_NS,
                    gyro_rad_s: noisy(turn / (2.0 * STEP_S), 3e-3, noise.gyro_noise_density),
                    accel_m_s2: noisy(force, 0.02, noise.accel_noise_density),
                }
            })
            .collect()
    }

    /// Writes `cam0/STAMP.png …`, `cam1/…`, `imu.csv` and `rig.toml`.
    pub fn write(&self, folder: &Path) {
        self.write_late(folder, 0.0);
    }

    /// The same with images that were taken later than their stamps say.
    pub fn write_late(&self, folder: &Path, late_s: f64) {
        std::fs::create_dir_all(folder).expect("folder");
        let rig = self.rig();
        std::fs::write(folder.join("rig.toml"), rig.to_toml()).expect("rig");
        write_samples(&folder.join("imu.csv"), &self.samples());
        let grid = Grid {
            tags: self.tags,
            ..BOARD
        };
        let rays = rays(&self.camera());
        let recording = |name: &&String| self.cameras.contains(&name.as_str());
        for name in rig.cameras.keys().filter(recording) {
            let mounted = &rig.cameras[name];
            std::fs::create_dir_all(folder.join(name)).expect("folder");
            for k in 0..((self.seconds - 0.3) * self.views_per_s) as i64 {
                let stamp_ns = 150_000_000 + (k as f64 / self.views_per_s * 1e9) as i64;
                let pose = self.pose(stamp_ns as f64 * 1e-9 + late_s) * mounted.rig_from_camera;
                let path = format!("{name}/{}.png", ORIGIN_NS + stamp_ns);
                write_png(
                    &folder.join(path),
                    &self.camera(),
                    &seen(&grid, &pose, &rays),
                );
            }
        }
    }
}

/// Directions of all rays of all pixels of a camera, by rows.
pub struct Rays {
    of_each_pixel: u32,
    directions: Vec<Vector3<f64>>,
}

/// As many as images for most faults need.
pub fn rays(camera: &Camera) -> Rays {
    Rays::new(camera, RAYS)
}

/// As many as it takes to measure corners.
pub fn fine_rays(camera: &Camera) -> Rays {
    Rays::new(camera, FINE_RAYS)
}

impl Rays {
    fn new(camera: &Camera, per_edge: u32) -> Self {
        let part = |r: u32| (f64::from(r) + 0.5) / f64::from(per_edge) - 0.5;
        let of_each_pixel = per_edge.pow(2);
        let mut directions = Vec::new();
        for k in 0..camera.width * camera.height {
            let (x, y) = (f64::from(k % camera.width), f64::from(k / camera.width));
            for r in 0..of_each_pixel {
                let pixel = Vector2::new(x + part(r % per_edge), y + part(r / per_edge));
                directions.push(camera.unproject(&pixel).unwrap_or_default());
            }
        }
        Self {
            of_each_pixel,
            directions,
        }
    }
}

/// Brightness of all pixels from a place before the board, whose frame begins at its first tag.
pub fn seen(grid: &Grid, board_from_camera: &Se3, rays: &Rays) -> Vec<u8> {
    let turn = board_from_camera.rotation.to_rotation_matrix();
    let from = board_from_camera.translation;
    let of_ray = |ray: &Vector3<f64>| {
        let ray = turn * ray;
        let along = -from.z / ray.z;
        if along > 0.0 && along.is_finite() {
            brightness(grid, from.x + ray.x * along, from.y + ray.y * along)
        } else {
            WALL
        }
    };
    rays.directions
        .chunks(rays.of_each_pixel as usize)
        .map(|of_pixel| (of_pixel.iter().map(of_ray).sum::<u32>() / rays.of_each_pixel) as u8)
        .collect()
}

const WALL: u32 = 120;
const BLACK: u32 = 25;
const WHITE: u32 = 225;

/// Of a place on the plane of the board.
fn brightness(grid: &Grid, x: f64, y: f64) -> u32 {
    let pitch = grid.tag_m * (1.0 + grid.spacing);
    let place = |v: f64, count: u32| {
        let at = v / pitch;
        let on = (-0.4..f64::from(count) + 0.1).contains(&at);
        on.then_some((at.floor(), (at - at.floor()) * (1.0 + grid.spacing)))
    };
    let (Some((column, u)), Some((row, v))) = (place(x, grid.columns), place(y, grid.rows)) else {
        return WALL;
    };
    if u >= 1.0 && v >= 1.0 {
        return BLACK;
    }
    let inside = |k: f64, count: u32| k >= 0.0 && k < f64::from(count);
    if u >= 1.0 || v >= 1.0 || !inside(column, grid.columns) || !inside(row, grid.rows) {
        return WHITE;
    }
    let number = row as usize * grid.columns as usize + column as usize;
    let cell = |w: f64| ((w * 10.0) as usize).min(9);
    let (from_left, from_top) = (cell(u), 9 - cell(v));
    let in_code = |k: usize| (2..8).contains(&k);
    let other = grid.tags == Tags::Other && in_code(from_left) && in_code(from_top);
    if tag_cells(number)[from_top][from_left] != other {
        WHITE
    } else {
        BLACK
    }
}

/// Writes samples as EuRoC has them.
pub fn write_samples(path: &Path, samples: &[Sample]) {
    let mut text = "#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z\n".to_owned();
    for s in samples {
        let values: Vec<String> = s
            .gyro_rad_s
            .iter()
            .chain(&s.accel_m_s2)
            .map(f64::to_string)
            .collect();
        text += &format!("{},{}\n", s.stamp_ns, values.join(","));
    }
    std::fs::write(path, text).expect("table");
}

/// Writes an image.
pub fn write_png(path: &Path, camera: &Camera, pixels: &[u8]) {
    let file = std::fs::File::create(path).expect("file");
    let mut encoder = png::Encoder::new(std::io::BufWriter::new(file), camera.width, camera.height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().expect("PNG");
    writer.write_image_data(pixels).expect("PNG");
}

/// Writes the images of a folder once more, each row of pixels changed.
pub fn changed_images(from: &Path, to: &Path, change: fn(&mut [u8])) {
    for entry in std::fs::read_dir(from).expect("folder") {
        let path = entry.expect("file").path();
        let file = std::io::BufReader::new(std::fs::File::open(&path).expect("image"));
        let mut reader = png::Decoder::new(file).read_info().expect("PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("small")];
        let info = reader.next_frame(&mut pixels).expect("PNG");
        pixels
            .chunks_exact_mut(info.width as usize)
            .for_each(change);
        let camera = Camera {
            width: info.width,
            height: info.height,
            lens: FISHEYE,
        };
        write_png(
            &to.join(path.file_name().expect("a name")),
            &camera,
            &pixels,
        );
    }
}
