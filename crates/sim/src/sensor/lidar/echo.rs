//! What one shot meets: through glass, over the width of the beam, and which of it comes back as an echo.

use wide::f32x8;

use lsfb_drivers::lidar::Returns;

use super::{LidarSim, Return};
use crate::noise::{gaussian, hash, unit};
use crate::world::crowd::Moment;
use crate::world::vector::dot;
use crate::world::{LANES, NO_FACET, Origin, RayPacket, World};

/// Panes of glass that light goes through at most.
const PANES: usize = 4;
/// Cosine of the incidence from which a pane may send light back.
const GLASS_COSINE: f64 = 0.985;
/// Share of those shots that it does send back.
const GLASS_ANSWERS: f64 = 0.6;
/// How much brighter than a matt surface a pane is that answers.
const GLASS_GLARE: f64 = 20.0;
/// How far behind a pane a shot goes on, metres.
const BEYOND_M: f32 = 2e-3;
/// Rays of a beam: its axis, and four at two thirds of the way to its corners, so that their spread is that of a beam
/// evenly lit.
pub(super) const RAYS: usize = 5;
/// Where they are, in widths and heights of the beam; a line through the first three meets both sides of most edges.
pub(super) const PATTERN: [[f64; 2]; RAYS] = {
    const OFF: f64 = 1.0 / 3.0;
    [
        [0.0, 0.0],
        [OFF, OFF],
        [-OFF, -OFF],
        [OFF, -OFF],
        [-OFF, OFF],
    ]
};

/// What sends light back.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Echo {
    pub distance_m: f64,
    /// Of the angle between shot and normal.
    pub cosine: f64,
    /// Diffuse reflectance, times the share of the beam that it covers.
    pub reflectance: f64,
    /// How much brighter it is than a matt surface.
    pub glare: f64,
    /// Which facet, and who carries it.
    pub facet: u32,
    pub carrier: u8,
}

impl Echo {
    /// Light that comes back: it falls with the square of the distance.
    fn strength(&self) -> f64 {
        self.reflectance * self.cosine / self.distance_m.powi(2).max(1e-6)
    }
}

/// A few echoes, the nearest first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Echoes<const MOST: usize> {
    list: [Echo; MOST],
    count: usize,
}

/// Along one ray: every pane may answer, and what is behind the last.
pub(super) type Trail = Echoes<{ PANES + 1 }>;

impl<const MOST: usize> Default for Echoes<MOST> {
    fn default() -> Self {
        Self {
            list: [Echo::default(); MOST],
            count: 0,
        }
    }
}

impl<const MOST: usize> Echoes<MOST> {
    fn push(&mut self, echo: Echo) {
        if let Some(place) = self.list.get_mut(self.count) {
            *place = echo;
            self.count += 1;
        }
    }

    pub(super) fn as_slice(&self) -> &[Echo] {
        &self.list[..self.count]
    }
}

/// Whether rays of one beam met the same surfaces.
pub(super) fn agree(a: &Trail, b: &Trail) -> bool {
    let same = |(a, b): (&Echo, &Echo)| (a.facet, a.carrier) == (b.facet, b.carrier);
    a.count == b.count && a.as_slice().iter().zip(b.as_slice()).all(same)
}

/// The echoes of a beam by those of some of its rays: what is too near to each other is one.
pub(super) fn merge(trails: &[Trail], separation_m: f64) -> Trail {
    if let [Trail { count: 0 | 1, .. }] = trails {
        return trails[0];
    }
    let share = 1.0 / trails.len() as f64;
    let mut all = Echoes::<{ RAYS * (PANES + 1) }>::default();
    for echo in trails.iter().flat_map(Trail::as_slice) {
        all.push(*echo);
    }
    let parts = &mut all.list[..all.count];
    parts.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
    let mut merged = Trail::default();
    let mut rest = &*parts;
    while !rest.is_empty() {
        let mut group = together(&rest[..1], share);
        let mut taken = 1;
        while taken < rest.len() && rest[taken].distance_m - group.distance_m < separation_m {
            taken += 1;
            group = together(&rest[..taken], share);
        }
        merged.push(group);
        rest = &rest[taken..];
    }
    merged
}

/// One echo of several rays, each a share of the beam: where most of its light comes from.
fn together(group: &[Echo], share: f64) -> Echo {
    let light = |e: &Echo| (e.glare * e.strength()).max(1e-12);
    let total: f64 = group.iter().map(light).sum();
    let mean = |of: fn(&Echo) -> f64| group.iter().map(|e| light(e) * of(e)).sum::<f64>() / total;
    Echo {
        distance_m: mean(|e| e.distance_m),
        cosine: mean(|e| e.cosine),
        reflectance: share * group.iter().map(|e| e.reflectance).sum::<f64>(),
        glare: mean(|e| e.glare),
        ..group[0]
    }
}

