//! The world: flat facets with painted, lit textures under a bounding volume hierarchy.
//!
//! Brightness does not depend on the direction of view, so that a point looks alike in all images.

mod atlas;
mod builder;
mod bvh;
pub(crate) mod canvas;
mod corridor;
mod facet;
mod furniture;
mod light;
mod material;
mod mesh;
mod packet;
mod ray;
mod room;
pub(crate) mod vector;

use rayon::prelude::*;
use wide::f32x8;

use lsfb_types::{Progress, ProgressFn};

use crate::noise::hash;
use atlas::Atlas;
use bvh::Bvh;
pub use facet::{Facet, Outline};
use light::LightGrid;
pub use ray::{LANES, NO_FACET, Origin, PacketHit, RayPacket};
pub use room::FloorPlan;
use vector::norm;

/// What scales lit reflectances to 0–1 before the square root that stands for a camera's gamma.
const EXPOSURE: f32 = 0.9;
/// Limit of a cast, metres.
const FAR_M: f32 = 1e4;

/// A building with everything in it. Static; made from a seed.
#[derive(Clone, Debug)]
pub struct World {
    facets: Vec<Facet>,
    reflectances: Vec<f32>,
    bvh: Bvh,
    atlas: Atlas,
    plan: FloorPlan,
}

/// The nearest surface along a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in lengths of the ray's direction.
    pub distance: f32,
    /// Which facet.
    pub facet: usize,
}

impl World {
    /// Builds the furnished room and corridor of `seed`, with texels of `texel_m` metres.
    pub fn build(seed: u64, texel_m: f32, progress: ProgressFn) -> Self {
        let plan = FloorPlan::new(seed);
        let (builder, lamps) = room::furnish(&plan, seed);
        let unsorted: Vec<Facet> = builder.surfaces.iter().map(|s| s.facet).collect();
        let (bvh, order) = Bvh::build(&unsorted);
        let facets: Vec<Facet> = order.iter().map(|&i| unsorted[i]).collect();
        let total = order.len() as u64;
        let mut atlas = Atlas::default();
        let mut reflectances = Vec::with_capacity(order.len());
        // In batches, so that the painted pictures in full precision need not all be held at once.
        for batch in order.chunks(256) {
            progress(Progress {
                stage: "painting world",
                done: reflectances.len() as u64,
                total,
            });
            let first = reflectances.len();
            let painted: Vec<_> = batch
                .par_iter()
                .enumerate()
                .map(|(k, &source)| {
                    let surface = &builder.surfaces[source];
                    let facet = &surface.facet;
                    let size = [norm(facet.edge_a), norm(facet.edge_b)];
                    let paint_seed = hash(seed ^ hash(source as u64));
                    let mut canvas = surface.material.paint(size, texel_m, paint_seed);
                    let mean = canvas.values.iter().sum::<f32>() / canvas.values.len() as f32;
                    let light = LightGrid::bake(facet, (first + k) as u64, &bvh, &facets, &lamps);
                    let (w, h) = (canvas.width, canvas.height);
                    for (y, row) in canvas.values.chunks_mut(w).enumerate() {
                        let b = (y as f32 + 0.5) / h as f32;
                        for (x, value) in row.iter_mut().enumerate() {
                            let a = (x as f32 + 0.5) / w as f32;
                            let lit = *value * (light.at(a, b) + surface.material.glow);
                            *value = (EXPOSURE * lit).sqrt().min(1.0);
                        }
                    }
                    (canvas, mean)
                })
                .collect();
            for (canvas, mean) in painted {
                atlas.push(&canvas);
                reflectances.push(mean);
            }
        }
        Self {
            facets,
            reflectances,
            bvh,
            atlas,
            plan,
        }
    }

    /// One facet with a picture, for tests of the cameras.
    #[cfg(test)]
    pub(crate) fn test_card(facet: Facet, paint: impl Fn(&mut canvas::Canvas)) -> Self {
        let size = [norm(facet.edge_a), norm(facet.edge_b)];
        let mut canvas = canvas::Canvas::new(size, 0.003, 0.7);
        paint(&mut canvas);
        let mut atlas = Atlas::default();
        atlas.push(&canvas);
        Self {
            facets: vec![facet],
            reflectances: vec![0.5],
            bvh: Bvh::build(&[facet]).0,
            atlas,
            plan: FloorPlan::new(0),
        }
    }

    /// The dimensions of the building.
    pub fn plan(&self) -> &FloorPlan {
        &self.plan
    }

    /// All facets.
    pub fn facets(&self) -> &[Facet] {
        &self.facets
    }

    /// Mean diffuse reflectance of a facet, 0–1.
    pub fn reflectance(&self, facet: usize) -> f32 {
        self.reflectances[facet]
    }

    /// Bytes of texture.
    pub fn texture_bytes(&self) -> usize {
        self.atlas.bytes()
    }

    /// The nearest facets seen by eight rays.
    pub fn cast_packet(&self, rays: &RayPacket) -> PacketHit {
        self.bvh.cast(&self.facets, rays, f32x8::splat(FAR_M))
    }

    /// The nearest facet seen by one ray; `None` outside the building.
    pub fn cast(&self, origin: [f32; 3], direction: [f32; 3]) -> Option<Hit> {
        let hit = self.cast_packet(&RayPacket::splat(origin, direction));
        (hit.facet[0] != NO_FACET).then(|| Hit {
            distance: hit.distance.to_array()[0],
            facet: hit.facet[0] as usize,
        })
    }

    /// Brightness, 0–255, of the point of `facet` where a ray ends, averaged over `footprint_m`.
    #[inline]
    pub fn brightness(&self, facet: usize, point: [f32; 3], footprint_m: f32) -> f32 {
        let [a, b] = self.facets[facet].coordinates(point);
        self.atlas.sample(facet, a, b, footprint_m)
    }
}
