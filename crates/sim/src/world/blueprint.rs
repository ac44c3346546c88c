//! From what a place consists of to a world that can be looked at.

use rayon::prelude::*;

use lsfb_types::{Progress, ProgressFn};

use super::atlas::Atlas;
use super::builder::Builder;
use super::bvh::Bvh;
use super::crowd::{Crowd, Stroll};
use super::facet::Facet;
use super::light::{Lamp, Lamps, LightGrid, Lighting, SmallFacets, Sun};
use super::skin::LightMaps;
use super::{World, pool};

/// Distance between the points at which light is computed, metres.
const SPACING_M: f32 = 0.45;

/// Everything that has a surface, what shines, who walks.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blueprint {
    pub builder: Builder,
    pub lamps: Vec<Lamp>,
    pub sun: Option<Sun>,
    pub ambient: f32,
    pub strolls: Vec<Stroll>,
}

impl World {
    /// Paints and lights a place, with texels of `texel_m` metres where surfaces are looked at closely.
    pub(crate) fn of(blueprint: &Blueprint, seed: u64, texel_m: f32, progress: ProgressFn) -> Self {
        let unsorted: Vec<Facet> = blueprint.builder.surfaces.iter().map(|s| s.facet).collect();
        let (bvh, order) = Bvh::build(&unsorted);
        let mut surfaces: Vec<_> = order
            .iter()
            .map(|&i| blueprint.builder.surfaces[i])
            .collect();
        let facets: Vec<Facet> = surfaces.iter().map(|s| s.facet).collect();
        let (crowd, bodies) = Crowd::new(blueprint.strolls.clone(), seed, facets.len());
        surfaces.extend(bodies);

        let mut atlas = Atlas::default();
        let mut skins = pool::paint(&surfaces, texel_m, seed, &mut atlas, progress);
        for skin in &mut skins[facets.len()..] {
            *skin = pool::unlit(*skin);
        }
        let lighting = Lighting {
            lamps: Lamps::new(&blueprint.lamps),
            sun: blueprint.sun,
            ambient: blueprint.ambient,
            spacing_m: SPACING_M,
            small_facets: SmallFacets::Flat,
        };
        let mut light = LightMaps::default();
        let total = facets.len() as u64;
        for (batch, chunk) in facets.chunks(4096).enumerate() {
            let first = batch * 4096;
            progress(Progress {
                stage: "lighting world",
                done: first as u64,
                total,
            });
            let grids: Vec<_> = chunk
                .par_iter()
                .enumerate()
                .map(|(k, facet)| {
                    LightGrid::bake(facet, (first + k) as u64, &bvh, &facets, &lighting)
                })
                .collect();
            for (grid, surface) in grids.iter().zip(&surfaces[first..]) {
                light.push(grid, surface.material.glow);
            }
        }
        Self {
            reflectances: surfaces.iter().map(|s| s.material.tone).collect(),
            facets,
            skins,
            bvh,
            atlas,
            light,
            crowd,
        }
    }
}
