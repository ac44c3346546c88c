//! A spinning VLP-32C: every laser fired from where the sensor is at that microsecond.

use rayon::prelude::*;
use wide::f32x8;

use lsfb_drivers::velodyne::model::{Model, ModelTable};
use lsfb_drivers::velodyne::wire::{BLOCKS, CHANNELS};
use lsfb_geometry::{Se3, Vector3};

use crate::config::LidarConfig;
use crate::noise::{gaussian, hash, unit};
use crate::walk::Walk;
use crate::world::crowd::Moment;
use crate::world::vector::dot;
use crate::world::{LANES, NO_FACET, Origin, RayPacket, World};

/// The sensor's constants.
const TABLE: &ModelTable = Model::Vlp32c.table();
/// Lasers of a VLP-32C.
pub const LASERS: usize = CHANNELS;
/// Firing cycles in a data packet.
pub const CYCLES_PER_PACKET: usize = BLOCKS;
/// Duration of a firing cycle, nanoseconds.
pub const CYCLE_NS: i64 = TABLE.block_period_ns as i64;
/// Length of one count of a range, metres.
pub const RANGE_UNIT_M: f64 = TABLE.distance_unit_mm as f64 * 1e-3;

/// One range as sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Return {
    /// Range in units of 4 mm, 0 for no return.
    pub range_count: u16,
    /// Diffuse reflectivity, percent.
    pub reflectivity: u8,
}

/// All lasers fired once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FiringCycle {
    /// First firing, nanoseconds after the start of the walk.
    pub offset_ns: i64,
    /// Encoder angle at the first firing, 0.01°.
    pub azimuth_centideg: u16,
    /// By laser.
    pub returns: [Return; LASERS],
}

/// Panes of glass that light goes through at most, and what is behind.
const PANES: usize = 4;
/// Cosine of the incidence from which a pane may send light back.
const GLASS_COSINE: f64 = 0.985;
/// Share of those shots that it does send back.
const GLASS_ANSWERS: f64 = 0.6;
/// How far behind a pane a shot goes on, metres.
const BEYOND_M: f32 = 2e-3;

/// What sends light back.
#[derive(Clone, Copy, Debug)]
struct Echo {
    distance_m: f64,
    /// Of the angle between shot and normal.
    cosine: f64,
    reflectance: f64,
}

/// Fires the lasers of a LiDAR on a rig.
#[derive(Clone, Debug)]
pub struct LidarSim {
    rig_from_lidar: Se3,
    config: LidarConfig,
    seed: u64,
}

impl LidarSim {
    /// A LiDAR at a place on the rig.
    pub fn new(rig_from_lidar: Se3, config: &LidarConfig, seed: u64) -> Self {
        Self {
            rig_from_lidar,
            config: config.clone(),
            seed,
        }
    }

    /// Exact encoder angle, degrees; 0 at the start of the walk, growing clockwise seen from above.
    fn azimuth_deg(&self, offset_ns: i64) -> f64 {
        let per_turn_ns = 60_000_000_000 / i64::from(self.config.rpm);
        360.0 * (offset_ns % per_turn_ns) as f64 / per_turn_ns as f64
    }

    /// Fires cycles `first .. first + count`.
    pub fn fire(&self, world: &World, walk: &Walk, first: u64, count: usize) -> Vec<FiringCycle> {
        (0..count.div_ceil(LANES))
            .into_par_iter()
            .flat_map_iter(|group| {
                let start = group * LANES;
                let length = LANES.min(count - start);
                self.fire_group(world, walk, first + start as u64)
                    .into_iter()
                    .take(length)
            })
            .collect()
    }

