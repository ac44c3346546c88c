//! A path tracer for illuminance: light that arrives at a point of a surface, from emitters straight and by way of other surfaces.
//!
//! Surfaces scatter light equally in all directions and equally in all colours (the cameras are grey). At each point a path meets, one emitter is
//! drawn and tried by a shadow ray, and so is a point of the sun's disc; what paths in cosine-distributed directions hit by themselves is weighed
//! against it by the balance heuristic (Veach and Guibas, "Optimally Combining Sampling Techniques for Monte Carlo Rendering", 1995). Paths
//! end by Russian roulette (Arvo and Kirk, "Particle Transport and Image Synthesis", 1990), so that the mean is the true one.
//!
//! Where the light that surfaces get straight is known already, it is looked up there instead of being tried: far less noise.

use std::f32::consts::{PI, TAU};

use wide::f32x8;

use super::super::facet::Facet;
use super::super::light::LightGrid;
use super::super::ray::{LANES, NO_FACET, Origin, RayPacket};
use super::super::vector::{add, cross, dot, norm, scale, sub};
use super::emitters::{Choice, area_m2, draw, point_on};
use super::scene::{CLEARANCE_M, FAR_M, Lanes, SUN_RADIUS_RAD, Scene};
use crate::noise::{hash, unit};

/// Where roulette begins.
const SURE_BOUNCES: usize = 2;
/// No path is longer: with albedos up to 0.95, what is lost is below 0.2 % of the light.
const MOST_BOUNCES: usize = 128;

/// A point of a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub point: [f32; 3],
    pub normal: [f32; 3],
}

/// What paths from a spot brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gathered {
    /// Illuminance, lux.
    pub illuminance_lx: f32,
    /// Harmonic mean of the distances to what is around, metres.
    pub room_m: f32,
    /// Share of paths that began inside something.
    pub buried: f32,
}

/// Which light is asked for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Light<'a> {
    /// All of it.
    Whole,
    /// All but the sun's and that of compact emitters, straight; from what every facet gets of just these straight, lux, facets as in the list
    /// that the scene was made of. Compact emitters beyond a spot's list are left out: found by chance, they would be specks.
    Indirect(&'a [LightGrid]),
}

/// Numbers in [0, 1), one after another.
pub(super) struct Draws(u64);

impl Draws {
    pub(super) fn new(seed: u64) -> Self {
        Self(hash(seed))
    }

    pub(super) fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        // 24 bits: what a float holds below 1.
        (hash(self.0) >> 40) as f32 / (1_u64 << 24) as f32
    }
}

impl Scene {
    /// Illuminance at a spot by `paths` paths (rounded up to eight), lux.
    pub(crate) fn illuminance_lx(&self, spot: &Spot, paths: usize, seed: u64) -> f32 {
        self.gather(spot, paths, seed, Light::Whole).illuminance_lx
    }

    /// Share of rays from a spot that meet something from within.
    pub(super) fn buried(&self, spot: &Spot, seed: u64) -> f32 {
        let frame = Frame::about(spot.normal);
        let start = add(spot.point, scale(spot.normal, CLEARANCE_M));
        let mut draws = Draws::new(seed);
        let turn = draws.next() * TAU;
        let rays: [[f32; 3]; LANES] = std::array::from_fn(|k| {
            let share = (k as f32 + draws.next()) / LANES as f32;
            frame.cosine([share, turn + 2.399_963_2 * k as f32])
        });
        let along = std::array::from_fn(|i| f32x8::new(rays.map(|ray| ray[i])));
        let met = self.meet(&RayPacket::from_point(start, along), f32x8::splat(FAR_M));
        let within = (0..LANES).filter(|&lane| {
            let facet = met.facet[lane];
            facet != NO_FACET && !self.is_front(facet, rays[lane])
        });
        within.count() as f32 / LANES as f32
    }

