//! Light in the air, for what moves: illuminance towards the six directions of the axes at points of a grid.

use rayon::prelude::*;

use super::scene::Scene;
use super::tracer::Spot;
use crate::noise::hash;

/// Distance between probes across, metres; more where there would be too many.
const SPACING_M: f32 = 2.0;
/// Heights above the lowest floor: from here on, so far apart, metres.
const LOWEST_M: f32 = 0.3;
const LAYER_M: f32 = 0.8;
/// Above the highest floor.
const TALLEST_M: f32 = 1.9;
const MOST: f32 = 12_000.0;
/// Paths for each direction.
const PATHS: usize = 64;
/// A probe of whose paths more begin inside something stands in it.
const BURIED: f32 = 0.2;

/// The grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Probes {
    pub(super) low: [f32; 3],
    pub(super) step_m: [f32; 3],
    pub(super) counts: [u32; 3],
    /// Illuminance, lux, of surfaces that face +x, −x, +y, −y, +z, −z.
    pub(super) lux: Vec<[f32; 6]>,
}

impl Probes {
    /// Light between the corners of a box on the floor, the heights of its floors being the third coordinate.
    pub(crate) fn bake(scene: &Scene, [low, high]: [[f32; 3]; 2], seed: u64) -> Self {
        let layers = ((high[2] - low[2] + TALLEST_M - LOWEST_M) / LAYER_M).ceil() + 1.0;
        let sides = [high[0] - low[0], high[1] - low[1]];
        let count = |spacing_m: f32| sides.map(|side| (side / spacing_m).ceil().max(0.0) + 1.0);
        let mut spacing_m = SPACING_M;
        while count(spacing_m).into_iter().product::<f32>() * layers > MOST {
            spacing_m *= 1.25;
        }
        let [across, deep] = count(spacing_m);
        let counts = [across, deep, layers].map(|n| n as u32);
        let grid = Self {
            low: [low[0], low[1], low[2] + LOWEST_M],
            step_m: [spacing_m, spacing_m, LAYER_M],
            counts,
            lux: Vec::new(),
        };
        let number = counts.iter().product::<u32>();
        let found: Vec<Option<[f32; 6]>> = (0..number)
            .into_par_iter()
            .map(|k| probe(scene, grid.place(k), hash(seed ^ hash(k.into()))))
            .collect();
        Self {
            lux: grid.filled(found),
            ..grid
        }
    }

    fn place(&self, k: u32) -> [f32; 3] {
        let at = self.indices(k);
        std::array::from_fn(|i| self.low[i] + at[i] as f32 * self.step_m[i])
    }

    fn indices(&self, k: u32) -> [u32; 3] {
        let [nx, ny, _] = self.counts;
        [k % nx, k / nx % ny, k / (nx * ny)]
    }

    /// Probes within something have the mean of those beside them; those with none beside them, nothing.
    fn filled(&self, mut found: Vec<Option<[f32; 6]>>) -> Vec<[f32; 6]> {
        let [nx, ny, nz] = self.counts.map(i64::from);
        for _ in 0..4 {
            let before = found.clone();
            for k in (0..before.len()).filter(|k| before[*k].is_none()) {
                let [x, y, z] = self.indices(k as u32).map(i64::from);
                let beside = [
                    (1, 0, 0),
                    (-1, 0, 0),
                    (0, 1, 0),
                    (0, -1, 0),
                    (0, 0, 1),
                    (0, 0, -1),
                ];
                let near: Vec<[f32; 6]> = beside
                    .into_iter()
                    .map(|(dx, dy, dz)| (x + dx, y + dy, z + dz))
                    .filter(|(x, y, z)| {
                        (0..nx).contains(x) && (0..ny).contains(y) && (0..nz).contains(z)
                    })
                    .filter_map(|(x, y, z)| before[((z * ny + y) * nx + x) as usize])
                    .collect();
                if !near.is_empty() {
                    found[k] = Some(std::array::from_fn(|i| {
                        near.iter().map(|lux| lux[i]).sum::<f32>() / near.len() as f32
                    }));
                }
            }
        }
        found.into_iter().map(Option::unwrap_or_default).collect()
    }

    /// Illuminance of a small surface at a point that faces along `normal`, lux; `None` where there is no grid.
    pub(crate) fn at(&self, point: [f32; 3], normal: [f32; 3]) -> Option<f32> {
        if self.lux.is_empty() {
            return None;
        }
        let mut first = [0_u32; 3];
        let mut part = [0.0_f32; 3];
        for i in 0..3 {
            let last = (self.counts[i] - 1) as f32;
            let x = ((point[i] - self.low[i]) / self.step_m[i]).clamp(0.0, last);
            first[i] = (x as u32).min(self.counts[i].saturating_sub(2));
            part[i] = x - first[i] as f32;
        }
        let mut sum = 0.0;
        for corner in 0..8_u32 {
            let step: [u32; 3] = std::array::from_fn(|i| corner >> i & 1);
            let weight: f32 = (0..3)
                .map(|i| if step[i] == 1 { part[i] } else { 1.0 - part[i] })
                .product();
            if weight <= 0.0 {
                continue;
            }
            let [x, y, z] = std::array::from_fn(|i| (first[i] + step[i]).min(self.counts[i] - 1));
            let lux = &self.lux[((z * self.counts[1] + y) * self.counts[0] + x) as usize];
            for i in 0..3 {
                sum += weight * normal[i] * normal[i] * lux[2 * i + usize::from(normal[i] < 0.0)];
            }
        }
        Some(sum)
    }
}

fn probe(scene: &Scene, point: [f32; 3], seed: u64) -> Option<[f32; 6]> {
    let mut buried = 0.0;
    let lux = std::array::from_fn(|k| {
        let mut normal = [0.0; 3];
        normal[k / 2] = if k % 2 == 0 { 1.0 } else { -1.0 };
        let spot = Spot { point, normal };
        let gathered = scene.gather(
            &spot,
            PATHS,
            hash(seed ^ k as u64),
            super::tracer::Light::Whole,
        );
        buried += gathered.buried / 6.0;
        gathered.illuminance_lx
    });
    (buried < BURIED).then_some(lux)
}