    /// Eight cycles in a row. A laser's eight rays are neighbours, so they go through the world together.
    fn fire_group(&self, world: &World, walk: &Walk, first: u64) -> [FiringCycle; LANES] {
        let mut cycles: [FiringCycle; LANES] = std::array::from_fn(|lane| {
            let offset_ns = (first as i64 + lane as i64) * CYCLE_NS;
            FiringCycle {
                offset_ns,
                azimuth_centideg: ((self.azimuth_deg(offset_ns) * 100.0).round() as u32 % 36_000)
                    as u16,
                returns: [Return::default(); LASERS],
            }
        });
        let motions: [_; LANES] =
            std::array::from_fn(|lane| walk.at(cycles[lane].offset_ns as f64 * 1e-9));
        let place = motions[0].world_from_rig.translation;
        let moment = world.moment(
            cycles[LANES / 2].offset_ns as f64 * 1e-9,
            [place.x as f32, place.y as f32],
        );
        for pair in 0..LASERS / 2 {
            let delay_ns = firing_delay_ns(2 * pair);
            let poses: [Se3; LANES] = std::array::from_fn(|lane| {
                motions[lane].coasted(delay_ns as f64 * 1e-9) * self.rig_from_lidar
            });
            for laser in [2 * pair, 2 * pair + 1] {
                let mut origin = [[0.0_f32; LANES]; 3];
                let mut direction = [[0.0_f32; LANES]; 3];
                for lane in 0..LANES {
                    let azimuth = self.azimuth_deg(cycles[lane].offset_ns + delay_ns);
                    let ray = poses[lane].rotation * beam_direction(laser, azimuth);
                    for axis in 0..3 {
                        origin[axis][lane] = poses[lane].translation[axis] as f32;
                        direction[axis][lane] = ray[axis] as f32;
                    }
                }
                let rays = RayPacket {
                    origin: Origin::Each(origin.map(f32x8::new)),
                    direction: direction.map(f32x8::new),
                };
                let number = |lane: usize| (first + lane as u64) * LASERS as u64 + laser as u64;
                let echoes = self.echoes(world, &moment, rays, number);
                for (lane, cycle) in cycles.iter_mut().enumerate() {
                    if let Some(echo) = echoes[lane] {
                        cycle.returns[laser] = self.measure(&echo, number(lane));
                    }
                }
            }
        }
        cycles
    }

    /// What sends the light of eight shots back; most of it goes through glass.
    fn echoes(
        &self,
        world: &World,
        moment: &Moment,
        mut rays: RayPacket,
        number: impl Fn(usize) -> u64,
    ) -> [Option<Echo>; LANES] {
        let mut echoes = [None; LANES];
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
                let cosine = f64::from(-dot(normal, ray_there));
                travelled[lane] += f64::from(distance[lane]);
                if world.is_glass(facet) {
                    let bits = hash(self.seed ^ hash(number(lane) ^ (pane as u64 + 1) << 56));
                    // A pane is a mirror: it answers only where it is met head-on.
                    let answers = cosine > GLASS_COSINE && unit(bits) < GLASS_ANSWERS;
                    if !answers {
                        let step = distance[lane] + BEYOND_M;
                        for axis in 0..3 {
                            origin[axis][lane] += step * ray[axis];
                        }
                        travelled[lane] += f64::from(BEYOND_M);
                        limit[lane] = self.config.max_range_m as f32 + 1.0;
                        goes_on = true;
                        continue;
                    }
                }
                echoes[lane] = Some(Echo {
                    distance_m: travelled[lane],
                    cosine,
                    reflectance: f64::from(world.reflectance(facet)),
                });
            }
            if !goes_on {
                break;
            }
            rays.origin = Origin::Each(origin.map(f32x8::new));
        }
        echoes
    }

    /// Turns a distance into what is sent: noise, lost returns, 4 mm steps.
    fn measure(&self, echo: &Echo, number: u64) -> Return {
        let Echo {
            distance_m,
            cosine,
            reflectance,
        } = *echo;
        let bits = hash(self.seed ^ hash(number));
        let survival = (cosine / self.config.grazing_cosine).clamp(0.0, 1.0);
        // The light that comes back falls with the square of the distance.
        let weakest = self.config.weakest_reflectance / self.config.weakest_range_m.powi(2);
        let seen = (reflectance * cosine / distance_m.powi(2).max(1e-6) / weakest).min(1.0);
        let lost = unit(hash(bits)) > survival * seen * (1.0 - self.config.dropout);
        let range_m = distance_m + self.config.range_noise_m * gaussian(bits);
        if lost || range_m < self.config.min_range_m || range_m > self.config.max_range_m {
            return Return::default();
        }
        Return {
            range_count: (range_m / RANGE_UNIT_M).round() as u16,
            reflectivity: (100.0 * reflectance) as u8,
        }
    }
}

/// Direction of a laser in the LiDAR frame (x forward, y left, z up) at an encoder angle.
pub fn beam_direction(laser: usize, azimuth_deg: f64) -> Vector3<f64> {
    let channel = &TABLE.channels[laser];
    let elevation = channel.elevation_deg.to_radians();
    let (sin, cos) = (azimuth_deg + channel.azimuth_offset_deg)
        .to_radians()
        .sin_cos();
    Vector3::new(
        elevation.cos() * cos,
        -elevation.cos() * sin,
        elevation.sin(),
    )
}

/// Time at which a laser fires, after the beginning of its cycle, nanoseconds.
pub fn firing_delay_ns(laser: usize) -> i64 {
    TABLE.channels[laser].firing_ns.into()
}

/// Rank of a laser by elevation, 0 lowest.
pub fn ring(laser: usize) -> u16 {
    TABLE.channels[laser].ring
}

#[cfg(test)]
mod tests;