    pub(super) fn gather(&self, spot: &Spot, paths: usize, seed: u64, light: Light) -> Gathered {
        let packets = paths.div_ceil(LANES).max(1);
        let total = (packets * LANES) as f32;
        let frame = Frame::about(spot.normal);
        let turn = unit(hash(seed)) as f32 * TAU;
        let start = add(spot.point, scale(spot.normal, CLEARANCE_M));
        let mut sums = Sums::default();
        for packet in 0..packets {
            let mut paths = Paths::at(start, spot.normal, |lane| {
                hash(seed ^ hash((packet * LANES + lane) as u64 + 1))
            });
            if matches!(light, Light::Whole) {
                self.light_straight(&mut paths);
            }
            paths.aim(|lane, draws| {
                // Golden-angle spiral over the disc, turned from spot to spot, lifted to the hemisphere.
                let k = (packet * LANES + lane) as f32;
                let angle = turn + 2.399_963_2 * k;
                frame.cosine([(k + draws.next()) / total, angle])
            });
            self.follow(&mut paths, light, &mut sums);
            sums.light += paths.brought.iter().sum::<f32>();
        }
        Gathered {
            illuminance_lx: PI * sums.light / total,
            room_m: total / sums.nearness.max(1e-6),
            buried: sums.buried / total,
        }
    }

    /// Follows paths to their ends.
    fn follow(&self, paths: &mut Paths, light: Light, sums: &mut Sums) {
        for bounce in 0..MOST_BOUNCES {
            if paths.weight == [0.0; LANES] {
                return;
            }
            let rays = paths.rays(bounce == 0);
            let met = self.meet(&rays, paths.limit(FAR_M));
            for lane in 0..LANES {
                let weight = paths.weight[lane] * met.through[lane];
                if weight <= 0.0 {
                    paths.weight[lane] = 0.0;
                    continue;
                }
                paths.weight[lane] = 0.0;
                let facet = met.facet[lane];
                if facet == NO_FACET {
                    paths.brought[lane] += weight * self.void_cd_m2;
                    continue;
                }
                let ray = paths.direction(lane);
                let distance = met.distance[lane];
                if bounce == 0 {
                    sums.nearness += 1.0 / distance.max(CLEARANCE_M);
                }
                if !self.is_front(facet, ray) {
                    // Surfaces are closed: only from inside is a back seen.
                    sums.buried += if bounce == 0 { 1.0 } else { 0.0 };
                    continue;
                }
                let optics = *self.optics(facet);
                if optics.luminance_cd_m2 > 0.0 {
                    let share = self.share_of_hit(paths, lane, facet, distance, light);
                    paths.brought[lane] += weight * share * optics.luminance_cd_m2;
                }
                if optics.backdrop {
                    continue;
                }
                let mut weight = weight * optics.albedo;
                if let Light::Indirect(grids) = light {
                    let at: [f32; 3] = std::array::from_fn(|i| {
                        paths.origin[i][lane] + distance * paths.along[i][lane]
                    });
                    let [a, b] = self.facet(facet).coordinates(at);
                    paths.brought[lane] += weight * grids[self.source(facet)].at(a, b) / PI;
                }
                if bounce >= SURE_BOUNCES {
                    let chance = weight.clamp(0.05, 0.95);
                    let survives = paths.draws[lane].next() < chance;
                    weight = if survives { weight / chance } else { 0.0 };
                }
                paths.arrive(lane, distance, self.facet(facet), weight);
            }
            if matches!(light, Light::Whole) {
                self.light_straight(paths);
            }
            paths.scatter();
        }
    }

    /// How much of an emitter that a path has hit by itself counts, the rest being found by shadow rays.
    fn share_of_hit(
        &self,
        paths: &Paths,
        lane: usize,
        facet: u32,
        distance: f32,
        light: Light,
    ) -> f32 {
        if matches!(light, Light::Indirect(_)) {
            return if self.is_compact(facet) { 0.0 } else { 1.0 };
        }
        let choices = self.emitters.near(paths.point(lane));
        let Some(choice) = choices.iter().find(|c| c.facet == facet) else {
            return 1.0;
        };
        let ray = paths.direction(lane);
        let cosine_there = -dot(self.facet(facet).normal, ray);
        let by_shadow = choice.chance * distance * distance
            / (area_m2(self.facet(facet)) * cosine_there).max(1e-12);
        let by_path = dot(paths.normals[lane], ray) / PI;
        by_path / (by_path + by_shadow).max(1e-12)
    }

