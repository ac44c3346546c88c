//! What light meets on its way: opaque surfaces seen from either side, panes that dim it, emitters, the sun and the sky.

use wide::f32x8;

use super::super::bvh::Bvh;
use super::super::facet::Facet;
use super::super::ray::{LANES, NO_FACET, Origin, RayPacket};
use super::super::vector::{dot, norm, sub};
use super::emitters::{Emitters, is_compact};
use super::optics::Optics;

/// How far light is followed, metres.
pub(super) const FAR_M: f32 = 1e4;
/// Rays begin this far above the surface they leave, metres.
pub(super) const CLEARANCE_M: f32 = 1e-3;
/// Share of light that a pane lets through, averaged over directions: of the order of single clear glazing.
pub(super) const PANE_TRANSMITTANCE: f32 = 0.79;
/// Panes that one stretch of a path goes through at most; behind more it is dark.
const PANES: usize = 6;

/// The sun, as wide as it is seen from Earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SunDisc {
    /// Towards its middle, of length 1.
    pub direction: [f32; 3],
    /// Illuminance of a surface that faces it, lux.
    pub illuminance_lx: f32,
}

/// A lamp without a body, which shines evenly within a cone and less towards its border, as glTF's `KHR_lights_punctual` has them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PointLight {
    pub position: [f32; 3],
    /// Axis of the cone, of length 1.
    pub direction: [f32; 3],
    pub intensity_cd: f32,
    /// Of the angles from the axis at which it begins to fade, and where it ends; below −1 where it does not.
    pub cosines: [f32; 2],
}

impl PointLight {
    /// The way there from a spot, and the illuminance of the spot, nothing being in the way, lux.
    pub(super) fn arriving(&self, from: [f32; 3], normal: [f32; 3]) -> ([f32; 3], f32) {
        let to = sub(self.position, from);
        let squared = dot(to, to).max(1e-6);
        let distance = squared.sqrt();
        let [inner, outer] = self.cosines;
        let along = -dot(self.direction, to) / distance;
        // Squared, as the extension recommends.
        let share = ((along - outer) / (inner - outer).max(1e-3)).clamp(0.0, 1.0);
        let cosine = (dot(normal, to) / distance).max(0.0);
        (to, self.intensity_cd * share * share * cosine / squared)
    }
}

/// Mean radius of the sun's disc, radians.
pub(super) const SUN_RADIUS_RAD: f32 = 0.004_65;

/// A place as light sees it.
pub(crate) struct Scene {
    facets: Vec<Facet>,
    optics: Vec<Optics>,
    /// Where each was in the list that the scene was made of.
    sources: Vec<usize>,
    bvh: Bvh,
    /// Of facets that lie back to back: the other one, else [`NO_FACET`].
    backs: Vec<u32>,
    panes: Option<(Vec<Facet>, Bvh)>,
    pub(super) emitters: Emitters,
    pub(super) sun: Option<SunDisc>,
    pub(super) points: Vec<PointLight>,
    /// Luminance where there is nothing at all, cd/m².
    pub(super) void_cd_m2: f32,
}

/// Eight numbers.
pub(super) type Lanes = [f32; LANES];

/// What eight rays came to.
pub(super) struct Met {
    /// In lengths of the direction.
    pub distance: Lanes,
    pub facet: [u32; LANES],
    /// Share of light that the panes between let through.
    pub through: Lanes,
}

impl Scene {
    /// Puts surfaces in order. `void_cd_m2` is the luminance of what no surface closes off.
    pub(crate) fn new(surfaces: &[(Facet, Optics)], sun: Option<SunDisc>, void_cd_m2: f32) -> Self {
        let tree = |glass: bool| {
            let chosen: Vec<usize> = (0..surfaces.len())
                .filter(|&i| surfaces[i].1.glass == glass)
                .collect();
            let facets: Vec<Facet> = chosen.iter().map(|&i| surfaces[i].0).collect();
            let (bvh, order) = Bvh::build(&facets);
            let sources: Vec<usize> = order.iter().map(|&i| chosen[i]).collect();
            let facets: Vec<Facet> = order.iter().map(|&i| facets[i]).collect();
            (facets, sources, bvh)
        };
        let (facets, sources, bvh) = tree(false);
        let (glass, _, glass_bvh) = tree(true);
        let optics: Vec<Optics> = sources.iter().map(|&i| surfaces[i].1).collect();
        let emitters = Emitters::new(&facets, &optics, void_cd_m2);
        Self {
            panes: (!glass.is_empty()).then_some((glass, glass_bvh)),
            backs: backs(&facets),
            facets,
            optics,
            sources,
            bvh,
            emitters,
            sun,
            points: Vec::new(),
            void_cd_m2,
        }
    }

    /// The same with lamps that have no bodies.
    pub(crate) fn with_points(self, points: Vec<PointLight>) -> Self {
        Self { points, ..self }
    }

    pub(super) fn facet(&self, number: u32) -> &Facet {
        &self.facets[number as usize]
    }

