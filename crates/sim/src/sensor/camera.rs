//! A global-shutter camera: every pixel one ray, the texture averaged over the pixel's cone.

use rayon::prelude::*;
use wide::f32x8;

use lsfb_geometry::{RigCamera, Se3, Vector2};
use lsfb_types::Image;

use crate::Error;
use crate::config::CameraConfig;
use crate::noise::hash;
use crate::world::vector::{dot, norm};
use crate::world::{LANES, NO_FACET, RayPacket, World};

/// Rows rendered by one task.
const ROWS_PER_TASK: usize = 8;

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
                    let ray = camera.camera.unproject(&pixel).ok_or(Error::Config {
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
        let rotation = world_from_camera.rotation_matrix().map(|v| v as f32);
        let origin: [f32; 3] = world_from_camera.translation.map(|v| v as f32).into();
        let noise_seed = hash(self.seed ^ hash(u64::from(frame_id)));
        let mut pixels = vec![0_u8; self.width * self.height];
        let task = self.width * ROWS_PER_TASK;
        pixels
            .par_chunks_mut(task)
            .enumerate()
            .for_each(|(k, rows)| {
                for (j, group) in rows.chunks_exact_mut(LANES).enumerate() {
                    let first = k * task / LANES + j;
                    let d = &self.directions[first];
                    let direction: [f32x8; 3] = std::array::from_fn(|i| {
                        f32x8::splat(rotation[(i, 0)]) * d[0]
                            + f32x8::splat(rotation[(i, 1)]) * d[1]
                            + f32x8::splat(rotation[(i, 2)]) * d[2]
                    });
                    let values = self.look(world, origin, direction);
                    self.expose(first, &values, noise_seed, group);
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

    /// Brightness along eight rays; black where there is nothing.
    fn look(&self, world: &World, origin: [f32; 3], direction: [f32x8; 3]) -> [f32; LANES] {
        let hit = world.cast_packet(&RayPacket::from_point(origin, direction));
        let distance = hit.distance.to_array();
        let lanes = direction.map(|d| d.to_array());
        let mut values = [0.0; LANES];
        for lane in 0..LANES {
            if hit.facet[lane] == NO_FACET {
                continue;
            }
            let facet = hit.facet[lane] as usize;
            let ray = [lanes[0][lane], lanes[1][lane], lanes[2][lane]];
            let point: [f32; 3] = std::array::from_fn(|i| origin[i] + distance[lane] * ray[i]);
            // The pixel's cone cuts the surface in an ellipse; its mean radius decides the mip level.
            let cosine = (-dot(world.facets()[facet].normal, ray)).max(0.02) / norm(ray);
            let footprint = distance[lane] * self.pixel_angle_rad / cosine.sqrt();
            values[lane] = world.brightness(facet, point, footprint);
        }
        values
    }

    /// Vignetting, shot and read noise, quantisation.
    fn expose(&self, group: usize, values: &[f32; LANES], seed: u64, out: &mut [u8]) {
        let vignette = &self.vignette[group * LANES..(group + 1) * LANES];
        for half in 0..LANES / 2 {
            let bits = hash(seed.wrapping_add((group * LANES / 2 + half) as u64)).to_le_bytes();
            for side in 0..2 {
                let lane = 2 * half + side;
                let value = values[lane] * vignette[lane];
                // The sum of four bytes is close to normal: mean 510, standard deviation 147.8.
                let sum: f32 = bits[4 * side..4 * side + 4]
                    .iter()
                    .map(|b| f32::from(*b))
                    .sum();
                let noise = (sum - 510.0) / 147.8 * self.noise[(value as usize).min(255)];
                out[lane] = (value + noise + 0.5).clamp(0.0, 255.0) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests;
