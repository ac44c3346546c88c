//! A spinning Velodyne: every laser fired from where the sensor is at that microsecond.

mod echo;

use rayon::prelude::*;
use wide::f32x8;

use lsfb_drivers::lidar::Returns;
use lsfb_drivers::velodyne::model::{Model, ModelTable};
use lsfb_drivers::velodyne::wire::{BLOCKS, CHANNELS};
use lsfb_geometry::{Se3, Vector3};

use crate::config::LidarConfig;
use crate::walk::Walk;
use crate::world::crowd::Moment;
use crate::world::{LANES, Origin, RayPacket, World};
use echo::{PATTERN, RAYS, Trail, agree, merge};

/// One range as sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Return {
    /// Range in the model's unit (4 mm for a VLP-32C, 2 mm for a VLP-16), 0 for no return.
    pub range_count: u16,
    /// Diffuse reflectivity, percent.
    pub reflectivity: u8,
}

/// What fills one block of a packet, or in dual mode a pair: all lasers of a VLP-32C fired once, those of a VLP-16 twice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FiringCycle {
    /// First firing, nanoseconds after the start of the walk.
    pub offset_ns: i64,
    /// Encoder angle at the first firing, 0.01°.
    pub azimuth_centideg: u16,
    /// By channel of the block: what the return mode asks for, in dual mode the last echo.
    pub returns: [Return; CHANNELS],
    /// In dual mode: the strongest echo, or the second strongest where the strongest is the last; the same as the last
    /// where there is no other. Without, empty.
    pub second_returns: [Return; CHANNELS],
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

    /// Which sensor it is.
    pub fn model(&self) -> Model {
        self.config.model
    }

    /// Which echoes it sends.
    pub fn return_mode(&self) -> Returns {
        self.config.returns
    }

    fn table(&self) -> &'static ModelTable {
        self.config.model.table()
    }

    /// Time from one [`FiringCycle`] to the next, nanoseconds.
    pub fn cycle_ns(&self) -> i64 {
        self.table().block_period_ns.into()
    }

    /// Firing cycles in a data packet.
    pub fn cycles_per_packet(&self) -> usize {
        match self.config.returns {
            Returns::Strongest | Returns::Last => BLOCKS,
            Returns::Dual => BLOCKS / 2,
        }
    }

    /// Time from one data packet to the next, nanoseconds.
    pub fn packet_ns(&self) -> i64 {
        self.cycle_ns() * self.cycles_per_packet() as i64
    }

    /// Length of one count of a range, metres.
    pub fn range_unit_m(&self) -> f64 {
        f64::from(self.table().distance_unit_mm) * 1e-3
    }

    /// Direction of a channel in the LiDAR frame (x forward, y left, z up) at an encoder angle.
    pub fn beam_direction(&self, channel: usize, azimuth_deg: f64) -> Vector3<f64> {
        self.beam(channel, azimuth_deg).axis
    }

    fn beam(&self, channel: usize, azimuth_deg: f64) -> Beam {
        let channel = &self.table().channels[channel % CHANNELS];
        let elevation = channel.elevation_deg.to_radians();
        let (rise, flat) = (elevation.sin(), elevation.cos());
        let (sin, cos) = (azimuth_deg + channel.azimuth_offset_deg)
            .to_radians()
            .sin_cos();
        Beam {
            axis: Vector3::new(flat * cos, -flat * sin, rise),
            right: Vector3::new(-sin, -cos, 0.0),
            up: Vector3::new(-rise * cos, rise * sin, flat),
        }
    }

    /// Time at which a channel fires, after the beginning of its cycle, nanoseconds.
    pub fn firing_delay_ns(&self, channel: usize) -> i64 {
        self.table().channels[channel % CHANNELS].firing_ns.into()
    }

    /// Rank of a channel's laser by elevation, 0 lowest.
    pub fn ring(&self, channel: usize) -> u16 {
        self.table().channels[channel % CHANNELS].ring
    }

    /// Exact encoder angle, degrees; 0 at the start of the walk, growing clockwise seen from above.
    fn azimuth_deg(&self, offset_ns: i64) -> f64 {
        let per_turn_ns = 60_000_000_000 / i64::from(self.config.rpm);
        360.0 * (offset_ns % per_turn_ns) as f64 / per_turn_ns as f64
    }

    /// Fires cycles `first .. first + count`.
    pub fn fire(&self, world: &World, walk: &Walk, first: u64, count: usize) -> Vec<FiringCycle> {
        let wanted = first..first + count as u64;
        let lanes = LANES as u64;
        // Groups are the same whatever part of the walk is asked for: people stand still during each.
        (first / lanes..wanted.end.div_ceil(lanes))
            .into_par_iter()
            .flat_map_iter(|group| {
                let numbers = group * lanes..;
                let cycles = self.fire_group(world, walk, group * lanes);
                let asked = numbers.zip(cycles).filter(|(n, _)| wanted.contains(n));
                asked.map(|(_, cycle)| cycle)
            })
            .collect()
    }

    /// Eight cycles in a row. A laser's eight rays are neighbours, so they go through the world together.
    fn fire_group(&self, world: &World, walk: &Walk, first: u64) -> [FiringCycle; LANES] {
        let mut cycles: [FiringCycle; LANES] = std::array::from_fn(|lane| {
            let offset_ns = (first as i64 + lane as i64) * self.cycle_ns();
            FiringCycle {
                offset_ns,
                azimuth_centideg: ((self.azimuth_deg(offset_ns) * 100.0).round() as u32 % 36_000)
                    as u16,
                returns: [Return::default(); CHANNELS],
                second_returns: [Return::default(); CHANNELS],
            }
        });
        let motions: [_; LANES] =
            std::array::from_fn(|lane| walk.at(cycles[lane].offset_ns as f64 * 1e-9));
        let place = motions[0].world_from_rig.translation;
        let moment = world.moment(
            cycles[LANES / 2].offset_ns as f64 * 1e-9,
            [place.x as f32, place.y as f32],
        );
        let poses_at = |delay_ns: i64| -> [Se3; LANES] {
            std::array::from_fn(|lane| {
                motions[lane].coasted(delay_ns as f64 * 1e-9) * self.rig_from_lidar
            })
        };
        let (mut fired_ns, mut poses) = (0, poses_at(0));
        for channel in 0..CHANNELS {
            let delay_ns = self.firing_delay_ns(channel);
            if delay_ns != fired_ns {
                // Lasers that fire together share it.
                (fired_ns, poses) = (delay_ns, poses_at(delay_ns));
            }
            let volley = self.aim(channel, &poses, |lane| {
                self.azimuth_deg(cycles[lane].offset_ns + delay_ns)
            });
            let number = |lane: usize| (first + lane as u64) * CHANNELS as u64 + channel as u64;
            let met = self.shoot(world, &moment, &volley, number);
            for (lane, cycle) in cycles.iter_mut().enumerate() {
                [cycle.returns[channel], cycle.second_returns[channel]] =
                    self.answer(met[lane].as_slice(), number(lane));
            }
        }
        cycles
    }

    /// What eight shots meet.
    fn shoot(
        &self,
        world: &World,
        moment: &Moment,
        volley: &Volley,
        number: impl Fn(usize) -> u64,
    ) -> [Trail; LANES] {
        let ray = |k: usize| self.follow(world, moment, volley.rays(k), &number);
        let separation_m = self.config.separation_m;
        let axis = ray(0);
        if self.config.divergence_rad == [0.0; 2] {
            return axis.map(|trail| merge(&[trail], separation_m));
        }
        // Where three rays of each beam agree, so will the others: most beams lie on one surface.
        let (a, b) = (ray(1), ray(2));
        let whole: [bool; LANES] =
            std::array::from_fn(|k| agree(&axis[k], &a[k]) && agree(&axis[k], &b[k]));
        if whole == [true; LANES] {
            return axis.map(|trail| merge(&[trail], separation_m));
        }
        let (c, d) = (ray(3), ray(4));
        std::array::from_fn(|k| {
            if whole[k] {
                merge(&[axis[k]], separation_m)
            } else {
                merge(&[axis[k], a[k], b[k], c[k], d[k]], separation_m)
            }
        })
    }

    /// Eight shots of a channel, from where the LiDAR is at each.
    fn aim(
        &self,
        channel: usize,
        poses: &[Se3; LANES],
        azimuth_deg: impl Fn(usize) -> f64,
    ) -> Volley {
        let [width, height] = self.config.divergence_rad;
        let mut volley = Volley::default();
        for (lane, pose) in poses.iter().enumerate() {
            let beam = self.beam(channel, azimuth_deg(lane));
            let axis = pose.rotation * beam.axis;
            let right = pose.rotation * (beam.right * width);
            let up = pose.rotation * (beam.up * height);
            for i in 0..3 {
                volley.origin[i][lane] = pose.translation[i] as f32;
                volley.axis[i][lane] = axis[i] as f32;
                volley.right[i][lane] = right[i] as f32;
                volley.up[i][lane] = up[i] as f32;
            }
        }
        volley
    }
}

/// Where a laser points, and the directions across its beam, in the LiDAR frame.
struct Beam {
    axis: Vector3<f64>,
    right: Vector3<f64>,
    up: Vector3<f64>,
}

/// One channel fired in eight cycles, in the world.
#[derive(Default)]
struct Volley {
    origin: [[f32; LANES]; 3],
    axis: [[f32; LANES]; 3],
    /// Width and height of the beams, as far as at a metre.
    right: [[f32; LANES]; 3],
    up: [[f32; LANES]; 3],
}

impl Volley {
    /// Ray number `k` of the beams.
    fn rays(&self, k: usize) -> RayPacket {
        let [across, above] = PATTERN[k % RAYS].map(|v| f32x8::splat(v as f32));
        let direction = std::array::from_fn(|i| {
            let axis = f32x8::new(self.axis[i]);
            match k {
                0 => axis,
                _ => axis + across * f32x8::new(self.right[i]) + above * f32x8::new(self.up[i]),
            }
        });
        RayPacket {
            origin: Origin::Each(self.origin.map(f32x8::new)),
            direction,
        }
    }
}

#[cfg(test)]
mod tests;