    /// Adds what one emitter of the list and the sun bring to the places where paths are, as seen along the paths.
    fn light_straight(&self, paths: &mut Paths) {
        let mut to = [[0.0_f32; LANES]; 3];
        let mut gain = [0.0_f32; LANES];
        for lane in 0..LANES {
            if paths.weight[lane] <= 0.0 {
                continue;
            }
            let point = paths.point(lane);
            let choices = self.emitters.near(point);
            if choices.is_empty() {
                continue;
            }
            let draws = &mut paths.draws[lane];
            let (which, across) = (draws.next(), [draws.next(), draws.next()]);
            if let Some(choice) = draw(choices, which) {
                let target = point_on(self.facet(choice.facet), across);
                gain[lane] = self.worth(choice, point, paths.normals[lane], target);
                for (lanes, component) in to.iter_mut().zip(sub(target, point)) {
                    lanes[lane] = component;
                }
            }
        }
        if gain != [0.0; LANES] {
            let rays = paths.towards(&to);
            // Short of the emitter itself.
            let limit = gain.map(|g| if g > 0.0 { 0.999 } else { 0.0 });
            let seen = self.visibility(&rays, f32x8::new(limit));
            for lane in 0..LANES {
                paths.brought[lane] += paths.weight[lane] * gain[lane] * seen[lane] / PI;
            }
        }
        if !self.points.is_empty() {
            let mut to = [[0.0_f32; LANES]; 3];
            let mut gain = [0.0_f32; LANES];
            for lane in (0..LANES).filter(|&lane| paths.weight[lane] > 0.0) {
                let count = self.points.len();
                let which = (paths.draws[lane].next() * count as f32) as usize;
                let light = &self.points[which.min(count - 1)];
                let (way, lux) = light.arriving(paths.point(lane), paths.normals[lane]);
                gain[lane] = lux * count as f32;
                for (lanes, component) in to.iter_mut().zip(way) {
                    lanes[lane] = component;
                }
            }
            let limit = gain.map(|g| if g > 0.0 { 0.999 } else { 0.0 });
            let seen = self.visibility(&paths.towards(&to), f32x8::new(limit));
            for lane in 0..LANES {
                paths.brought[lane] += paths.weight[lane] * gain[lane] * seen[lane] / PI;
            }
        }
        if let Some(sun) = self.sun {
            let frame = Frame::about(sun.direction);
            let mut to = [[0.0_f32; LANES]; 3];
            let mut gain = [0.0_f32; LANES];
            for lane in 0..LANES {
                let draws = &mut paths.draws[lane];
                let ray = frame.in_disc([draws.next(), draws.next()]);
                let cosine = dot(paths.normals[lane], ray).max(0.0);
                if paths.weight[lane] > 0.0 {
                    gain[lane] = sun.illuminance_lx * cosine;
                }
                for (lanes, component) in to.iter_mut().zip(ray) {
                    lanes[lane] = component;
                }
            }
            if gain != [0.0; LANES] {
                let limit = gain.map(|g| if g > 0.0 { FAR_M } else { 0.0 });
                let seen = self.visibility_of_sky(&paths.towards(&to), f32x8::new(limit));
                for lane in 0..LANES {
                    paths.brought[lane] += paths.weight[lane] * gain[lane] * seen[lane] / PI;
                }
            }
        }
    }

    /// Illuminance that a point of an emitter stands for when it is drawn, lux, nothing being in the way.
    fn worth(&self, choice: &Choice, point: [f32; 3], normal: [f32; 3], target: [f32; 3]) -> f32 {
        let facet = self.facet(choice.facet);
        let to = sub(target, point);
        let squared = dot(to, to).max(1e-8);
        let distance = squared.sqrt();
        let here = dot(normal, to) / distance;
        let there = -dot(facet.normal, to) / distance;
        if here <= 0.0 || there <= 0.0 {
            return 0.0;
        }
        let area = area_m2(facet);
        let by_shadow = choice.chance * squared / (area * there);
        let by_path = here / PI;
        let luminance = self.optics(choice.facet).luminance_cd_m2;
        luminance * here / (by_shadow + by_path)
    }
}

/// What is summed over paths.
#[derive(Default)]
struct Sums {
    light: f32,
    nearness: f32,
    buried: f32,
}

/// Eight paths.
struct Paths {
    origin: [Lanes; 3],
    along: [Lanes; 3],
    normals: [[f32; 3]; LANES],
    /// Share of the light from ahead that comes to where the path began; 0 when it has ended.
    weight: Lanes,
    /// Mean luminance found so far, cd/m².
    brought: Lanes,
    draws: [Draws; LANES],
}

