//! Shadows of people, in traced light: what they take of the sky or the ceiling above the floor around them, and of the sun.

use wide::f32x8;

use super::crowd::Moment;
use super::lit::{Lit, NOMINAL_LX};
use super::ray::{LANES, NO_FACET, Origin, PacketHit, RayPacket};
use super::vector::{add, dot, scale};
use super::{FAR_M, RayHit, World};

/// A surface lies in the sun where it has more than this share of the sun's light.
const SUNLIT: f32 = 0.8;
/// What is left at least of the light of a place in the sun, in a shadow.
const LEAST: f32 = 0.04;

impl World {
    /// Darkens what eight rays met of what does not move where people stand before the light.
    pub(super) fn shade_by_people(
        &self,
        lit: &Lit,
        hit: &PacketHit,
        points: &[[f32; 3]; LANES],
        moment: &Moment,
        seen: &mut [RayHit; LANES],
    ) {
        let still = |lane: usize| hit.facet[lane] != NO_FACET && hit.carrier[lane] == 0;
        for lane in (0..LANES).filter(|&lane| still(lane)) {
            let number = hit.facet[lane] as usize;
            if self.facets[number].normal[2] > 0.7 && !lit.shines[number] {
                seen[lane].value *= moment.open_share(points[lane]).sqrt();
            }
        }
        let Some(sun) = &lit.sun else {
            return;
        };
        // The share of its light that the sun gives each place; 0 where it does not.
        let share: [f32; LANES] = std::array::from_fn(|lane| {
            if !still(lane) {
                return 0.0;
            }
            let number = hit.facet[lane] as usize;
            let facet = &self.facets[number];
            let suns = sun.illuminance_lx * dot(facet.normal, sun.direction) / NOMINAL_LX;
            let [a, b] = facet.coordinates(points[lane]);
            let light = self.light.at(self.skins[number].light, a, b).powi(2);
            match suns > 0.0 && !lit.shines[number] && light > SUNLIT * suns {
                true => (suns / light).min(1.0 - LEAST),
                false => 0.0,
            }
        });
        if share == [0.0; LANES] {
            return;
        }
        let origin: [[f32; LANES]; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|lane| add(points[lane], scale(sun.direction, 2e-3))[i])
        });
        let rays = RayPacket {
            origin: Origin::Each(origin.map(f32x8::new)),
            direction: sun.direction.map(f32x8::splat),
        };
        let limit = share.map(|s| if s > 0.0 { FAR_M } else { 0.0 });
        let mut met = PacketHit::nothing(f32x8::new(limit));
        self.crowd.cast(moment, &rays, &mut met);
        for lane in 0..LANES {
            if met.facet[lane] != NO_FACET {
                seen[lane].value *= (1.0 - share[lane]).sqrt();
            }
        }
    }
}
