//! Light that does not move, computed once: lamps with shadows, and the share of open sky that every point sees.

use wide::f32x8;

use super::bvh::Bvh;
use super::facet::Facet;
use super::ray::{LANES, NO_FACET, RayPacket};
use super::vector::{add, cross, dot, norm, scale, sub};
use crate::noise::{hash, unit};

/// A point that shines equally in all directions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lamp {
    pub position: [f32; 3],
    /// Irradiance at one metre, head-on.
    pub power: f32,
}

/// Distance between the points of a facet at which light is computed, metres.
const SPACING_M: f32 = 0.12;
/// Rays by which a point looks for what is around it; a multiple of eight.
const FEELERS: usize = 16;
/// What is farther away than this does not darken a corner, metres.
const FEELER_M: f32 = 0.8;
/// Light from everywhere.
const AMBIENT: f32 = 0.42;

/// Irradiance on a lattice over one facet.
#[derive(Clone, Debug)]
pub(crate) struct LightGrid {
    columns: usize,
    rows: usize,
    values: Vec<f32>,
}

impl LightGrid {
    /// Computes the light on `facet`.
    pub(crate) fn bake(
        facet: &Facet,
        index: u64,
        bvh: &Bvh,
        facets: &[Facet],
        lamps: &[Lamp],
    ) -> Self {
        let nodes = |edge: f32| ((edge / SPACING_M) as usize).clamp(2, 160);
        let columns = nodes(norm(facet.edge_a));
        let rows = nodes(norm(facet.edge_b));
        let mut values = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                // Pulled in from the border, where the neighbour's surface would be hit at distance zero.
                let a = 0.02 + 0.96 * i as f32 / (columns - 1) as f32;
                let b = 0.02 + 0.96 * j as f32 / (rows - 1) as f32;
                let point = add(facet.point(a, b), scale(facet.normal, 2e-3));
                let seed = hash(index << 32 | (j * columns + i) as u64);
                let open = openness(point, facet, seed, bvh, facets);
                values.push(AMBIENT * open + direct(point, facet.normal, bvh, facets, lamps));
            }
        }
        Self {
            columns,
            rows,
            values,
        }
    }

    /// Irradiance at `(a, b)`.
    pub(crate) fn at(&self, a: f32, b: f32) -> f32 {
        let x = (a * (self.columns - 1) as f32).clamp(0.0, (self.columns - 1) as f32);
        let y = (b * (self.rows - 1) as f32).clamp(0.0, (self.rows - 1) as f32);
        let (i, j) = (
            (x as usize).min(self.columns - 2),
            (y as usize).min(self.rows - 2),
        );
        let (u, v) = (x - i as f32, y - j as f32);
        let k = j * self.columns + i;
        let top = self.values[k] * (1.0 - u) + self.values[k + 1] * u;
        let low = self.values[k + self.columns] * (1.0 - u) + self.values[k + self.columns + 1] * u;
        top * (1.0 - v) + low * v
    }
}

/// Share of the half-space above `point` that is free of near obstacles, weighted by the cosine.
fn openness(point: [f32; 3], facet: &Facet, seed: u64, bvh: &Bvh, facets: &[Facet]) -> f32 {
    let tangent = scale(facet.edge_a, 1.0 / norm(facet.edge_a));
    let bitangent = cross(facet.normal, tangent);
    let mut free = 0.0;
    for packet in 0..FEELERS / LANES {
        let mut directions = [[0.0_f32; 8]; 3];
        for lane in 0..LANES {
            let k = (packet * LANES + lane) as f64;
            // Golden-angle spiral over the disc, turned at random from point to point, lifted to the hemisphere.
            let angle = (2.399_963_2 * k + std::f64::consts::TAU * unit(seed)) as f32;
            let radius = ((k as f32 + 0.5) / FEELERS as f32).sqrt();
            let up = (1.0 - radius * radius).sqrt();
            let (sin, cos) = angle.sin_cos();
            for (axis, lanes) in directions.iter_mut().enumerate() {
                lanes[lane] = radius * (tangent[axis] * cos + bitangent[axis] * sin)
                    + facet.normal[axis] * up;
            }
        }
        let rays = RayPacket::from_point(point, directions.map(f32x8::new));
        let hit = bvh.cast(facets, &rays, f32x8::splat(FEELER_M));
        free += hit
            .distance
            .to_array()
            .into_iter()
            .map(|d| d / FEELER_M)
            .sum::<f32>();
    }
    free / FEELERS as f32
}

/// Light that reaches `point` straight from the lamps.
fn direct(point: [f32; 3], normal: [f32; 3], bvh: &Bvh, facets: &[Facet], lamps: &[Lamp]) -> f32 {
    let mut sum = 0.0;
    for group in lamps.chunks(8) {
        let mut directions = [[0.0_f32; 8]; 3];
        let mut gain = [0.0_f32; 8];
        for (lane, lamp) in group.iter().enumerate() {
            let to = sub(lamp.position, point);
            let distance = norm(to);
            let cosine = dot(normal, to) / distance;
            if cosine > 0.0 && distance < 9.0 {
                gain[lane] = lamp.power * cosine / (distance * distance + 0.1);
            }
            for (lanes, component) in directions.iter_mut().zip(to) {
                lanes[lane] = component;
            }
        }
        let rays = RayPacket::from_point(point, directions.map(f32x8::new));
        let lit = f32x8::new(gain).simd_gt(f32x8::splat(0.0));
        let limit = lit.bitselect(f32x8::splat(1.0), f32x8::splat(0.0));
        let hit = bvh.cast(facets, &rays, limit);
        for (facet, gain) in hit.facet.into_iter().zip(gain) {
            if facet == NO_FACET {
                sum += gain;
            }
        }
    }
    sum
}
