//! What rays see: brightness of the nearest surface, through glass and reflected in it, and what smooth surfaces mirror.

use wide::f32x8;

use super::crowd::Moment;
use super::ray::{LANES, NO_FACET, Origin, RayPacket};
use super::vector::{add, dot, scale};
use super::{FAR_M, World};

/// Panes looked through at most.
const PANES: usize = 3;
/// Share of light that a pane lets through at normal incidence.
const THROUGH: f32 = 0.86;
/// Share of light that a pane reflects at normal incidence.
const REFLECTED: f32 = 0.08;
/// Share of light that polished floors and screens mirror at normal incidence.
const POLISHED: f32 = 0.04;
/// What a floor mirrors is blurred as if seen over a cone of this width, radians.
const POLISH_RAD: f32 = 0.02;
/// Behind more panes than are looked through.
const DIM: f32 = 60.0;

/// What a ray met.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RayHit {
    /// Brightness; 255 is white at the nominal exposure, more is brighter.
    pub value: f32,
    /// The nearest facet.
    pub facet: u32,
}

impl Default for RayHit {
    fn default() -> Self {
        Self {
            value: 0.0,
            facet: NO_FACET,
        }
    }
}

impl World {
    /// What eight rays of unit length meet; black where there is nothing. A ray is the axis of a cone of `angle_rad`,
    /// over which textures are averaged.
    pub(crate) fn see(&self, rays: &RayPacket, angle_rad: f32, moment: &Moment) -> [RayHit; LANES] {
        self.look(
            rays,
            f32x8::splat(FAR_M),
            [0.0; LANES],
            angle_rad,
            moment,
            PANES,
        )
    }

    fn look(
        &self,
        rays: &RayPacket,
        limit: f32x8,
        travelled: [f32; LANES],
        angle_rad: f32,
        moment: &Moment,
        panes: usize,
    ) -> [RayHit; LANES] {
        let hit = self.cast_at(rays, limit, moment);
        let distance = hit.distance.to_array();
        let lanes = rays.direction.map(|d| d.to_array());
        let origins = match &rays.origin {
            Origin::Shared(eye) => eye.map(|v| [v; LANES]),
            Origin::Each(origin) => origin.map(|o| o.to_array()),
        };
        let mut pane = Pane::default();
        let mut polish = Pane::default();
        let mut seen: [RayHit; LANES] = std::array::from_fn(|lane| {
            if hit.facet[lane] == NO_FACET {
                return RayHit::default();
            }
            let number = hit.facet[lane] as usize;
            let ray = [lanes[0][lane], lanes[1][lane], lanes[2][lane]];
            let point = std::array::from_fn(|i| origins[i][lane] + distance[lane] * ray[i]);
            let carrier = hit.carrier[lane];
            let (facet, point_there, ray_there) = if carrier == 0 {
                (&self.facets[number], point, ray)
            } else {
                let [point, ray] = moment.to_carrier(carrier, point, ray);
                match self.crowd.facet(moment, carrier, number) {
                    Some(facet) => (facet, point, ray),
                    None => return RayHit::default(),
                }
            };
            // The pixel's cone cuts the surface in an ellipse; its mean radius decides the mip level.
            let cosine = (-dot(facet.normal, ray_there)).max(0.02);
            if self.skins[number].glass {
                pane.meet(
                    lane,
                    point,
                    ray,
                    facet.normal,
                    cosine,
                    travelled[lane] + distance[lane],
                    REFLECTED,
                );
            }
            let gloss = self.gloss(number);
            // What is mirrored mirrors nothing itself.
            if gloss > 0.0 && carrier == 0 && panes == PANES {
                let travelled = travelled[lane] + distance[lane];
                polish.meet(lane, point, ray, facet.normal, cosine, travelled, POLISHED);
                polish.mirrored[lane] *= gloss;
            }
            let footprint = (travelled[lane] + distance[lane]) * angle_rad / cosine.sqrt();
            let [a, b] = facet.coordinates(point_there);
            let far = self.outlook(number, [a, b], (ray_there, facet.normal), angle_rad);
            let mut value =
                far.unwrap_or_else(|| self.radiance(number, a, b, footprint, moment.time_s));
            if carrier != 0 {
                let normal = moment.in_world(carrier, facet.normal);
                value *= self.light_around(point, normal);
            }
            RayHit {
                value,
                facet: number as u32,
            }
        });
        if let Some(lit) = &self.lit
            && moment.has_people()
        {
            let points: [[f32; 3]; LANES] = std::array::from_fn(|lane| {
                std::array::from_fn(|i| origins[i][lane] + distance[lane] * lanes[i][lane])
            });
            self.shade_by_people(lit, &hit, &points, moment, &mut seen);
        }
        if polish.any {
            let rays = polish.rays(2e-3, &polish.back);
            let angle_rad = angle_rad + POLISH_RAD;
            let mirrored = self.look(
                &rays,
                polish.limit(),
                polish.travelled,
                angle_rad,
                moment,
                0,
            );
            for lane in 0..LANES {
                let share = polish.mirrored[lane];
                if share > 0.0 {
                    let light = seen[lane].value.powi(2) + share * mirrored[lane].value.powi(2);
                    seen[lane].value = light.sqrt();
                }
            }
        }
        if pane.any {
            self.through(&pane, &mut seen, angle_rad, moment, panes);
        }
        seen
    }

