//! A global-shutter camera: every pixel one ray, the texture averaged over the pixel's cone.

use nalgebra::Matrix3;
use rayon::prelude::*;
use wide::f32x8;

use lsfb_geometry::{RigCamera, Se3, Vector2};
use lsfb_types::Image;

use crate::Error;
use crate::config::CameraConfig;
use crate::noise::hash;
use crate::world::vector::dot;
use crate::world::{LANES, NO_FACET, RayPacket, World};

/// Rows rendered by one task.
const ROWS_PER_TASK: usize = 8;

/// Where the four rays of a pixel on a border go, in pixels from its centre: no two share a row or a column.
const SUBPIXELS: [[f32; 2]; 4] = [
    [-0.375, -0.125],
    [0.125, -0.375],
    [0.375, 0.125],
    [-0.125, 0.375],
];

/// A camera in the world.
struct Eye {
    origin: [f32; 3],
    rotation: Matrix3<f32>,
}

/// What a ray met.
#[derive(Clone, Copy)]
struct Seen {
    value: f32,
    facet: u32,
}

impl Default for Seen {
    fn default() -> Self {
        Self {
            value: 0.0,
            facet: NO_FACET,
        }
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
    /// Standard deviation of the noise by brightness, in steps of one grey level.
    noise: Vec<f32>,
    pixel_angle_rad: f32,
    exposure_ns: u32,
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
                    let ray = camera
                        .camera
                        .unproject(&pixel)
                        .ok_or_else(|| Error::Config {
                            field: "focal_per_width",
                            got: config.focal_per_width.to_string(),
                            expected: "a lens that sees through every pixel",
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
        let noise = (0..256)
            .map(|v| (config.read_noise.powi(2) + config.shot_noise * v as f32).sqrt())
            .collect();
        Ok(Self {
            rig_from_camera: camera.rig_from_camera,
            width,
            height,
            directions,
            vignette,
            noise,
            pixel_angle_rad: (1.0 / camera.camera.focal_px()[0]) as f32,
            exposure_ns: config.exposure_ns,
            seed,
        })
    }

    /// The image taken at a pose. `frame_id` also numbers the noise.
    pub fn render(&self, world: &World, world_from_rig: &Se3, frame_id: u32) -> Image {
        let world_from_camera = *world_from_rig * self.rig_from_camera;
        let eye = Eye {
            origin: world_from_camera.translation.map(|v| v as f32).into(),
            rotation: world_from_camera.rotation_matrix().map(|v| v as f32),
        };
        let noise_seed = hash(self.seed ^ hash(u64::from(frame_id)));
        let groups = self.width / LANES;
        let mut seen = vec![[Seen::default(); LANES]; self.directions.len()];
        seen.par_chunks_mut(groups * ROWS_PER_TASK)
            .enumerate()
            .for_each(|(task, out)| {
                let first = task * groups * ROWS_PER_TASK;
                for (group, out) in out.iter_mut().enumerate() {
                    *out = self.look(world, &eye, &self.directions[first + group]);
                }
            });
        let seen = seen.as_flattened();
        let mut pixels = vec![0_u8; self.width * self.height];
        pixels
            .par_chunks_mut(self.width * ROWS_PER_TASK)
            .enumerate()
            .for_each(|(task, rows)| {
                let mut values = vec![0.0; self.width];
                for (k, row) in rows.chunks_exact_mut(self.width).enumerate() {
                    let y = task * ROWS_PER_TASK + k;
                    self.smooth_borders(world, &eye, seen, y, &mut values);
                    self.expose(y, &values, noise_seed, row);
                }
            });
        Image {
            width: self.width as u32,
            height: self.height as u32,
            pixels,
            exposure_ns: self.exposure_ns,
            frame_id,
        }
    }

    /// What eight rays meet; black where there is nothing.
    fn look(&self, world: &World, eye: &Eye, directions: &[f32x8; 3]) -> [Seen; LANES] {
        let direction: [f32x8; 3] = std::array::from_fn(|i| {
            f32x8::splat(eye.rotation[(i, 0)]) * directions[0]
                + f32x8::splat(eye.rotation[(i, 1)]) * directions[1]
                + f32x8::splat(eye.rotation[(i, 2)]) * directions[2]
        });
        let hit = world.cast_packet(&RayPacket::from_point(eye.origin, direction));
        let distance = hit.distance.to_array();
        let lanes = direction.map(|d| d.to_array());
        std::array::from_fn(|lane| {
            if hit.facet[lane] == NO_FACET {
                return Seen::default();
            }
            let facet = hit.facet[lane] as usize;
            let ray = [lanes[0][lane], lanes[1][lane], lanes[2][lane]];
            let point = std::array::from_fn(|i| eye.origin[i] + distance[lane] * ray[i]);
            // The pixel's cone cuts the surface in an ellipse; its mean radius decides the mip level.
            let cosine = (-dot(world.facets()[facet].normal, ray)).max(0.02);
            let footprint = distance[lane] * self.pixel_angle_rad / cosine.sqrt();
            Seen {
                value: world.brightness(facet, point, footprint),
                facet: facet as u32,
            }
        })
    }

    /// Fills `values` with the brightness of row `y`. A texture is averaged over the pixel already; where two facets
    /// share a pixel, four rays decide how much of it each gets.
    fn smooth_borders(
        &self,
        world: &World,
        eye: &Eye,
        seen: &[Seen],
        y: usize,
        values: &mut [f32],
    ) {
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
                    Some(first) => self.look_closely(world, eye, y, [first, x], values),
                }
            }
        }
        if let Some(last) = waiting {
            self.look_closely(world, eye, y, [last, last], values);
        }
    }

    /// Brightness of two pixels of row `y`, each the mean of four rays.
    fn look_closely(&self, world: &World, eye: &Eye, y: usize, xs: [usize; 2], values: &mut [f32]) {
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
        let seen = self.look(world, eye, &lanes.map(f32x8::new));
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

    /// Vignetting, shot and read noise, quantisation of row `y`.
    fn expose(&self, y: usize, values: &[f32], seed: u64, out: &mut [u8]) {
        let first = y * self.width;
        let vignette = &self.vignette[first..first + self.width];
        for (pair, out) in out.chunks_exact_mut(2).enumerate() {
            let bits = hash(seed.wrapping_add((first / 2 + pair) as u64)).to_le_bytes();
            for (side, out) in out.iter_mut().enumerate() {
                let x = 2 * pair + side;
                let value = values[x] * vignette[x];
                // The sum of four bytes is close to normal: mean 510, standard deviation 147.8.
                let sum: u32 = bits[4 * side..4 * side + 4]
                    .iter()
                    .map(|b| u32::from(*b))
                    .sum();
                let noise = (sum as f32 - 510.0) / 147.8 * self.noise[(value as usize).min(255)];
                *out = (value + noise + 0.5).clamp(0.0, 255.0) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests;
