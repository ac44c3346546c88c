//! Night: a few lamps stay lit, screens go dark, windows show the night, and posts light the parks.

use super::site::Site;
use crate::noise::hash;
use crate::world::Substance;
use crate::world::light::Sky;
use crate::world::material::{Marks, Material};

/// Of how many lamps one stays lit, as in a building that nobody works in.
const LAMPS: u64 = 4;
/// Of how many screens one has been left on.
const SCREENS: u64 = 8;
/// Of how many windows one has light behind it.
const WINDOWS: u64 = 5;
/// Windows that high look into the building where there is a roof above, metres.
const INNER_M: f32 = 4.5;
/// Light from everywhere, 1 being 500 lx: what comes around corners in a building, and what a city sends back from the clouds.
const INDOORS: f32 = 0.004;
const OUTDOORS: f32 = 0.002;
/// Luminance of a lit room behind its window, cd/m², and the glow by which it looks so in simple light.
const LIT_ROOM_CD_M2: f32 = 120.0;
const LIT_ROOM_GLOW: f32 = 1.2;
/// Power of the lamps that stand for a skylight by day, at night.
const ATRIUM_POWER: f32 = 1.0;
/// Lamps with more power than any luminaire are no luminaires.
const DAYLIGHT_POWER: f32 = 6.0;

/// Before anything is built.
pub(super) fn begin(site: &mut Site) {
    site.plan.night = true;
    site.one_lit_of = LAMPS;
}

/// When all is built: what shone by day does so no more.
pub(super) fn fall(site: &mut Site) {
    let open = site.plan.sky.is_open();
    let ambient = if open { OUTDOORS } else { INDOORS };
    (site.plan.ambient, site.plan.sky) = match open {
        true => (ambient, Sky::Night),
        false => (ambient, Sky::Covered),
    };
    let seed = site.seed;
    for surface in &mut site.plan.builder.surfaces {
        let material = &mut surface.material;
        if material.glow <= 0.0 && material.luminance_cd_m2 <= 0.0 {
            continue;
        }
        // The faces of one window or screen, nearly: half a metre.
        let spot = surface
            .facet
            .corner
            .map(|v| (2.0 * v).floor() as i64 as u64);
        let draw = spot.iter().fold(seed, |sum, v| hash(sum ^ v)) >> 8;
        match material.substance {
            Substance::Sky => {
                *material = Material {
                    tone: material.tone,
                    ..Material::NIGHT_SKY
                }
            }
            Substance::Glass => {
                let is_seen_into = open || surface.facet.corner[2] > INNER_M;
                let is_lit = material.gloss > 0.0 && is_seen_into && draw.is_multiple_of(WINDOWS);
                *material = window(material, is_lit);
            }
            _ if material.gloss > 0.0 && !draw.is_multiple_of(SCREENS) => {
                *material = dark(material);
            }
            // Lamps: which of them are lit was decided when they were hung.
            _ => {}
        }
    }
    let mut number = 0;
    site.plan.lamps.retain_mut(|lamp| {
        if lamp.power < DAYLIGHT_POWER {
            return true;
        }
        lamp.power = ATRIUM_POWER;
        number += 1;
        number % LAMPS == 0
    });
}

/// A window at night: lit from behind, or black.
fn window(material: &Material, is_lit: bool) -> Material {
    match is_lit {
        true => Material {
            glow: LIT_ROOM_GLOW,
            luminance_cd_m2: LIT_ROOM_CD_M2,
            grain: Material::LAMP.grain,
            ..*material
        },
        false => Material {
            grain: Material::LAMP.grain,
            ..dark(material)
        },
    }
}

/// What no longer shines, and is black behind its glass.
fn dark(material: &Material) -> Material {
    Material {
        tone: 0.05,
        coverage: 0.0,
        marks: Marks::None,
        glow: 0.0,
        luminance_cd_m2: 0.0,
        pictures: 1,
        ..*material
    }
}