    /// Where a facet was in the list that the scene was made of.
    pub(super) fn source(&self, number: u32) -> usize {
        self.sources[number as usize]
    }

    pub(super) fn optics(&self, number: u32) -> &Optics {
        &self.optics[number as usize]
    }

    /// The nearest surfaces within `limit`, seen from either side.
    pub(super) fn meet(&self, rays: &RayPacket, limit: f32x8) -> Met {
        let hit = self.bvh.cast_either(&self.facets, rays, limit);
        let along = rays.direction.map(|d| d.to_array());
        Met {
            distance: hit.distance.to_array(),
            facet: std::array::from_fn(|lane| {
                let facet = hit.facet[lane];
                let back = self.backs.get(facet as usize).copied().unwrap_or(NO_FACET);
                let ray = along.map(|a| a[lane]);
                // Of two back to back either may be found first: seen is the one that faces the ray.
                match back != NO_FACET && !self.is_front(facet, ray) {
                    true => back,
                    false => facet,
                }
            }),
            through: self.transmittance(rays, hit.distance),
        }
    }

    /// Share of light that comes along each ray from its end at `limit`.
    pub(super) fn visibility(&self, rays: &RayPacket, limit: f32x8) -> Lanes {
        let blocked = self.bvh.any(&self.facets, rays, limit);
        if blocked == 0xff {
            return [0.0; LANES];
        }
        let through = self.transmittance(rays, limit);
        std::array::from_fn(|lane| match blocked >> lane & 1 {
            1 => 0.0,
            _ => through[lane],
        })
    }

    /// Share of light that reaches the beginning of each ray from beyond everything.
    pub(super) fn visibility_of_sky(&self, rays: &RayPacket, limit: f32x8) -> Lanes {
        let met = self.meet(rays, limit);
        std::array::from_fn(|lane| match met.facet[lane] {
            NO_FACET => met.through[lane],
            facet if self.optics(facet).backdrop => met.through[lane],
            _ => 0.0,
        })
    }

    fn transmittance(&self, rays: &RayPacket, limit: f32x8) -> Lanes {
        let mut through = [1.0; LANES];
        let Some((facets, bvh)) = &self.panes else {
            return through;
        };
        let mut left = limit;
        let mut rays = *rays;
        for crossed in 0..=PANES {
            let hit = bvh.cast(facets, &rays, left);
            if hit.facet == [NO_FACET; LANES] {
                return through;
            }
            let lengths = rays.direction.map(|d| d.to_array());
            let step: Lanes = std::array::from_fn(|lane| {
                if hit.facet[lane] == NO_FACET {
                    return 0.0;
                }
                through[lane] *= match crossed {
                    PANES => 0.0,
                    _ => PANE_TRANSMITTANCE,
                };
                // On behind the pane, by no more than its thickness would be.
                let length = norm([lengths[0][lane], lengths[1][lane], lengths[2][lane]]);
                hit.distance.to_array()[lane] + CLEARANCE_M / length.max(1e-12)
            });
            let step = f32x8::new(step);
            // Lanes without a pane are done: nothing is left of their way.
            let found = f32x8::new(hit.facet.map(|f| if f == NO_FACET { 0.0 } else { 1.0 }));
            left = (left - step) * found;
            let origin = match rays.origin {
                Origin::Shared(eye) => eye.map(f32x8::splat),
                Origin::Each(origin) => origin,
            };
            rays.origin = Origin::Each(std::array::from_fn(|i| {
                origin[i] + step * rays.direction[i]
            }));
        }
        through
    }

    /// Whether a facet shines and is for shadow rays to find.
    pub(super) fn is_compact(&self, facet: u32) -> bool {
        is_compact(self.facet(facet), self.optics(facet), self.void_cd_m2)
    }

    /// Whether a ray along `direction` meets the front of a facet.
    pub(super) fn is_front(&self, facet: u32, direction: [f32; 3]) -> bool {
        dot(self.facet(facet).normal, direction) < 0.0
    }
}

/// Of each facet the one that has the same vertices and faces the other way, where there is one.
fn backs(facets: &[Facet]) -> Vec<u32> {
    let mut keyed: Vec<([[u32; 3]; 4], u32)> = facets
        .iter()
        .enumerate()
        .map(|(k, facet)| {
            let mut key = [[0; 3]; 4];
            for (bits, vertex) in key.iter_mut().zip(facet.vertices()) {
                // Minus zero is zero.
                *bits = vertex.map(|v| (v + 0.0).to_bits());
            }
            key.sort_unstable();
            (key, k as u32)
        })
        .collect();
    keyed.sort_unstable();
    let mut backs = vec![NO_FACET; facets.len()];
    for pair in keyed.windows(2) {
        let [(key, a), (other, b)] = [pair[0], pair[1]];
        let faces = |k: u32| facets[k as usize].normal;
        if key == other && dot(faces(a), faces(b)) < 0.0 {
            (backs[a as usize], backs[b as usize]) = (b, a);
        }
    }
    backs
}
