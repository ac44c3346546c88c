//! A camera: every pixel one ray (more where it matters), the texture averaged over the pixel's cone, every row seen
//! from where the camera was at that row's time.

mod exposure;
mod jpeg;

use nalgebra::Matrix3;
use rayon::prelude::*;
use wide::f32x8;

use lsfb_geometry::{RigCamera, Se3, Vector2};
use lsfb_types::{Image, OutOfBounds};

use crate::Error;
use crate::config::CameraConfig;
use crate::noise::hash;
use crate::walk::Passers;
use crate::world::crowd::Moment;
use crate::world::{LANES, RayHit, RayPacket, World};

/// Rows rendered by one task.
const ROWS_PER_TASK: usize = 8;
/// Images averaged into one that is blurred by motion, at most.
const BLUR_STEPS: usize = 6;
/// Motion during the exposure that is worth an image more, pixels.
const BLUR_STEP_PX: f64 = 1.4;

/// Where the four rays of a pixel on a border go, in pixels from its centre: no two share a row or a column.
const SUBPIXELS: [[f32; 2]; 4] = [
    [-0.375, -0.125],
    [0.125, -0.375],
    [0.375, 0.125],
    [-0.125, 0.375],
];

/// Where a rig is, by seconds after the beginning of its walk.
pub(crate) type PoseAt<'a> = &'a (dyn Fn(f64) -> Se3 + Sync);

/// A camera in the world.
#[derive(Clone, Copy)]
struct Eye {
    origin: [f32; 3],
    rotation: Matrix3<f32>,
}

/// The world as it is seen for one image.
struct View<'a> {
    world: &'a World,
    moment: Moment,
    /// One for all rows, or one for each.
    eyes: Vec<Eye>,
}

impl View<'_> {
    fn eye(&self, row: usize) -> &Eye {
        &self.eyes[row % self.eyes.len()]
    }
}

/// Renders what a camera on a rig sees.
#[derive(Clone, Debug)]
pub struct CameraSim {
    rig_from_camera: Se3,
    width: usize,
    height: usize,
    /// Unit viewing directions in the camera frame, eight neighbours in a row at a time.
    directions: Vec<[f32x8; 3]>,
    /// Share of the light that reaches each pixel.
    vignette: Vec<f32>,
    pixel_angle_rad: f32,
    config: CameraConfig,
    passers: Passers,
    seed: u64,
}

impl CameraSim {
    /// Prepares the table of rays. `seed` must differ between cameras.
    pub fn new(camera: &RigCamera, config: &CameraConfig, seed: u64) -> Result<Self, Error> {
        let (width, height) = (camera.camera.width as usize, camera.camera.height as usize);
        let mut directions = Vec::with_capacity(width * height / LANES);
        let mut vignette = Vec::with_capacity(width * height);
        for y in 0..height {
            for first in (0..width).step_by(LANES) {
                let mut lanes = [[0.0_f32; LANES]; 3];
                for (lane, x) in (first..first + LANES).enumerate() {
                    let pixel = Vector2::new(x as f64, y as f64);
                    let ray = camera.camera.unproject(&pixel).ok_or_else(|| {
                        let bounds = "so that the lens sees through every pixel";
                        OutOfBounds::new("", "focal_per_width", &config.focal_per_width, &bounds)
                    })?;
                    for (lanes, component) in lanes.iter_mut().zip(ray.iter()) {
                        lanes[lane] = *component as f32;
                    }
                    // sin² of the angle off the axis is ½ at 45°.
                    let sine_squared = (1.0 - ray.z * ray.z) as f32;
                    vignette.push((1.0 - 2.0 * config.vignetting * sine_squared).max(0.1));
                }
                directions.push(lanes.map(f32x8::new));
            }
        }
        Ok(Self {
            rig_from_camera: camera.rig_from_camera,
            width,
            height,
            directions,
            vignette,
            pixel_angle_rad: (1.0 / camera.camera.focal_px()[0]) as f32,
            config: config.clone(),
            passers: Passers::default(),
            seed,
        })
    }

    /// The same camera where people step before it.
    pub(crate) fn with_passers(self, passers: Passers) -> Self {
        Self { passers, ..self }
    }