impl LidarSim {
    /// What sends the light of eight rays back; most of it goes through glass.
    pub(super) fn follow(
        &self,
        world: &World,
        moment: &Moment,
        mut rays: RayPacket,
        number: impl Fn(usize) -> u64,
    ) -> [Trail; LANES] {
        let mut trails = [Trail::default(); LANES];
        let mut travelled = [0.0_f64; LANES];
        let mut limit = [self.config.max_range_m as f32 + 1.0; LANES];
        for pane in 0..PANES {
            let hit = world.cast_at(&rays, f32x8::new(limit), moment);
            let distance = hit.distance.to_array();
            let direction = rays.direction.map(|d| d.to_array());
            let mut origin = match rays.origin {
                Origin::Each(origin) => origin.map(|o| o.to_array()),
                Origin::Shared(eye) => eye.map(|v| [v; LANES]),
            };
            let mut goes_on = false;
            for lane in 0..LANES {
                let facet = hit.facet[lane] as usize;
                let carrier = hit.carrier[lane];
                limit[lane] = 0.0;
                if hit.facet[lane] == NO_FACET {
                    continue;
                }
                let Some(normal) = world.facet_hit(moment, carrier, facet).map(|f| f.normal) else {
                    continue;
                };
                let ray = std::array::from_fn(|axis| direction[axis][lane]);
                let [_, ray_there] = moment.to_carrier(carrier, [0.0; 3], ray);
                let mut echo = Echo {
                    distance_m: travelled[lane] + f64::from(distance[lane]),
                    cosine: f64::from(-dot(normal, ray_there)),
                    reflectance: f64::from(world.reflectance(facet)),
                    glare: 1.0,
                    facet: hit.facet[lane],
                    carrier,
                };
                travelled[lane] = echo.distance_m;
                if world.is_glass(facet) {
                    let step = distance[lane] + BEYOND_M;
                    for axis in 0..3 {
                        origin[axis][lane] += step * ray[axis];
                    }
                    travelled[lane] += f64::from(BEYOND_M);
                    limit[lane] = self.config.max_range_m as f32 + 1.0;
                    goes_on = true;
                    let bits = hash(self.seed ^ hash(number(lane) ^ (pane as u64 + 1) << 56));
                    // A pane is a mirror: it answers only where it is met head-on.
                    if echo.cosine <= GLASS_COSINE || unit(bits) >= GLASS_ANSWERS {
                        continue;
                    }
                    echo.glare = GLASS_GLARE;
                }
                trails[lane].push(echo);
            }
            if !goes_on {
                break;
            }
            rays.origin = Origin::Each(origin.map(f32x8::new));
        }
        trails
    }

    /// What is sent for a shot: in dual mode for the even and the odd block, else the first only.
    pub(super) fn answer(&self, echoes: &[Echo], number: u64) -> [Return; 2] {
        let mut heard = [(0.0, Return::default()); PANES + 1];
        let mut count = 0;
        for (order, echo) in echoes.iter().enumerate() {
            // The first echo has the number of the shot itself.
            let found = self.measure(echo, number ^ (order as u64) << 60);
            if found.range_count > 0 && count < heard.len() {
                heard[count] = (echo.glare * echo.strength(), found);
                count += 1;
            }
        }
        let heard = &heard[..count];
        let brightest = |except: Option<usize>| {
            let others = (0..heard.len()).filter(|k| Some(*k) != except);
            others.max_by(|a, b| heard[*a].0.total_cmp(&heard[*b].0).then(b.cmp(a)))
        };
        let (Some(strongest), Some(last)) = (brightest(None), heard.len().checked_sub(1)) else {
            return [Return::default(); 2];
        };
        let [strongest_heard, last_heard] = [strongest, last].map(|k| heard[k].1);
        match self.config.returns {
            Returns::Strongest => [strongest_heard, Return::default()],
            Returns::Last => [last_heard, Return::default()],
            // VLP-32C 63-9325 p. 57.
            Returns::Dual if strongest != last => [last_heard, strongest_heard],
            Returns::Dual => {
                let second = brightest(Some(strongest)).unwrap_or(strongest);
                [last_heard, heard[second].1]
            }
        }
    }

    /// Turns a distance into what is sent: noise, lost returns, the sensor's steps.
    pub(super) fn measure(&self, echo: &Echo, number: u64) -> Return {
        let bits = hash(self.seed ^ hash(number));
        let survival = (echo.cosine / self.config.grazing_cosine).clamp(0.0, 1.0);
        let weakest = self.config.weakest_reflectance / self.config.weakest_range_m.powi(2);
        let seen = (echo.strength() / weakest).min(1.0);
        let lost = unit(hash(bits)) > survival * seen * (1.0 - self.config.dropout);
        let range_m = echo.distance_m + self.config.range_noise_m * gaussian(bits);
        if lost || range_m < self.config.min_range_m || range_m > self.config.max_range_m {
            return Return::default();
        }
        Return {
            range_count: (range_m / self.range_unit_m()).round() as u16,
            reflectivity: (100.0 * echo.reflectance) as u8,
        }
    }
}
