//! Light that does not move, computed once: lamps with shadows, and the share of open sky that every point sees.

use std::collections::BTreeMap;

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

/// Everything that shines.
#[derive(Clone, Debug)]
pub(crate) struct Lighting {
    pub lamps: Lamps,
    pub sun: Option<Sun>,
    /// Light from everywhere, where the sky or the room around is open.
    pub ambient: f32,
    /// Distance between the points of a facet at which light is computed, metres.
    pub spacing_m: f32,
    /// Whether a facet smaller than the spacing is given a single value.
    pub small_facets: SmallFacets,
}

/// How finely small facets are lit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SmallFacets {
    /// At their corners at least.
    Shaded,
    /// With one value.
    Flat,
}

/// What is above a place.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) enum Sky {
    /// A roof.
    #[default]
    Covered,
    /// The sun, in a clear sky.
    Day(Sun),
    /// The sky over a city.
    Night,
}

impl Sky {
    /// The sun, where it shines.
    pub(crate) fn sun(&self) -> Option<Sun> {
        match self {
            Self::Day(sun) => Some(*sun),
            Self::Covered | Self::Night => None,
        }
    }

    /// Whether one stands under it.
    pub(crate) fn is_open(&self) -> bool {
        !matches!(self, Self::Covered)
    }
}

/// A light so far away that its rays are parallel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sun {
    /// Towards it, of length 1.
    pub direction: [f32; 3],
    /// Irradiance, head-on.
    pub power: f32,
}

/// Lamps, found by place.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lamps {
    cells: BTreeMap<[i32; 2], Vec<Lamp>>,
}

impl Lamps {
    pub(crate) fn new(lamps: &[Lamp]) -> Self {
        let mut cells: BTreeMap<[i32; 2], Vec<Lamp>> = BTreeMap::new();
        for lamp in lamps {
            let [x, y] = cell(lamp.position);
            // Where a lamp may matter: its own cell and those around.
            for dx in -1..=1 {
                for dy in -1..=1 {
                    cells.entry([x + dx, y + dy]).or_default().push(*lamp);
                }
            }
        }
        Self { cells }
    }

    /// Light at `point`, as if nothing cast shadows.
    pub(crate) fn unshadowed(&self, point: [f32; 3], normal: [f32; 3]) -> f32 {
        let lamps = self.near(point).iter();
        lamps.map(|lamp| arriving(lamp, point, normal)).sum()
    }

    fn near(&self, point: [f32; 3]) -> &[Lamp] {
        self.cells.get(&cell(point)).map_or(&[], Vec::as_slice)
    }
}

fn cell(p: [f32; 3]) -> [i32; 2] {
    [
        (p[0] / LAMP_REACH_M).floor() as i32,
        (p[1] / LAMP_REACH_M).floor() as i32,
    ]
}

/// What is farther away than this casts no shadow in the sun, metres.
const SUN_M: f32 = 160.0;
/// What is farther away than this is not lit by a lamp, metres.
const LAMP_REACH_M: f32 = 9.0;
/// Distance between the points of a facet at which light is computed in a small building, metres.
pub(crate) const SPACING_M: f32 = 0.12;
/// Rays by which a point looks for what is around it; a multiple of eight.
const FEELERS: usize = 16;
/// What is farther away than this does not darken a corner, metres.
const FEELER_M: f32 = 0.8;
/// Light from everywhere inside a building.
pub(crate) const AMBIENT: f32 = 0.42;

/// Irradiance on a lattice over one facet.
#[derive(Clone, Debug)]
pub(crate) struct LightGrid {
    pub columns: usize,
    pub rows: usize,
    pub values: Vec<f32>,
}

impl LightGrid {
    /// Computes the light on `facet`.
    pub(crate) fn bake(
        facet: &Facet,
        index: u64,
        bvh: &Bvh,
        facets: &[Facet],
        lighting: &Lighting,
    ) -> Self {
        let least = match lighting.small_facets {
            SmallFacets::Shaded => 2,
            SmallFacets::Flat => 1,
        };
        let nodes = |edge: f32| ((edge / lighting.spacing_m) as usize).clamp(least, 160);
        let mut columns = nodes(norm(facet.edge_a));
        let mut rows = nodes(norm(facet.edge_b));
        if columns * rows > 1 {
            (columns, rows) = (columns.max(2), rows.max(2));
        }
        let mut values = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                // Pulled in from the border, where the neighbour's surface would be hit at distance zero.
                let along = |k: usize, count: usize| match count {
                    1 => 0.4,
                    _ => 0.02 + 0.96 * k as f32 / (count - 1) as f32,
                };
                let (a, b) = (along(i, columns), along(j, rows));
                let point = add(facet.point(a, b), scale(facet.normal, 2e-3));
                let seed = hash(index << 32 | (j * columns + i) as u64);
                let open = openness(point, facet, seed, bvh, facets);
                let lamps = lighting.lamps.near(point);
                let mut light =
                    lighting.ambient * open + direct(point, facet.normal, bvh, facets, lamps);
                if let Some(sun) = &lighting.sun {
                    light += sunshine(point, facet.normal, bvh, facets, sun);
                }
                values.push(light);
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
        if let [single] = self.values[..] {
            return single;
        }
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

/// Light of the sun at `point`, its border softened by the width of the sun.
fn sunshine(point: [f32; 3], normal: [f32; 3], bvh: &Bvh, facets: &[Facet], sun: &Sun) -> f32 {
    let cosine = dot(normal, sun.direction);
    if cosine <= 0.0 {
        return 0.0;
    }
    let mut directions = [[0.0_f32; LANES]; 3];
    for lane in 0..LANES {
        let (s, c) = (lane as f32 * std::f32::consts::FRAC_PI_4).sin_cos();
        let ray = add(sun.direction, [0.008 * s, 0.008 * c, 0.004 * (s - c)]);
        for (lanes, component) in directions.iter_mut().zip(ray) {
            lanes[lane] = component;
        }
    }
    let rays = RayPacket::from_point(point, directions.map(f32x8::new));
    let hit = bvh.cast(facets, &rays, f32x8::splat(SUN_M));
    let lit = hit.facet.iter().filter(|f| **f == NO_FACET).count();
    sun.power * cosine * lit as f32 / LANES as f32
}

/// Light of a lamp at `point` where nothing is in the way.
fn arriving(lamp: &Lamp, point: [f32; 3], normal: [f32; 3]) -> f32 {
    let to = sub(lamp.position, point);
    let distance = norm(to);
    let cosine = dot(normal, to) / distance;
    match cosine > 0.0 && distance < LAMP_REACH_M {
        true => lamp.power * cosine / (distance * distance + 0.1),
        false => 0.0,
    }
}

/// Light that reaches `point` straight from the lamps.
fn direct(point: [f32; 3], normal: [f32; 3], bvh: &Bvh, facets: &[Facet], lamps: &[Lamp]) -> f32 {
    let mut sum = 0.0;
    for group in lamps.chunks(8) {
        let mut directions = [[0.0_f32; 8]; 3];
        let mut gain = [0.0_f32; 8];
        for (lane, lamp) in group.iter().enumerate() {
            let to = sub(lamp.position, point);
            gain[lane] = arriving(lamp, point, normal);
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
