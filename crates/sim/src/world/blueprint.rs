//! From what a place consists of to a world that can be looked at.

use rayon::prelude::*;

use lsfb_types::{Progress, ProgressFn, Stopped};

use super::atlas::Atlas;
use super::builder::{Builder, Surface};
use super::bvh::Bvh;
use super::coplanar;
use super::crowd::{Crowd, Stroll};
use super::facet::Facet;
use super::grain::Grain;
use super::light::{Lamp, Lamps, LightGrid, Lighting, Sky, SmallFacets};
use super::lit::{self, Lit};
use super::outlook;
use super::skin::{Beyond, LightMaps, Skin};
use super::{Night, World, pool};
use crate::Error;
use crate::config::{LightConfig, Look};

/// Distance between the points at which light is computed, metres.
const SPACING_M: f32 = 0.45;

/// Everything that has a surface, what shines, who walks.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blueprint {
    pub builder: Builder,
    pub lamps: Vec<Lamp>,
    pub sky: Sky,
    pub ambient: f32,
    /// Whether it is night, and cameras are at their limits.
    pub night: bool,
    /// A door that has been closed.
    pub closed: Option<ClosedDoor>,
    pub strolls: Vec<Stroll>,
    pub look: Look,
}

/// A door that stands open otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClosedDoor {
    /// Both ends of its lower edge, metres.
    pub ends: [[f32; 3]; 2],
    pub height_m: f32,
}

impl World {
    /// Paints and lights a place, with texels of `texel_m` metres where surfaces are looked at closely.
    pub(crate) fn of(
        blueprint: &Blueprint,
        seed: u64,
        texel_m: f32,
        progress: ProgressFn,
    ) -> Result<Self, Stopped> {
        let painted = Painted::new(blueprint, seed, texel_m, progress)?;
        let lighting = Lighting {
            lamps: Lamps::new(&blueprint.lamps),
            sun: blueprint.sky.sun(),
            ambient: blueprint.ambient,
            spacing_m: SPACING_M,
            small_facets: SmallFacets::Flat,
        };
        let (facets, bvh) = (&painted.facets, &painted.bvh);
        let mut light = LightMaps::default();
        let total = facets.len() as u64;
        for (batch, chunk) in facets.chunks(4096).enumerate() {
            let first = batch * 4096;
            progress(Progress {
                stage: "computing light",
                done: first as u64,
                total,
            })?;
            let grids: Vec<_> = chunk
                .par_iter()
                .enumerate()
                .map(|(k, facet)| {
                    LightGrid::bake(facet, (first + k) as u64, bvh, facets, &lighting)
                })
                .collect();
            for (mut grid, surface) in grids.into_iter().zip(&painted.surfaces[first..]) {
                if surface.material.is_backdrop() {
                    grid.values.fill(0.0);
                }
                light.push(&grid, surface.material.glow);
            }
        }
        let night = blueprint.night.then_some(Night {
            lamps: lighting.lamps,
            ambient: lighting.ambient,
        });
        Ok(World {
            night,
            ..painted.lit_by(light, None)
        })
    }

    /// Paints a place and traces its light, or reads it where it has been traced before.
    pub(crate) fn traced(
        blueprint: &Blueprint,
        seed: u64,
        texel_m: f32,
        config: &LightConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        let painted = Painted::new(blueprint, seed, texel_m, progress)?;
        let count = painted.facets.len();
        let (maps, lit) = lit::light(
            &painted.surfaces,
            count,
            (blueprint.sky, &blueprint.strolls),
            config,
            seed,
            progress,
        )?;
        Ok(World {
            night: blueprint.night.then(Night::default),
            ..painted.lit_by(maps, Some(lit))
        })
    }
}

/// A world without its light.
struct Painted {
    /// What does not move, then the walkers.
    surfaces: Vec<Surface>,
    facets: Vec<Facet>,
    bvh: Bvh,
    atlas: Atlas,
    skins: Vec<Skin>,
    crowd: Crowd,
    closed: Option<ClosedDoor>,
}

impl Painted {
    fn new(
        blueprint: &Blueprint,
        seed: u64,
        texel_m: f32,
        progress: ProgressFn,
    ) -> Result<Self, Stopped> {
        let mut built = blueprint.builder.surfaces.clone();
        coplanar::separate(&mut built);
        let unsorted: Vec<Facet> = built.iter().map(|s| s.facet).collect();
        let (bvh, order) = Bvh::build(&unsorted);
        let mut surfaces: Vec<_> = order.iter().map(|&i| built[i]).collect();
        let facets: Vec<Facet> = surfaces.iter().map(|s| s.facet).collect();
        let (crowd, bodies) = Crowd::new(blueprint.strolls.clone(), seed, facets.len());
        surfaces.extend(bodies);
        let mut atlas = Atlas::default();
        let mut skins = pool::paint(
            &surfaces,
            (texel_m, blueprint.look),
            seed,
            &mut atlas,
            progress,
        )?;
        for skin in &mut skins[facets.len()..] {
            *skin = pool::unlit(*skin);
        }
        if blueprint.look == Look::Detailed {
            // Where there is a sun, one stands outside and sees in a window what it mirrors.
            let view = if blueprint.sky.is_open() {
                Beyond::Mirrored
            } else {
                Beyond::Outlook
            };
            let texture = atlas.count() as u32;
            let mut canvas = outlook::paint(seed);
            for value in &mut canvas.values {
                *value = (super::EXPOSURE * *value).sqrt();
            }
            atlas.push(&canvas);
            let windows = skins.iter_mut().zip(&surfaces);
            for (skin, _) in windows.filter(|(_, s)| s.material.grain == Grain::Outlook) {
                (skin.texture, skin.beyond, skin.gain) = (texture, view, 1.0);
            }
        }
        Ok(Self {
            surfaces,
            facets,
            bvh,
            atlas,
            skins,
            crowd,
            closed: blueprint.closed,
        })
    }

    fn lit_by(self, light: LightMaps, lit: Option<Lit>) -> World {
        let still = &self.surfaces[..self.facets.len()];
        World {
            reflectances: self.surfaces.iter().map(|s| s.material.tone).collect(),
            substances: still.iter().map(|s| s.material.substance).collect(),
            facets: self.facets,
            skins: self.skins,
            bvh: self.bvh,
            atlas: self.atlas,
            light,
            crowd: self.crowd,
            lit,
            night: None,
            closed: self.closed,
        }
    }
}
