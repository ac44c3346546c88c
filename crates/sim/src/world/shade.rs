//! What rays see: brightness of the nearest surface, through glass and reflected in it.

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
/// Behind more panes than are looked through.
const DIM: f32 = 60.0;

/// What a ray met.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Brightness; 255 is white at the nominal exposure, more is brighter.
    pub value: f32,
    /// The nearest facet.
    pub facet: u32,
}

impl Default for Seen {
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
    pub(crate) fn see(&self, rays: &RayPacket, angle_rad: f32, moment: &Moment) -> [Seen; LANES] {
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
    ) -> [Seen; LANES] {
        let hit = self.cast_at(rays, limit, moment);
        let distance = hit.distance.to_array();
        let lanes = rays.direction.map(|d| d.to_array());
        let origins = match &rays.origin {
            Origin::Shared(eye) => eye.map(|v| [v; LANES]),
            Origin::Each(origin) => origin.map(|o| o.to_array()),
        };
        let mut pane = Pane::default();
        let mut seen: [Seen; LANES] = std::array::from_fn(|lane| {
            if hit.facet[lane] == NO_FACET {
                return Seen::default();
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
                    None => return Seen::default(),
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
                );
            }
            let footprint = (travelled[lane] + distance[lane]) * angle_rad / cosine.sqrt();
            let [a, b] = facet.coordinates(point_there);
            Seen {
                value: self.radiance(number, a, b, footprint, moment.time_s),
                facet: number as u32,
            }
        });
        if pane.any {
            self.through(&pane, &mut seen, angle_rad, moment, panes);
        }
        seen
    }

    /// Replaces the brightness of panes by what is behind them and what they mirror.
    fn through(
        &self,
        pane: &Pane,
        seen: &mut [Seen; LANES],
        angle_rad: f32,
        moment: &Moment,
        panes: usize,
    ) {
        let limit = f32x8::new(pane.mirrored.map(|m| if m > 0.0 { FAR_M } else { 0.0 }));
        let sight = |offset: f32, direction: &[[f32; LANES]; 3]| {
            let origin: [[f32; LANES]; 3] = std::array::from_fn(|i| {
                std::array::from_fn(|lane| pane.point[i][lane] + offset * pane.normal[i][lane])
            });
            if panes == 0 {
                return [DIM; LANES];
            }
            let rays = RayPacket {
                origin: Origin::Each(origin.map(f32x8::new)),
                direction: direction.map(f32x8::new),
            };
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

/// Where rays of a packet meet glass.
#[derive(Default)]
struct Pane {
    any: bool,
    point: [[f32; LANES]; 3],
    normal: [[f32; LANES]; 3],
    ahead: [[f32; LANES]; 3],
    back: [[f32; LANES]; 3],
    travelled: [f32; LANES],
    /// Share of the light that is mirrored; 0 for lanes without glass.
    mirrored: [f32; LANES],
}

impl Pane {
    fn meet(
        &mut self,
        lane: usize,
        point: [f32; 3],
        ray: [f32; 3],
        normal: [f32; 3],
        cosine: f32,
        travelled: f32,
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
        self.mirrored[lane] = REFLECTED + (1.0 - REFLECTED) * (1.0 - cosine).max(0.0).powi(5);
    }
}