    /// Who stands before it at a time, when its rig is at a place.
    #[cfg(test)]
    pub(crate) fn passer(
        &self,
        time_s: f64,
        place: &lsfb_geometry::Vector3<f64>,
    ) -> Option<crate::world::crowd::Passer> {
        self.passers.at(time_s, place)
    }

    /// When a row's exposure has its middle, seconds after that of the image.
    pub fn row_offset_s(&self, row: f64) -> f64 {
        let last = (self.height - 1) as f64;
        (row / last - 0.5) * f64::from(self.config.readout_ns) * 1e-9
    }

    /// The image whose exposure has its middle at `time_s`. `frame_id` also numbers the noise.
    pub(crate) fn render(
        &self,
        world: &World,
        world_from_rig: PoseAt,
        time_s: f64,
        frame_id: u32,
    ) -> Image {
        let exposure = self.meter(world, world_from_rig, time_s);
        let steps = self.blur_steps(world_from_rig, time_s, exposure.time_ns);
        let mut values = Vec::new();
        for step in 0..steps {
            let part = (step as f64 + 0.5) / steps as f64 - 0.5;
            let at_s = time_s + part * f64::from(exposure.time_ns) * 1e-9;
            let view = self.view(world, world_from_rig, at_s);
            let seen = self.look_everywhere(&view);
            if steps == 1 {
                values = seen;
            } else if step == 0 {
                values = seen.into_iter().map(|v| v * v).collect();
            } else {
                for (sum, value) in values.iter_mut().zip(seen) {
                    *sum += value * value;
                }
            }
        }
        if steps > 1 {
            // Light adds up, not its square root.
            let share = 1.0 / steps as f32;
            values.par_iter_mut().for_each(|v| *v = (*v * share).sqrt());
        }
        let noise_seed = hash(self.seed ^ hash(u64::from(frame_id)));
        let mut pixels = vec![0_u8; self.width * self.height];
        pixels
            .par_chunks_mut(self.width)
            .zip(values.par_chunks(self.width))
            .enumerate()
            .for_each(|(y, (row, values))| self.expose(y, values, &exposure, noise_seed, row));
        if self.config.jpeg_quality > 0 {
            jpeg::compress(&mut pixels, self.width, self.config.jpeg_quality);
        }
        Image {
            width: self.width as u32,
            height: self.height as u32,
            pixels,
            exposure_ns: exposure.time_ns,
            frame_id,
        }
    }

    /// How many sharp images make a blurred one.
    fn blur_steps(&self, world_from_rig: PoseAt, time_s: f64, exposure_ns: u32) -> usize {
        if !self.config.motion_blur {
            return 1;
        }
        let half_s = 0.5e-9 * f64::from(exposure_ns);
        let moved = world_from_rig(time_s - half_s).inverse() * world_from_rig(time_s + half_s);
        // As if everything were two metres away.
        let angle = moved.rotation.angle() + 0.5 * moved.translation.norm();
        let pixels = angle / f64::from(self.pixel_angle_rad);
        ((pixels / BLUR_STEP_PX).ceil() as usize).clamp(1, BLUR_STEPS)
    }