impl Paths {
    fn at(start: [f32; 3], normal: [f32; 3], seed: impl Fn(usize) -> u64) -> Self {
        Self {
            origin: start.map(|v| [v; LANES]),
            along: [[0.0; LANES]; 3],
            normals: [normal; LANES],
            weight: [1.0; LANES],
            brought: [0.0; LANES],
            draws: std::array::from_fn(|lane| Draws::new(seed(lane))),
        }
    }

    fn point(&self, lane: usize) -> [f32; 3] {
        self.origin.map(|o| o[lane])
    }

    fn direction(&self, lane: usize) -> [f32; 3] {
        self.along.map(|d| d[lane])
    }

    fn aim(&mut self, ray: impl Fn(usize, &mut Draws) -> [f32; 3]) {
        for lane in 0..LANES {
            let ray = ray(lane, &mut self.draws[lane]);
            for (lanes, component) in self.along.iter_mut().zip(ray) {
                lanes[lane] = component;
            }
        }
    }

    /// New directions, each with a chance that goes with the cosine.
    fn scatter(&mut self) {
        for lane in 0..LANES {
            if self.weight[lane] > 0.0 {
                let draws = &mut self.draws[lane];
                let ray =
                    Frame::about(self.normals[lane]).cosine([draws.next(), TAU * draws.next()]);
                for (lanes, component) in self.along.iter_mut().zip(ray) {
                    lanes[lane] = component;
                }
            }
        }
    }

    fn arrive(&mut self, lane: usize, distance: f32, facet: &Facet, weight: f32) {
        let ray = self.direction(lane);
        let on = add(scale(ray, distance), scale(facet.normal, CLEARANCE_M));
        for (origin, step) in self.origin.iter_mut().zip(on) {
            origin[lane] += step;
        }
        self.normals[lane] = facet.normal;
        self.weight[lane] = weight;
    }

    fn rays(&self, shared: bool) -> RayPacket {
        RayPacket {
            origin: match shared {
                true => Origin::Shared(self.point(0)),
                false => Origin::Each(self.origin.map(f32x8::new)),
            },
            direction: self.along.map(f32x8::new),
        }
    }

    fn towards(&self, to: &[Lanes; 3]) -> RayPacket {
        RayPacket {
            origin: Origin::Each(self.origin.map(f32x8::new)),
            direction: to.map(f32x8::new),
        }
    }

    fn limit(&self, far: f32) -> f32x8 {
        f32x8::new(self.weight.map(|w| if w > 0.0 { far } else { 0.0 }))
    }
}

/// Directions about an axis.
pub(super) struct Frame {
    axis: [f32; 3],
    side: [f32; 3],
    other: [f32; 3],
}

impl Frame {
    pub(super) fn about(axis: [f32; 3]) -> Self {
        let helper = if axis[0].abs() < 0.6 {
            [1.0, 0.0, 0.0]
        } else {
            [0.0, 1.0, 0.0]
        };
        let side = cross(axis, helper);
        let side = scale(side, 1.0 / norm(side).max(1e-12));
        Self {
            axis,
            side,
            other: cross(axis, side),
        }
    }

    /// A direction whose chance goes with the cosine, by its share of the disc's area and its angle.
    pub(super) fn cosine(&self, [share, angle]: [f32; 2]) -> [f32; 3] {
        let radius = share.sqrt();
        let up = (1.0 - share).max(0.0).sqrt();
        let (sin, cos) = angle.sin_cos();
        std::array::from_fn(|i| {
            radius * (cos * self.side[i] + sin * self.other[i]) + up * self.axis[i]
        })
    }

    /// A direction to a point of the sun's disc about the axis, of length 1.
    pub(super) fn in_disc(&self, [share, turn]: [f32; 2]) -> [f32; 3] {
        let radius = SUN_RADIUS_RAD * share.sqrt();
        let (sin, cos) = (TAU * turn).sin_cos();
        let ray: [f32; 3] = std::array::from_fn(|i| {
            self.axis[i] + radius * (cos * self.side[i] + sin * self.other[i])
        });
        scale(ray, 1.0 / norm(ray).max(1e-12))
    }
}