    /// Replaces the brightness of panes by what is behind them and what they mirror.
    fn through(
        &self,
        pane: &Pane,
        seen: &mut [RayHit; LANES],
        angle_rad: f32,
        moment: &Moment,
        panes: usize,
    ) {
        let limit = pane.limit();
        let sight = |offset: f32, direction: &[[f32; LANES]; 3]| {
            if panes == 0 {
                return [DIM; LANES];
            }
            let rays = pane.rays(offset, direction);
            self.look(&rays, limit, pane.travelled, angle_rad, moment, panes - 1)
                .map(|s| s.value)
        };
        let behind = sight(-2e-3, &pane.ahead);
        // A reflection is faint: it is not worth another pane.
        let mirrored = if panes == PANES {
            sight(2e-3, &pane.back)
        } else {
            [DIM; LANES]
        };
        for lane in 0..LANES {
            let share = pane.mirrored[lane];
            if share > 0.0 {
                let light =
                    THROUGH * (1.0 - share) * behind[lane].powi(2) + share * mirrored[lane].powi(2);
                seen[lane].value = light.sqrt();
            }
        }
    }
}

/// Where rays of a packet meet glass, or what is as smooth.
#[derive(Default)]
struct Pane {
    any: bool,
    point: [[f32; LANES]; 3],
    normal: [[f32; LANES]; 3],
    ahead: [[f32; LANES]; 3],
    back: [[f32; LANES]; 3],
    travelled: [f32; LANES],
    /// Share of the light that is mirrored; 0 for lanes that met nothing of the kind.
    mirrored: [f32; LANES],
}

impl Pane {
    #[allow(
        clippy::too_many_arguments,
        reason = "one lane of what a packet met, taken apart"
    )]
    fn meet(
        &mut self,
        lane: usize,
        point: [f32; 3],
        ray: [f32; 3],
        normal: [f32; 3],
        cosine: f32,
        travelled: f32,
        head_on: f32,
    ) {
        self.any = true;
        let back = add(ray, scale(normal, 2.0 * cosine));
        for i in 0..3 {
            self.point[i][lane] = point[i];
            self.normal[i][lane] = normal[i];
            self.ahead[i][lane] = ray[i];
            self.back[i][lane] = back[i];
        }
        self.travelled[lane] = travelled;
        // Schlick's approximation.
        self.mirrored[lane] = head_on + (1.0 - head_on) * (1.0 - cosine).max(0.0).powi(5);
    }

    /// Rays on from here, begun so far before the surface.
    fn rays(&self, offset: f32, direction: &[[f32; LANES]; 3]) -> RayPacket {
        let origin: [[f32; LANES]; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|lane| self.point[i][lane] + offset * self.normal[i][lane])
        });
        RayPacket {
            origin: Origin::Each(origin.map(f32x8::new)),
            direction: direction.map(f32x8::new),
        }
    }

    /// Nothing for lanes that do not go on.
    fn limit(&self) -> f32x8 {
        f32x8::new(self.mirrored.map(|m| if m > 0.0 { FAR_M } else { 0.0 }))
    }
}
