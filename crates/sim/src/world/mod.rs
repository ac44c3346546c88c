//! The world: flat facets with painted, lit textures under a bounding volume hierarchy, and people who walk in it.
//!
//! Brightness does not depend on the direction of view (but for glass, windows in the detailed look and, in baked light, gloss), so that a point looks alike in all images.

pub mod april_grid;
mod atlas;
mod blueprint;
mod bounds;
pub(crate) mod builder;
mod bvh;
pub(crate) mod canvas;
pub(crate) mod coplanar;
mod corridor;
pub(crate) mod crowd;
mod detail;
mod facet;
mod finish;
pub(crate) mod fittings;
mod floor_plan;
pub(crate) mod furniture;
mod gltf;
mod grain;
mod imported;
mod irradiance;
mod lanes;
mod letters;
pub(crate) mod light;
mod lit;
pub(crate) mod material;
mod mesh;
mod outlook;
mod packet;
mod patchwork;
mod pool;
mod print;
mod ray;
mod room;
mod shade;
mod shadow;
mod skin;
mod substance;
pub(crate) mod vector;
mod words;

use rayon::prelude::*;
use wide::f32x8;

use lsfb_types::{Progress, ProgressFn, Stopped};

use crate::noise::hash;
use atlas::Atlas;
pub(crate) use blueprint::{Blueprint, ClosedDoor};
use bvh::Bvh;
use crowd::{Crowd, Moment, Passer};
pub use facet::{Facet, Outline};
pub use floor_plan::FloorPlan;
use light::{AMBIENT, Lamps, LightGrid, Lighting, SPACING_M, SmallFacets};
use lit::Lit;
pub use lit::{LightReport, LitPlace, LitSurface};
pub use ray::{LANES, NO_FACET, Origin, PacketHit, RayPacket};
pub(crate) use room::furnish;
pub(crate) use shade::RayHit;
use skin::{Beyond, LightMaps, Skin};
pub use substance::Substance;
use vector::norm;

/// What scales lit reflectances to 0–1 before the square root that stands for a camera's gamma.
const EXPOSURE: f32 = 0.9;
/// Limit of a cast, metres.
const FAR_M: f32 = 1e4;

/// A place with everything in it, made from a seed.
#[derive(Clone, Debug)]
pub struct World {
    /// What does not move.
    facets: Vec<Facet>,
    /// Of all facets: those that do not move, then those of the walkers.
    reflectances: Vec<f32>,
    /// Of the facets that do not move.
    substances: Vec<Substance>,
    skins: Vec<Skin>,
    bvh: Bvh,
    atlas: Atlas,
    light: LightMaps,
    crowd: Crowd,
    /// Where light was traced; `None` for simple light.
    lit: Option<Lit>,
    /// Where it is night.
    night: Option<Night>,
    closed: Option<ClosedDoor>,
}

/// Simple light on what moves at night, where it is not the same everywhere; nothing in traced light, which has its own.
#[derive(Clone, Debug, Default)]
struct Night {
    lamps: Lamps,
    ambient: f32,
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
    pub fn build(seed: u64, texel_m: f32, progress: ProgressFn) -> Result<Self, Stopped> {
        let plan = FloorPlan::new(seed);
        let (builder, lamps) = furnish(&plan, seed);
        let lighting = Lighting {
            lamps: Lamps::new(&lamps),
            sun: None,
            ambient: AMBIENT,
            spacing_m: SPACING_M,
            small_facets: SmallFacets::Shaded,
        };
        let unsorted: Vec<Facet> = builder.surfaces.iter().map(|s| s.facet).collect();
        let (bvh, order) = Bvh::build(&unsorted);
        let facets: Vec<Facet> = order.iter().map(|&i| unsorted[i]).collect();
        let total = order.len() as u64;
        let mut atlas = Atlas::default();
        let mut reflectances = Vec::with_capacity(order.len());
        // In batches, so that the painted pictures in full precision need not all be held at once, and whoever wants it to stop need
        // not wait for long.
        for batch in order.chunks(32) {
            progress(Progress {
                stage: "rendering textures",
                done: reflectances.len() as u64,
                total,
            })?;
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
                    let light =
                        LightGrid::bake(facet, (first + k) as u64, &bvh, &facets, &lighting);
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
        let substance = |&i: &usize| builder.surfaces[i].material.substance;
        Ok(Self {
            skins: (0..facets.len()).map(Skin::baked).collect(),
            substances: order.iter().map(substance).collect(),
            facets,
            reflectances,
            bvh,
            atlas,
            light: LightMaps::default(),
            crowd: Crowd::default(),
            lit: None,
            night: None,
            closed: None,
        })
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
            substances: vec![Substance::Board],
            skins: vec![Skin::baked(0)],
            bvh: Bvh::build(&[facet]).0,
            atlas,
            light: LightMaps::default(),
            crowd: Crowd::default(),
            lit: None,
            night: None,
            closed: None,
        }
    }

    /// The least and the greatest x, y, z of what does not move, metres.
    pub fn extent_m(&self) -> [[f32; 3]; 2] {
        let mut extent = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
        for v in self.facets.iter().flat_map(Facet::vertices) {
            for i in 0..3 {
                extent[0][i] = extent[0][i].min(v[i]);
                extent[1][i] = extent[1][i].max(v[i]);
            }
        }
        extent
    }