    fn view<'a>(&self, world: &'a World, world_from_rig: PoseAt, time_s: f64) -> View<'a> {
        let eye = |at_s: f64| {
            let world_from_camera = world_from_rig(at_s) * self.rig_from_camera;
            Eye {
                origin: world_from_camera.translation.map(|v| v as f32).into(),
                rotation: world_from_camera.rotation_matrix().map(|v| v as f32),
            }
        };
        let eyes = if self.config.readout_ns == 0 {
            vec![eye(time_s)]
        } else {
            (0..self.height)
                .map(|row| eye(time_s + self.row_offset_s(row as f64)))
                .collect()
        };
        let place = world_from_rig(time_s).translation;
        let passer = self.passers.at(time_s, &place);
        View {
            world,
            moment: world.moment_with(time_s, [place.x as f32, place.y as f32], passer),
            eyes,
        }
    }

    /// Brightness of all pixels, borders between facets smoothed.
    fn look_everywhere(&self, view: &View) -> Vec<f32> {
        let groups = self.width / LANES;
        let mut seen = vec![[RayHit::default(); LANES]; self.directions.len()];
        seen.par_chunks_mut(groups * ROWS_PER_TASK)
            .enumerate()
            .for_each(|(task, out)| {
                let first = task * groups * ROWS_PER_TASK;
                for (group, out) in out.iter_mut().enumerate() {
                    let row = (first + group) / groups;
                    *out = self.look(view, row, &self.directions[first + group]);
                }
            });
        let seen = seen.as_flattened();
        let mut values = vec![0.0; self.width * self.height];
        values
            .par_chunks_mut(self.width * ROWS_PER_TASK)
            .enumerate()
            .for_each(|(task, rows)| {
                for (k, row) in rows.chunks_exact_mut(self.width).enumerate() {
                    self.smooth_borders(view, seen, task * ROWS_PER_TASK + k, row);
                }
            });
        values
    }

    /// What eight rays of a row meet; black where there is nothing.
    fn look(&self, view: &View, row: usize, directions: &[f32x8; 3]) -> [RayHit; LANES] {
        let eye = view.eye(row);
        let direction: [f32x8; 3] = std::array::from_fn(|i| {
            f32x8::splat(eye.rotation[(i, 0)]) * directions[0]
                + f32x8::splat(eye.rotation[(i, 1)]) * directions[1]
                + f32x8::splat(eye.rotation[(i, 2)]) * directions[2]
        });
        let rays = RayPacket::from_point(eye.origin, direction);
        view.world.see(&rays, self.pixel_angle_rad, &view.moment)
    }

    /// Fills `values` with the brightness of row `y`. A texture is averaged over the pixel already; where two facets
    /// share a pixel, four rays decide how much of it each gets.
    fn smooth_borders(&self, view: &View, seen: &[RayHit], y: usize, values: &mut [f32]) {
        let row = &seen[y * self.width..(y + 1) * self.width];
        let above = &seen[y.saturating_sub(1) * self.width..][..self.width];
        let below = &seen[(y + 1).min(self.height - 1) * self.width..][..self.width];
        let mut waiting = None;
        for x in 0..self.width {
            let own = row[x].facet;
            let right = row[(x + 1).min(self.width - 1)].facet;
            let left = row[x.saturating_sub(1)].facet;
            values[x] = row[x].value;
            if [left, right, above[x].facet, below[x].facet] != [own; 4] {
                match waiting.take() {
                    None => waiting = Some(x),
                    Some(first) => self.look_closely(view, y, [first, x], values),
                }
            }
        }
        if let Some(last) = waiting {
            self.look_closely(view, y, [last, last], values);
        }
    }

    /// Brightness of two pixels of row `y`, each the mean of four rays.
    fn look_closely(&self, view: &View, y: usize, xs: [usize; 2], values: &mut [f32]) {
        let mut lanes = [[0.0_f32; LANES]; 3];
        for (half, x) in xs.into_iter().enumerate() {
            let centre = self.direction(x, y);
            // Towards the neighbour inside the image.
            let (nx, sx) = if x + 1 < self.width {
                (x + 1, 1.0)
            } else {
                (x - 1, -1.0)
            };
            let (ny, sy) = if y + 1 < self.height {
                (y + 1, 1.0)
            } else {
                (y - 1, -1.0)
            };
            let (beside, under) = (self.direction(nx, y), self.direction(x, ny));
            for (k, [dx, dy]) in SUBPIXELS.into_iter().enumerate() {
                for (axis, lanes) in lanes.iter_mut().enumerate() {
                    lanes[4 * half + k] = centre[axis]
                        + sx * dx * (beside[axis] - centre[axis])
                        + sy * dy * (under[axis] - centre[axis]);
                }
            }
        }
        let seen = self.look(view, y, &lanes.map(f32x8::new));
        for (half, x) in xs.into_iter().enumerate() {
            values[x] = seen[4 * half..4 * half + 4]
                .iter()
                .map(|s| 0.25 * s.value)
                .sum();
        }
    }

    /// Viewing direction of a pixel in the camera frame.
    fn direction(&self, x: usize, y: usize) -> [f32; 3] {
        let index = y * self.width + x;
        self.directions[index / LANES].map(|lanes| lanes.as_array()[index % LANES])
    }
}

#[cfg(test)]
mod tests;