    /// All facets that do not move.
    pub fn facets(&self) -> &[Facet] {
        &self.facets
    }

    /// Mean diffuse reflectance of a facet, 0–1.
    pub fn reflectance(&self, facet: usize) -> f32 {
        self.reflectances[facet]
    }

    /// What a facet that does not move is made of.
    pub fn substance(&self, facet: usize) -> Substance {
        self.substances.get(facet).copied().unwrap_or_default()
    }

    /// Bytes of texture and light.
    pub fn texture_bytes(&self) -> usize {
        self.atlas.bytes() + self.light.bytes()
    }

    /// What computing its light came to; `None` where light is not traced.
    pub fn light_report(&self) -> Option<&LightReport> {
        self.lit.as_ref().map(|lit| &lit.report)
    }

    /// Whether light is traced, over its whole range.
    pub(crate) fn is_lit(&self) -> bool {
        self.lit.is_some()
    }

    /// Whether it is night.
    pub(crate) fn is_night(&self) -> bool {
        self.night.is_some()
    }

    /// The door that has been closed.
    pub(crate) fn closed_door(&self) -> Option<&ClosedDoor> {
        self.closed.as_ref()
    }

    /// Square root of the light on a small surface of somebody who moves, 1 being nominal.
    #[inline]
    fn light_around(&self, point: [f32; 3], normal: [f32; 3]) -> f32 {
        match (&self.lit, &self.night) {
            (Some(lit), _) => lit.around(point, normal),
            (None, Some(night)) => (night.ambient + night.lamps.unshadowed(point, normal)).sqrt(),
            (None, None) => 1.0,
        }
    }

    /// Illuminance at `(a, b)` of a facet that does not move, lux; `None` where it shines by itself, and where light is not traced.
    pub fn illuminance_lx(&self, facet: usize, [a, b]: [f32; 2]) -> Option<f32> {
        let shines = *self.lit.as_ref()?.shines.get(facet)?;
        let light = self.light.at(self.skins[facet].light, a, b);
        (!shines).then_some(light * light * lit::NOMINAL_LX)
    }

    /// Whether light goes through a facet.
    pub fn is_glass(&self, facet: usize) -> bool {
        self.skins[facet].glass
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

    /// Where everybody is at a time, out of the way of somebody at `walker`.
    pub(crate) fn moment(&self, time_s: f64, walker: [f32; 2]) -> Moment {
        self.crowd.at(time_s, walker)
    }

    /// The same, with somebody more.
    pub(crate) fn moment_with(
        &self,
        time_s: f64,
        walker: [f32; 2],
        passer: Option<Passer>,
    ) -> Moment {
        let mut moment = self.moment(time_s, walker);
        if let Some(passer) = passer {
            self.crowd.join(&mut moment, &passer);
        }
        moment
    }

    /// The nearest facets closer than `limit`, those of walkers included.
    pub(crate) fn cast_at(&self, rays: &RayPacket, limit: f32x8, moment: &Moment) -> PacketHit {
        let mut hit = self.bvh.cast(&self.facets, rays, limit);
        self.crowd.cast(moment, rays, &mut hit);
        hit
    }

    /// The facet that a ray of a packet hit, as it stands in the frame of who carries it.
    pub(crate) fn facet_hit(&self, moment: &Moment, carrier: u8, facet: usize) -> Option<&Facet> {
        match carrier {
            0 => self.facets.get(facet),
            _ => self.crowd.facet(moment, carrier, facet),
        }
    }

    /// How much of what a smooth surface would mirror a facet does mirror.
    #[inline]
    fn gloss(&self, facet: usize) -> f32 {
        self.lit.as_ref().map_or(0.0, |lit| lit.gloss[facet])
    }

    /// Brightness of what is seen far behind a window along a ray of unit length, or mirrored in it; `None` for what is no window.
    #[inline]
    fn outlook(
        &self,
        facet: usize,
        [a, b]: [f32; 2],
        (ray, normal): ([f32; 3], [f32; 3]),
        angle_rad: f32,
    ) -> Option<f32> {
        let skin = &self.skins[facet];
        let towards = match skin.beyond {
            Beyond::Outlook => ray,
            Beyond::Mirrored => {
                vector::add(ray, vector::scale(normal, -2.0 * vector::dot(ray, normal)))
            }
            _ => return None,
        };
        let [x, y] = outlook::place(towards);
        let paint = self.atlas.sample(skin.texture as usize, x, y, angle_rad);
        Some(self.light.at(skin.light, a, b) * paint)
    }

    /// Brightness at `(a, b)` of a facet, 255 being white, averaged over `footprint_m`.
    #[inline]
    fn radiance(&self, facet: usize, a: f32, b: f32, footprint_m: f32, time_s: f64) -> f32 {
        let skin = &self.skins[facet];
        let (texture, place) = skin.look_up(a, b, time_s);
        let sample = |[x, y]: [f32; 2]| self.atlas.sample(texture, x, y, footprint_m * skin.zoom);
        let paint = match &skin.beyond {
            Beyond::Patched(patchwork) => patchwork.blend(place, self.atlas.mean(texture), sample),
            _ => sample(place),
        };
        skin.gain * self.light.at(skin.light, a, b) * paint
    }
}
